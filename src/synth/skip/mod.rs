//! Skipping: what of a window has to be computed, and what may keep its last result.
//!
//! [`cells`] cuts windows into the units that are skipped or computed. The [`gate`] decides about each of them: it
//! compares raw pixel values with a [`reference`], what cells were last computed from, and [`noise`] says how much they
//! differ when nothing changes. [`cover`] puts the active cells into few cuboids; [`kept`] fills in the results of the
//! others, and audits them wherever they are computed anew. The [`tally`] says what a run left out.

mod cells;
mod cover;
mod gate;
mod kept;
mod noise;
mod reference;
mod tally;

pub use cells::{Active, Cells, cell_frames};
pub use cover::{Cuboid, cover};
pub use gate::{Choice, Gate, Rules, Skip};
pub use kept::Kept;
pub use tally::{Audit, Skipped};

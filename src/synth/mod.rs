//! The main job: capture → HDR video, window after window and tile after tile.
//!
//! [`windows`] says which frames a net sees, [`tiles`] which pixels, [`Backend`] where it runs;
//! [`Synthesizer`] puts them together.

mod backend;
mod synthesizer;
pub mod tiles;
pub mod windows;

pub use backend::{Backend, Request};
pub use synthesizer::{Report, Synthesizer, check_fits};

//! The main job: recording → HDR video, window after window and tile after tile.
//!
//! Data flows so: a thread reads frames from a [`FrameSource`](crate::sensor::FrameSource) into [`footage`], the part
//! of the recording that is in memory. [`windows`] says which frames a net sees. The [`gate`] decides which cells of a
//! window have to be computed ([`memory`] and [`noise`]: what counts as a change), [`cover`] puts them into boxes, and
//! [`layout`] makes tiles of those ([`tiles`]: which pixels a tile sees). The [`line`] has executors of the [`pool`]
//! compute them (in several views, if it is to be an [`ensemble`]), puts results together, and delivers frames to a thread that writes them. [`Synthesizer`] runs it all.

mod backend;
mod cover;
mod ensemble;
mod footage;
mod gate;
mod layout;
mod line;
mod memory;
mod noise;
mod pool;
mod report;
mod synthesizer;
pub mod tiles;
pub mod windows;

pub use backend::{Backend, Request};
pub use cover::Active;
pub use ensemble::{Ensemble, views};
pub use line::ResultFrame;
pub use report::{Audit, Report, Skipped};
pub use synthesizer::{Options, Skip, Synthesizer, check_fits, fitted};

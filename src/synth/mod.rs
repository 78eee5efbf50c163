//! The main job: recording → HDR video, window after window and tile after tile.
//!
//! Data flows so: a thread reads frames from a [`Source`](crate::sensor::Source) into [`footage`], the part
//! of the recording that is in memory. [`windows`] says which frames a net sees. [`skip`] decides which cells of a window
//! have to be computed and puts them into cuboids, and [`layout`] makes tiles of those ([`tiles`]: which pixels a tile
//! sees). The [`line`] has executors of the [`pool`] compute them (in several views, if it is to be an [`ensemble`]), puts
//! results together, lets them [`accumulate`] where a scene rests, and delivers frames to a thread that writes them. All of them see the sensor's frames, in which
//! [`on_sensor`] lays those of the recording. [`Synthesizer`] runs it all. [`live`] is what
//! sources that cannot wait have in common.

mod accumulate;
mod backend;
mod ensemble;
mod fit;
mod footage;
mod layout;
mod line;
pub mod live;
mod on_sensor;
mod pool;
mod report;
mod settings;
mod skip;
mod synthesizer;
pub mod tiles;
pub mod windows;

pub use backend::{Backend, ExecutorChoice};
pub use ensemble::{Ensemble, poses};
pub use fit::fitted;
pub use line::ResultFrame;
pub use report::Report;
pub use settings::Settings;
pub use skip::{Active, Audit, Skip, Skipped};
pub use synthesizer::{Synthesizer, check_fits};

//! Ground truth: scenes as functions of time and place, and their rendering with physical motion blur.

mod clips;
mod panorama;
pub mod procedural;
mod render;

use glam::Vec2;

pub(crate) use clips::Draw;
pub use clips::{Moves, Speed, suite_clip, training_clip};
pub use panorama::{Flicker, Motion, Mover, Panorama, PanoramaScene, Pinhole};
pub use render::{Rendering, render};

/// A scene that can be looked at at any instant.
///
/// Image coordinates are in pixels of the rendering, origin at the top left corner of the top left pixel, whose
/// centre is (0.5, 0.5); time is in frames.
pub trait Scene: Sync {
    /// The scene frozen at time `t`: a function from image position to radiance (linear, ≥ 0, any scale).
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_>;
}

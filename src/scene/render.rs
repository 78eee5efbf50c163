//! Rendering: a frame is the mean over its period and each pixel the mean over its area.

use glam::Vec2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::Scene;
use crate::video::Video;

/// How a scene is rendered.
#[derive(Clone, Copy, Debug)]
pub struct Rendering {
    /// Frames.
    pub frames: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Instants per frame: motion blur inside a frame is their mean.
    pub instants: usize,
    /// Positions per pixel and instant.
    pub positions: usize,
    /// Seed of the positions.
    pub seed: u64,
}

/// Renders `scene`. Does not depend on the number of threads.
pub fn render(scene: &dyn Scene, how: Rendering) -> Video {
    let Rendering { frames, height, width, instants, positions, seed } = how;
    let mut video = Video::black(frames, height, width);
    let share = 1.0 / (instants * positions) as f32;
    for t in 0..frames {
        for instant in 0..instants {
            // Positions are jittered so that detail finer than a pixel averages instead of aliasing, the same
            // way in every pixel and frame, so that a static scene is static.
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(instant as u64);
            let offset = Vec2::new(rng.random(), rng.random());
            let look = scene.instant(t as f32 + (instant as f32 + 0.5) / instants as f32);
            video.frame_mut(t).par_chunks_mut(width).enumerate().for_each(|(y, row)| {
                for (x, pixel) in row.iter_mut().enumerate() {
                    let corner = Vec2::new(x as f32, y as f32);
                    for position in 0..positions {
                        *pixel += share * look(corner + jitter(offset, instant * positions + position));
                    }
                }
            });
        }
    }
    video
}

/// The `index`-th point of a low-discrepancy sequence in the unit square (R2, shifted by `offset`).
fn jitter(offset: Vec2, index: usize) -> Vec2 {
    // 1/ρ and 1/ρ² with ρ³ = ρ + 1, in f64 so that long sequences stay even.
    const STEP: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
    let along = |axis: usize| (f64::from(offset[axis]) + index as f64 * STEP[axis]).fract() as f32;
    Vec2::new(along(0), along(1))
}

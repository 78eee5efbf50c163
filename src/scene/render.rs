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

/// Renders `scene`; `progress` hears of every finished frame. Does not depend on the number of threads.
pub fn render(scene: &dyn Scene, how: Rendering, progress: impl Fn() + Sync) -> Video {
    let Rendering { frames, height, width, instants, positions, seed } = how;
    let mut video = Video::black(frames, height, width);
    let share = 1.0 / (instants * positions) as f32;
    // Positions are jittered so that detail finer than a pixel averages instead of aliasing, the same way in every
    // pixel and frame, so that a static scene is static.
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let offset = Vec2::new(rng.random(), rng.random());
    let jitters: Vec<Vec2> = (0..instants * positions).map(|index| jitter(offset, index)).collect();
    let time = |t: usize, instant: usize| t as f32 + (instant as f32 + 0.5) / instants as f32;
    video.data.par_chunks_mut(width * height).enumerate().for_each(|(t, frame)| {
        let looks: Vec<_> = (0..instants).map(|instant| scene.instant(time(t, instant))).collect();
        frame.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                let corner = Vec2::new(x as f32, y as f32);
                let light = |(index, jitter): (usize, &Vec2)| looks[index / positions](corner + *jitter);
                *pixel = share * jitters.iter().enumerate().map(light).sum::<f32>();
            }
        });
        progress();
    });
    video
}

/// The `index`-th point of a low-discrepancy sequence in the unit square (R2, shifted by `offset`).
fn jitter(offset: Vec2, index: usize) -> Vec2 {
    // 1/ρ and 1/ρ² with ρ³ = ρ + 1, in f64 so that long sequences stay even.
    const STEP: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
    let along = |axis: usize| (f64::from(offset[axis]) + index as f64 * STEP[axis]).fract() as f32;
    Vec2::new(along(0), along(1))
}

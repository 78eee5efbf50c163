//! A step wedge.

use glam::Vec2;

use super::super::Scene;
use super::glyph::Text;
use super::shape::{Stage, floor, fract, rectangle};

/// Steps: 0.001 … 1 in quarter decades.
const STEPS: usize = 13;
/// Decades from the first step to the last.
const DECADES: f32 = 3.0;
/// Radiance of the mount and the numbers.
const MOUNT: f32 = 0.0005;

/// A step wedge in the manner of a film target, in two rows (…0.03, 0.05…1) so that each step is wide: each step
/// has its number (log10 of its radiance, without the sign) and line pairs of 10% contrast at three pitches;
/// below, a smooth logarithmic ramp from 0.001 to 1. It stands still or drifts sideways round and round.
#[derive(Clone, Debug)]
pub struct Wedge {
    stage: Stage,
    /// Drift in units/frame.
    speed: f32,
    /// Radiance and number of each step.
    steps: [(f32, Text); STEPS],
}

impl Wedge {
    /// A wedge for an image of `height` × `width` pixels, drifting at `speed` px/frame.
    pub fn new(height: usize, width: usize, speed: f32) -> Self {
        let stage = Stage::new(height, width);
        let steps = std::array::from_fn(|step| {
            let exponent = DECADES * (step as f32 / (STEPS - 1) as f32 - 1.0);
            (10.0_f32.powf(exponent), Text::new(&format!("{:.2}", exponent.abs()), 0.08, 0.2))
        });
        Self { stage, speed: speed * stage.pixel(), steps }
    }

    /// Radiance of a step's patch at `p` from its middle, its half extents being `half`.
    fn step(&self, step: usize, p: Vec2, half: Vec2) -> f32 {
        let (level, number) = &self.steps[step];
        let ink = |d: f32| self.stage.cover(d);
        let number = ink(number.distance(p - Vec2::new(0.0, 0.22 - half.y)));
        // A dark number on a bright step, a bright one on a dark step.
        let contrast = if step < STEPS / 2 { 4.0 } else { 0.25 };
        let lines = Vec2::new(p.x, p.y - 0.13);
        let pitch = [0.16, 0.08, 0.04][((lines.x + half.x) / (2.0 * half.x) * 3.0).clamp(0.0, 2.0) as usize];
        let wave = 0.05 * ((std::f32::consts::TAU * lines.y / pitch).sin() - 1.0);
        let field = rectangle(lines, Vec2::new(half.x - 0.025, 0.16));
        let level = level * (1.0 + ink(field) * wave);
        level * (1.0 + number * (contrast - 1.0))
    }
}

impl Scene for Wedge {
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_> {
        let reach = self.stage.extent();
        let drift = (self.speed * t).rem_euclid(2.0 * reach.x);
        Box::new(move |position| {
            let p = self.stage.point(position);
            // 0 … 1 from left to right, going round.
            let x = fract((p.x - drift) / (2.0 * reach.x) + 0.5);
            let y = p.y / reach.y;
            let (steps, first, middle) = match y {
                ..-0.25 => (STEPS / 2, 0, -0.62),
                ..0.5 => (STEPS - STEPS / 2, STEPS / 2, 0.12),
                _ => (1, 0, 0.76),
            };
            let column = floor((x * steps as f32).min(steps as f32 - 0.5));
            let half = Vec2::new(reach.x / steps as f32, if steps == 1 { 0.2 } else { 0.34 } * reach.y);
            let place = Vec2::new((x * steps as f32 - column - 0.5) * 2.0 * half.x, (y - middle) * reach.y);
            let frame = rectangle(place, half - 0.012);
            self.stage.paint(MOUNT, frame, || match steps {
                1 => (DECADES * std::f32::consts::LN_10 * (x - 1.0)).exp(),
                _ => self.step(first + column as usize, place, half),
            })
        })
    }
}

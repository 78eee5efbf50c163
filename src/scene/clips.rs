//! Clips from panoramas: the fixed classes of the quality suite, and random ones for training.

use std::f32::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;

use glam::{EulerRot, Quat, Vec2};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::panorama::{Flicker, Motion, Mover, Panorama, PanoramaScene, Pinhole};

/// How fast the image moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Speed {
    /// Not at all.
    Static,
    /// Up to 0.25 px/frame.
    Slow,
    /// 0.25 to 1 px/frame.
    Medium,
    /// 1 to 2 px/frame.
    Fast,
    /// 2 to 4 px/frame.
    Extreme,
}

impl Speed {
    /// All speeds, slowest first.
    pub const ALL: [Self; 5] = [Self::Static, Self::Slow, Self::Medium, Self::Fast, Self::Extreme];

    /// Range in px/frame.
    pub fn range(self) -> [f32; 2] {
        match self {
            Self::Static => [0.0, 0.0],
            Self::Slow => [0.05, 0.25],
            Self::Medium => [0.25, 1.0],
            Self::Fast => [1.0, 2.0],
            Self::Extreme => [2.0, 4.0],
        }
    }

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Static => "static",
            Self::Slow => "slow",
            Self::Medium => "medium",
            Self::Fast => "fast",
            Self::Extreme => "extreme",
        }
    }
}

/// What moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Moves {
    /// The camera turns.
    Pan,
    /// An object passes a still background.
    Object,
    /// The camera turns and objects move on their own.
    Both,
}

impl Moves {
    /// All kinds of motion.
    pub const ALL: [Self; 3] = [Self::Pan, Self::Object, Self::Both];

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pan => "pan",
            Self::Object => "object",
            Self::Both => "both",
        }
    }
}

/// A clip of the quality suite: one speed, one kind of motion, everything else drawn from `seed`.
pub fn suite_clip(
    panoramas: &[Arc<Panorama>],
    index: usize,
    (speed, moves): (Speed, Moves),
    [height, width]: [usize; 2],
    frames: usize,
    seed: u64,
) -> PanoramaScene {
    let mut draw = Draw(ChaCha8Rng::seed_from_u64(seed));
    let size = Vec2::new(width as f32, height as f32);
    let camera = draw.camera(size, [50.0, 90.0]);
    let [least, most] = speed.range();
    let motion = |draw: &mut Draw| Motion {
        velocity: draw.direction() * draw.within(least, most),
        ..Motion::default()
    };
    let pan = motion(&mut draw);
    let objects = (0..if moves == Moves::Pan { 0 } else { 2 })
        .map(|_| {
            let motion = motion(&mut draw);
            draw.mover(panoramas, size, frames, motion)
        })
        .collect();
    PanoramaScene {
        panorama: Arc::clone(&panoramas[index]),
        camera,
        motion: if moves == Moves::Object { Motion::default() } else { pan },
        movers: objects,
        flicker: Flicker::default(),
        mover_flicker: Flicker::default(),
    }
}

/// A random clip for training: wider than the suite in every respect.
pub fn training_clip(
    panoramas: &[Arc<Panorama>],
    [height, width]: [usize; 2],
    frames: usize,
    seed: u64,
) -> (PanoramaScene, Speed) {
    let mut draw = Draw(ChaCha8Rng::seed_from_u64(seed));
    let size = Vec2::new(width as f32, height as f32);
    let camera = draw.camera(size, [25.0, 110.0]);
    let speed = Speed::ALL[draw.0.random_range(0..5)];
    let [least, most] = speed.range();
    let still = speed == Speed::Static;
    let moves = Moves::ALL[draw.0.random_range(0..3)];
    let motion = |draw: &mut Draw| {
        let velocity = draw.direction() * draw.within(least, most);
        // One in three swings or turns besides.
        let lively = !still && draw.chance(0.33);
        let swing_period = draw.within(16.0, 64.0);
        let reach = if lively { most.min(2.0) * swing_period / TAU } else { 0.0 };
        let rotation = if lively { draw.within(-1.0, 1.0) * most * 2.0 / size.min_element() } else { 0.0 };
        Motion { velocity, rotation, swing: draw.direction() * draw.within(0.0, reach), swing_period }
    };
    let pan = if moves == Moves::Object { Motion::default() } else { motion(&mut draw) };
    let objects = if moves == Moves::Pan { 0 } else { draw.0.random_range(1..=4) };
    let movers = (0..objects)
        .map(|_| {
            let motion = motion(&mut draw);
            draw.mover(panoramas, size, frames, motion)
        })
        .collect();
    let flicker = |draw: &mut Draw| {
        let (depth, period, phase) = (draw.within(0.05, 0.9), draw.log_within(3.0, 80.0), draw.unit());
        if draw.chance(0.08) { Flicker { depth, period, phase } } else { Flicker::default() }
    };
    let scene = PanoramaScene {
        panorama: draw.panorama(panoramas),
        camera,
        motion: pan,
        movers,
        flicker: flicker(&mut draw),
        mover_flicker: flicker(&mut draw),
    };
    (scene, speed)
}

/// Random draws with the terms of this module.
pub(crate) struct Draw(pub ChaCha8Rng);

impl Draw {
    pub(crate) fn unit(&mut self) -> f32 {
        self.0.random()
    }

    pub(crate) fn chance(&mut self, probability: f32) -> bool {
        self.unit() < probability
    }

    pub(crate) fn within(&mut self, least: f32, most: f32) -> f32 {
        least + (most - least) * self.unit()
    }

    pub(crate) fn log_within(&mut self, least: f32, most: f32) -> f32 {
        least * (most / least).powf(self.unit())
    }

    fn direction(&mut self) -> Vec2 {
        Vec2::from_angle(self.within(0.0, TAU))
    }

    fn panorama(&mut self, panoramas: &[Arc<Panorama>]) -> Arc<Panorama> {
        Arc::clone(&panoramas[self.0.random_range(0..panoramas.len())])
    }

    /// A camera that looks anywhere but straight up or down, any side up.
    fn camera(&mut self, size: Vec2, field_of_view: [f32; 2]) -> Pinhole {
        let yaw = self.within(0.0, TAU);
        let pitch = self.within(-0.9, 0.9);
        let roll = FRAC_PI_2 * self.0.random_range(0..4) as f32 + self.within(-0.2, 0.2);
        let angle = self.within(field_of_view[0], field_of_view[1]).to_radians();
        Pinhole {
            orientation: Quat::from_euler(EulerRot::YXZ, yaw, pitch, roll),
            focal: 0.5 * size.max_element() / (0.5 * angle).tan(),
            centre: 0.5 * size,
        }
    }

    /// An object with the texture of some panorama, in the picture at half time.
    fn mover(&mut self, panoramas: &[Arc<Panorama>], size: Vec2, frames: usize, motion: Motion) -> Mover {
        let middle = Vec2::new(self.within(0.15, 0.85), self.within(0.15, 0.85)) * size;
        let reach = size.min_element();
        Mover {
            position: middle - motion.velocity * (0.5 * frames as f32),
            motion,
            half_axes: Vec2::new(self.log_within(0.05, 0.3), self.log_within(0.05, 0.3)) * reach,
            exponent: [1.0, 2.0, 2.0, 4.0, 12.0][self.0.random_range(0..5)],
            texture: self.camera(size, [30.0, 90.0]),
            panorama: self.panorama(panoramas),
            gain: self.log_within(0.25, 4.0),
        }
    }
}

//! Surfaces: value noise and the textures made of it, the same on every machine.

use glam::{FloatExt, Vec2};

use super::shape::{floor, fract};

/// Noise with a seed.
#[derive(Clone, Copy, Debug)]
pub struct NoiseTexture {
    seed: u32,
}

impl NoiseTexture {
    /// The noise of `seed`; different `layer`s of one seed have nothing in common.
    pub fn new(seed: u64, layer: u32) -> Self {
        Self { seed: mix(seed as u32 ^ mix((seed >> 32) as u32 ^ mix(layer))) }
    }

    /// A number in [0, 1) for each cell of a grid.
    pub fn cell(self, x: i32, y: i32) -> f32 {
        // One round of `mix`, which is enough for the upper bits and much of a scene's time.
        let hash = (x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca77) ^ self.seed;
        let hash = (hash ^ (hash >> 15)).wrapping_mul(0x846c_a68b);
        ((hash ^ (hash >> 16)) >> 8) as i32 as f32 / (1 << 24) as f32
    }

    /// Value noise in [0, 1): cells of size 1, smooth between their corners.
    pub fn value(self, p: Vec2) -> f32 {
        let corner = Vec2::new(floor(p.x), floor(p.y));
        let s = p - corner;
        let s = s * s * (3.0 - 2.0 * s);
        let (x, y) = (corner.x as i32, corner.y as i32);
        let (right, below) = (x.wrapping_add(1), y.wrapping_add(1));
        let upper = self.cell(x, y).lerp(self.cell(right, y), s.x);
        let lower = self.cell(x, below).lerp(self.cell(right, below), s.x);
        upper.lerp(lower, s.y)
    }

    /// Sum of `octaves` of value noise, each half as large and half as strong as the one before; in [0, 1).
    pub fn fractal(self, p: Vec2, octaves: u32) -> f32 {
        let (mut sum, mut weight, mut q) = (0.0, 0.5, p);
        for _ in 0..octaves {
            sum += weight * self.value(q);
            // The offset keeps the corners of the octaves apart.
            q = 2.0 * q + Vec2::new(17.3, 9.1);
            weight *= 0.5;
        }
        sum / (1.0 - 2.0 * weight)
    }

    /// Rough plaster, about 1.
    pub fn plaster(self, p: Vec2) -> f32 {
        0.78 + 0.44 * self.fractal(9.0 * p, 3)
    }

    /// Boards of wood with grain along x, in (0, 1].
    pub fn wood(self, p: Vec2) -> f32 {
        let board = floor(p.y / 0.31);
        let along = Vec2::new(1.3 * p.x + 37.0 * board, 14.0 * p.y);
        let grain = fract(9.0 * self.value(along) + 3.0 * p.y);
        let fibre = self.value(Vec2::new(5.0 * p.x, 75.0 * p.y));
        let joint = if p.y - 0.31 * board < 0.012 { 0.35 } else { 1.0 };
        joint * (0.5 + 0.3 * grain * grain + 0.2 * fibre) * (0.8 + 0.2 * self.cell(board as i32, 7))
    }
}

/// A well mixed 32 bit hash: each bit of the result depends on each bit of `x`.
fn mix(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these values are exact")]
mod tests {
    use super::*;

    #[test]
    fn noise_is_even_and_continuous() {
        let noise = NoiseTexture::new(5, 0);
        let mean = (0..10_000).map(|i| noise.cell(i % 100, i / 100)).sum::<f32>() / 10_000.0;
        assert!((mean - 0.5).abs() < 0.01, "{mean}");
        for i in -300..300 {
            let p = Vec2::new(0.37 * i as f32, -0.11 * i as f32);
            let (here, there) = (noise.fractal(p, 3), noise.fractal(p + 1e-3, 3));
            assert!((0.0..1.0).contains(&here) && (here - there).abs() < 0.02, "{p}: {here} {there}");
        }
    }

    #[test]
    fn seeds_and_layers_differ() {
        let at = |seed, layer| NoiseTexture::new(seed, layer).value(Vec2::splat(0.4));
        assert_eq!(at(1, 0), at(1, 0));
        assert!(at(1, 0) != at(2, 0) && at(1, 0) != at(1, 1) && at(1, 0) != at(1 << 32, 0));
    }
}

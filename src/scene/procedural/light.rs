//! Light: small lamps with their inverse square law, matte and shiny surfaces, the glow about bright things.

use glam::Vec3;

/// Direction to the viewer.
const VIEWER: Vec3 = Vec3::Z;

/// A small lamp.
#[derive(Clone, Copy, Debug)]
pub struct Lamp {
    /// Where it is.
    pub position: Vec3,
    /// Radiance of a white matte surface at distance 1 that faces it.
    pub intensity: f32,
}

impl Lamp {
    /// Radiance of a white matte surface at `point` (Lambert's law), without shadows.
    pub fn on(&self, point: Vec3, normal: Vec3) -> f32 {
        let to = self.position - point;
        let square = to.length_squared().max(1e-4);
        self.intensity * normal.dot(to).max(0.0) / (square * square.sqrt())
    }

    /// The same for a lamp so large that it reaches round the terminator: `wrap` is the sine of the angle by
    /// which it does.
    pub fn around(&self, point: Vec3, normal: Vec3, wrap: f32) -> f32 {
        let to = self.position - point;
        let square = to.length_squared().max(1e-4);
        self.intensity * ((normal.dot(to) / square.sqrt() + wrap) / (1.0 + wrap)).max(0.0) / square
    }

    /// The lamp's highlight on a shiny surface at `point` (Blinn–Phong): 1 in its middle.
    pub fn highlight(&self, point: Vec3, normal: Vec3, sharpness: f32) -> f32 {
        let half = ((self.position - point).normalize_or_zero() + VIEWER).normalize_or_zero();
        let cosine = normal.dot(half).min(1.0);
        // cosineˢ ≤ exp(s (cosine − 1)), which is not seen beyond this.
        if sharpness * (1.0 - cosine) < 16.0 { (sharpness * cosine.max(1e-6).ln()).exp() } else { 0.0 }
    }
}

/// The glow at `distance` from something bright, as a lens and its dirt spread it: 1 at the middle, falling
/// with the third power beyond `radius`.
pub fn glow(distance: f32, radius: f32) -> f32 {
    let s = 1.0 + (distance / radius).powi(2);
    1.0 / (s * s.sqrt())
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these values are exact")]
mod tests {
    use super::*;

    #[test]
    fn light_falls_with_the_square_of_distance() {
        let lamp = Lamp { position: Vec3::new(0.0, 0.0, 1.0), intensity: 2.0 };
        assert_eq!(lamp.on(Vec3::ZERO, Vec3::Z), 2.0);
        assert_eq!(lamp.on(Vec3::new(0.0, 0.0, -1.0), Vec3::Z), 0.5);
        assert_eq!(lamp.on(Vec3::ZERO, -Vec3::Z), 0.0);
        assert!((lamp.highlight(Vec3::ZERO, Vec3::Z, 50.0) - 1.0).abs() < 1e-5);
        assert!(lamp.on(lamp.position, Vec3::Z).is_finite());
    }
}

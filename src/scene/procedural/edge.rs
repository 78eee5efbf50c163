//! A slanted edge.

use glam::Vec2;

use super::super::Scene;

/// Radiance of the dark side; the bright side has 1.
const DARK: f32 = 0.02;
/// Angle of the edge to the columns.
const ANGLE: f32 = 5.0 * std::f32::consts::PI / 180.0;

/// A straight edge 5° from upright, dark (0.02) on the left, bright (1) on the right, perfectly sharp: what is
/// measured of it is the pixel's area, the motion within a frame, and whatever comes behind. It stands still or
/// moves sideways to and fro at constant speed, a sixth of the width to either side of the middle.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    middle: Vec2,
    speed: f32,
}

impl Edge {
    /// An edge through the middle of an image of `height` × `width` pixels, moving at `speed` px/frame.
    pub fn new(height: usize, width: usize, speed: f32) -> Self {
        Self { middle: Vec2::new(width as f32, height as f32) / 2.0, speed }
    }

    /// How far the edge is from the middle at time `t`, in px.
    fn shift(&self, t: f32) -> f32 {
        let reach = self.middle.x / 3.0;
        if reach == 0.0 {
            return 0.0;
        }
        // A triangle wave that starts in the middle.
        let phase = (self.speed * t / (4.0 * reach) + 0.25).rem_euclid(1.0);
        reach * (1.0 - (4.0 * phase - 2.0).abs())
    }
}

impl Scene for Edge {
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_> {
        let foot = self.middle + Vec2::new(self.shift(t), 0.0);
        let across = Vec2::from_angle(ANGLE);
        Box::new(move |p| if (p - foot).dot(across) < 0.0 { DARK } else { 1.0 })
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these values are exact")]
mod tests {
    use super::*;

    #[test]
    fn the_edge_moves_at_its_speed_and_comes_back() {
        let edge = Edge::new(90, 120, 0.5);
        assert!(edge.shift(0.0).abs() < 1e-4);
        assert!((edge.shift(10.0) - 5.0).abs() < 1e-4);
        assert!((edge.shift(60.0) - 10.0).abs() < 1e-3, "it has turned at 20");
        assert!((edge.shift(160.0)).abs() < 1e-3, "it is back after four reaches");
        assert_eq!(Edge::new(90, 120, 0.0).shift(77.0), 0.0);
        assert_eq!(Edge::new(1, 0, 1.0).shift(3.0), 0.0);
    }
}

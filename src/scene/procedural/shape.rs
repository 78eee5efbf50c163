//! Places and shapes: the unit square in which scenes are laid out, signed distances, and the normals of solids.
//!
//! Everything is seen along −z by a camera without perspective: x to the right, y down, z towards the viewer.
//! Distances are negative inside.

use glam::{FloatExt, Mat3, Vec2, Vec3};

/// Width in pixels over which a drawn edge goes from one side to the other, as a sharp lens would have it.
const EDGE: f32 = 0.6;

/// The stage on which a scene is laid out: the largest centred square of the image is [−1, 1]².
#[derive(Clone, Copy, Debug)]
pub struct Stage {
    middle: Vec2,
    /// Pixels per unit.
    scale: f32,
}

impl Stage {
    /// That of an image of `height` × `width` pixels.
    pub fn new(height: usize, width: usize) -> Self {
        let size = Vec2::new(width.max(1) as f32, height.max(1) as f32);
        Self { middle: size / 2.0, scale: size.min_element() / 2.0 }
    }

    /// The point of the stage at an image position (pixels).
    pub fn point(&self, position: Vec2) -> Vec2 {
        (position - self.middle) / self.scale
    }

    /// Size of a pixel.
    pub fn pixel(&self) -> f32 {
        1.0 / self.scale
    }

    /// The lower right corner of the image: at least (1, 1), more along the longer side.
    pub fn extent(&self) -> Vec2 {
        self.middle / self.scale
    }

    /// How much of a shape is seen at signed distance `d`: 1 inside, 0 outside, a sharp edge between.
    pub fn cover(&self, d: f32) -> f32 {
        (0.5 - d * self.scale / EDGE).clamp(0.0, 1.0)
    }

    /// As [`paint`](Self::paint), where what is below is not worked out either if it is not seen.
    pub fn cover_with(&self, d: f32, above: impl FnOnce() -> f32, below: impl FnOnce() -> f32) -> f32 {
        let cover = self.cover(d);
        if cover <= 0.0 {
            below()
        } else if cover >= 1.0 {
            above()
        } else {
            below().lerp(above(), cover)
        }
    }

    /// Puts `above` over `below` where the shape with signed distance `d` covers it. `above` is not worked out
    /// where it is not seen.
    pub fn paint(&self, below: f32, d: f32, above: impl FnOnce() -> f32) -> f32 {
        let cover = self.cover(d);
        if cover > 0.0 { below.lerp(above(), cover) } else { below }
    }
}

/// 0 below `low`, 1 above `high`, smooth between; `low` may be above `high`, which turns it round.
pub fn smooth_step(low: f32, high: f32, x: f32) -> f32 {
    let s = ((x - low) / (high - low)).clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}

/// Largest whole number that is not above `x`, for |x| < 2³¹: `f32::floor` is a call into a library on processors
/// of the oldest kind, for which programs are built by default.
pub fn floor(x: f32) -> f32 {
    let whole = x as i32 as f32;
    if whole > x { whole - 1.0 } else { whole }
}

/// `x` less its [`floor`], in [0, 1).
pub fn fract(x: f32) -> f32 {
    x - floor(x)
}

/// Which of many small things may be at a place: squares, and what touches them.
#[derive(Clone, Debug)]
pub struct Buckets {
    /// Row by row: the indices of the things whose bounds touch the square.
    squares: Vec<Vec<u16>>,
}

impl Buckets {
    /// Squares along each side of [−1, 1]²; those at the rim go on outwards.
    const SIDE: usize = 32;

    /// Those of things with the given middles and half extents.
    pub fn new(bounds: impl IntoIterator<Item = (Vec2, Vec2)>) -> Self {
        let mut squares = vec![Vec::new(); Self::SIDE * Self::SIDE];
        for (index, (middle, half)) in bounds.into_iter().enumerate() {
            let ([left, top], [right, bottom]) = (Self::square(middle - half), Self::square(middle + half));
            for row in top..=bottom {
                for column in left..=right {
                    squares[row * Self::SIDE + column].push(index as u16);
                }
            }
        }
        Self { squares }
    }

    /// Column and row of the square at `p`.
    fn square(p: Vec2) -> [usize; 2] {
        let side = Self::SIDE as f32;
        [p.x, p.y].map(|x| ((x + 1.0) * side / 2.0).clamp(0.0, side - 1.0) as usize)
    }

    /// Indices of the things that may be at `p`, in their order.
    pub fn at(&self, p: Vec2) -> impl Iterator<Item = usize> {
        let [column, row] = Self::square(p);
        self.squares[row * Self::SIDE + column].iter().map(|index| usize::from(*index))
    }
}

/// Signed distance to a box with half extents `half` about the origin.
pub fn rectangle(p: Vec2, half: Vec2) -> f32 {
    let q = p.abs() - half;
    q.max(Vec2::ZERO).length() + q.max_element().min(0.0)
}

/// Signed distance to a box whose corners are rounded with radius `round`.
pub fn rounded(p: Vec2, half: Vec2, round: f32) -> f32 {
    rectangle(p, half - round) - round
}

/// Distance to the segment from `a` to `b`.
pub fn segment(p: Vec2, a: Vec2, b: Vec2) -> f32 {
    let (along, from) = (b - a, p - a);
    let share = (from.dot(along) / along.length_squared().max(1e-12)).clamp(0.0, 1.0);
    (from - share * along).length()
}

/// Approximate signed distance (exact sign, right slope at the rim) to an ellipse about the origin.
pub fn ellipse(p: Vec2, radii: Vec2) -> f32 {
    let k = (p / radii).length();
    let slope = (p / (radii * radii)).length();
    if slope > 0.0 { k * (k - 1.0) / slope } else { -radii.min_element() }
}

/// Normal of the side of a sphere that is seen at `p`, its centre at the origin; at and beyond the rim, that of
/// the rim.
pub fn sphere_normal(p: Vec2, radius: f32) -> Vec3 {
    let q = p / radius;
    let q = q / q.length().max(1.0);
    q.extend((1.0 - q.length_squared()).max(0.0).sqrt())
}

/// A solid of revolution about a vertical axis, as its radius at some heights.
#[derive(Clone, Debug)]
pub struct Lathe {
    /// (radius, y), y growing.
    profile: Vec<Vec2>,
}

impl Lathe {
    /// A solid through the given (radius, y) pairs, y growing. Between them the radius runs smoothly; an end
    /// with radius 0 is round.
    pub fn new(profile: &[(f32, f32)]) -> Self {
        Self { profile: profile.iter().map(|&(radius, y)| Vec2::new(radius, y)).collect() }
    }

    /// Radius at `y`, negative above and below the solid.
    pub fn radius(&self, y: f32) -> f32 {
        let next = self.profile.partition_point(|point| point.y <= y);
        if next == 0 || next == self.profile.len() {
            return -1.0;
        }
        let (a, b) = (self.profile[next - 1], self.profile[next]);
        if b.x > 0.0 {
            return a.x.lerp(b.x, smooth_step(a.y, b.y, y));
        }
        let s = (y - a.y) / (b.y - a.y);
        a.x * (1.0 - s * s).max(0.0).sqrt()
    }

    /// Approximate signed distance to the outline; the axis is x = 0.
    pub fn distance(&self, p: Vec2) -> f32 {
        let (first, last) = (self.profile[0].y, self.profile[self.profile.len() - 1].y);
        let outside = (first - p.y).max(p.y - last);
        (p.x.abs() - self.radius(p.y)).max(outside)
    }

    /// Normal of the side that is seen at `p` (as if upright, that is with the slope of the profile left out).
    pub fn normal(&self, p: Vec2) -> Vec3 {
        let s = (p.x / self.radius(p.y).max(1e-6)).clamp(-1.0, 1.0);
        Vec3::new(s, 0.0, (1.0 - s * s).sqrt())
    }
}

/// A block, turned in space.
#[derive(Clone, Copy, Debug)]
pub struct Brick {
    half: Vec3,
    turn: Mat3,
}

/// Where a block is seen.
#[derive(Clone, Copy, Debug)]
pub struct Face {
    /// Place on the face, in its own units, from its middle.
    pub place: Vec2,
    /// Half extents of the face.
    pub half: Vec2,
    /// Which face: 0–5 for −x, +x, −y, +y, −z, +z of the block.
    pub index: usize,
    /// Outward normal as seen.
    pub normal: Vec3,
}

impl Brick {
    /// A block with half extents `half` about the origin, turned by `turn`.
    pub fn new(half: Vec3, turn: Mat3) -> Self {
        Self { half, turn }
    }

    /// Radius of the sphere about the block.
    pub fn radius(&self) -> f32 {
        self.half.length()
    }

    /// The face that is seen at `p`, if the block is there.
    pub fn face(&self, p: Vec2) -> Option<Face> {
        let back = self.turn.transpose();
        let origin = back * p.extend(self.radius());
        let along = -back.z_axis;
        // Entry into each pair of planes; a ray along a face never meets it, so the slope is kept off 0.
        let along = Vec3::select(along.abs().cmplt(Vec3::splat(1e-6)), Vec3::splat(1e-6), along);
        let (middle, reach) = (-origin / along, self.half / along.abs());
        let (near, far) = (middle - reach, middle + reach);
        let enter = near.max_element();
        if enter > far.min_element() {
            return None;
        }
        let axis = near.max_position();
        let hit = origin + enter * along;
        let positive = along[axis] < 0.0;
        let normal = self.turn.col(axis) * if positive { 1.0 } else { -1.0 };
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        Some(Face {
            place: Vec2::new(hit[u], hit[v]),
            half: Vec2::new(self.half[u], self.half[v]),
            index: 2 * axis + usize::from(positive),
            normal,
        })
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these values are exact")]
mod tests {
    use super::*;

    #[test]
    fn distances_are_signed_and_exact_where_they_say_so() {
        assert_eq!(rectangle(Vec2::new(4.0, 5.0), Vec2::new(1.0, 1.0)), 5.0);
        assert_eq!(rectangle(Vec2::ZERO, Vec2::new(1.0, 2.0)), -1.0);
        assert_eq!(rounded(Vec2::new(2.0, 0.0), Vec2::new(1.0, 1.0), 0.25), 1.0);
        assert_eq!(segment(Vec2::new(0.0, 3.0), Vec2::new(-1.0, 0.0), Vec2::new(1.0, 0.0)), 3.0);
        assert_eq!(segment(Vec2::new(0.0, 3.0), Vec2::ZERO, Vec2::ZERO), 3.0);
        assert!(ellipse(Vec2::new(1.9, 0.0), Vec2::new(2.0, 1.0)) < 0.0);
        assert!(ellipse(Vec2::new(0.0, 1.1), Vec2::new(2.0, 1.0)) > 0.0);
    }

    #[test]
    fn a_block_shows_the_face_that_looks_at_the_viewer() {
        let block = Brick::new(Vec3::new(1.0, 2.0, 3.0), Mat3::IDENTITY);
        let face = block.face(Vec2::new(0.5, -1.5)).expect("the block is there");
        assert_eq!((face.index, face.normal), (5, Vec3::Z));
        assert!((face.place - Vec2::new(0.5, -1.5)).length() < 1e-5);
        assert!(block.face(Vec2::new(1.1, 0.0)).is_none());
        let turned = Brick::new(Vec3::new(1.0, 2.0, 3.0), Mat3::from_rotation_y(std::f32::consts::FRAC_PI_2));
        let face = turned.face(Vec2::new(2.9, 0.0)).expect("its long side is seen");
        assert_eq!(face.index / 2, 0);
        assert!((face.normal - Vec3::Z).length() < 1e-5);
    }

    #[test]
    fn floors_are_floors() {
        for x in [-2.0, -1.5, -1e-7, 0.0, 0.3, 1.0, 7.999, 1e6] {
            assert_eq!(floor(x), f32::floor(x));
            assert!((0.0..=1.0).contains(&fract(x)));
        }
    }

    #[test]
    fn buckets_find_what_is_there() {
        let things = [(Vec2::ZERO, Vec2::splat(0.2)), (Vec2::new(0.9, -3.0), Vec2::splat(0.5))];
        let buckets = Buckets::new(things);
        let at = |x, y| buckets.at(Vec2::new(x, y)).collect::<Vec<_>>();
        assert_eq!(at(0.15, -0.19), [0]);
        assert!(at(0.5, 0.5).is_empty());
        assert_eq!(at(1.3, -2.6), [1]);
    }

    #[test]
    fn the_square_fits_any_image() {
        for (height, width) in [(128, 128), (64, 256), (300, 100), (1, 1)] {
            let stage = Stage::new(height, width);
            let corner = stage.point(Vec2::new(width as f32, height as f32));
            assert_eq!(corner, stage.extent());
            assert_eq!(corner.min_element(), 1.0);
        }
    }
}

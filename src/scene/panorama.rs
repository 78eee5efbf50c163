//! Scenes cut from equirectangular panoramas: a moving camera, textured movers in front, flicker.

use std::f32::consts::{FRAC_PI_2, PI, TAU};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{Mat3, Quat, Vec2, Vec3};

use super::Scene;
use crate::video::{self, Video, VideoError};
use crate::{At, Error, Result};

/// An equirectangular image: columns are longitude, rows latitude from the zenith down.
#[derive(Clone, Debug)]
pub struct Panorama {
    /// File name without its ending.
    pub name: String,
    image: Video,
}

impl Panorama {
    /// Reads an EXR or Radiance panorama.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let image = video::read(path)?;
        if image.width < 8 || image.height < 4 {
            return Err(VideoError::Shape("too small for a panorama".into())).at(path);
        }
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        Ok(Self { name, image })
    }

    /// Reads all panoramas of a folder, in the order of their names.
    pub fn read_folder(folder: impl AsRef<Path>) -> Result<Vec<Arc<Self>>> {
        let folder = folder.as_ref();
        let is_picture = |path: &PathBuf| video::is_picture(path);
        let mut paths: Vec<PathBuf> = Vec::new();
        for entry in std::fs::read_dir(folder).at(folder)? {
            paths.extend(Some(entry.at(folder)?.path()).filter(is_picture));
        }
        paths.sort();
        if paths.is_empty() {
            return Err(Error::Usage("no .exr or .hdr panoramas in it".into()).at(folder));
        }
        paths.iter().map(|path| Self::read(path).map(Arc::new)).collect()
    }

    /// Radiance from direction `d` (any length; y up), bilinear.
    pub fn look(&self, d: Vec3) -> f32 {
        let longitude = atan2(d.x, -d.z) / TAU + 0.5;
        let latitude = atan2((d.x * d.x + d.z * d.z).sqrt(), d.y) / PI;
        self.bilinear(longitude * self.image.width as f32 - 0.5, latitude * self.image.height as f32 - 0.5)
    }

    fn bilinear(&self, x: f32, y: f32) -> f32 {
        let (width, height) = (self.image.width as i32, self.image.height as i32);
        // Both are above −1, where truncation after adding 1 is the floor.
        let (x0, y0) = ((x + 1.0) as i32 - 1, (y + 1.0) as i32 - 1);
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let wrap = |column: i32| {
            if column < 0 {
                column + width
            } else if column < width {
                column
            } else {
                0
            }
        };
        let columns = [wrap(x0), wrap(x0 + 1)];
        let rows = [y0.clamp(0, height - 1), (y0 + 1).clamp(0, height - 1)];
        let at = |r: usize, c: usize| self.image.data[(rows[r] * width + columns[c]) as usize];
        let top = at(0, 0) + fx * (at(0, 1) - at(0, 0));
        let bottom = at(1, 0) + fx * (at(1, 1) - at(1, 0));
        top + fy * (bottom - top)
    }
}

/// Arc tangent of y/x in the right quadrant, within 2·10⁻⁵ rad: far below a panorama's pixel, and several times
/// faster than the library's, which takes most of the time of rendering.
fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let z = if large > 0.0 { small / large } else { 0.0 };
    let z2 = z * z;
    // Minimax polynomial of atan on [0, 1], Abramowitz & Stegun 4.4.49.
    let octant =
        z * (0.999_866 + z2 * (-0.330_299_5 + z2 * (0.180_141 + z2 * (-0.085_133 + z2 * 0.020_835_1))));
    let quadrant = if ax < ay { FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    half.copysign(y)
}

/// A pinhole camera inside a panorama.
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    /// Orientation at time 0: camera axes (x right, y up, −z forward) to panorama axes.
    pub orientation: Quat,
    /// Focal length in pixels.
    pub focal: f32,
    /// Image position of the optical axis, px.
    pub centre: Vec2,
}

/// Motion of a camera or mover in the image.
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion {
    /// Speed in px/frame, y down.
    pub velocity: Vec2,
    /// Rotation in rad/frame, clockwise as seen.
    pub rotation: f32,
    /// Amplitude in px of a swing along the velocity's normal.
    pub swing: Vec2,
    /// Period of the swing in frames.
    pub swing_period: f32,
}

impl Motion {
    /// Displacement in px at time `t`.
    fn displacement(&self, t: f32) -> Vec2 {
        let swing = if self.swing_period > 0.0 { (TAU * t / self.swing_period).sin() } else { 0.0 };
        self.velocity * t + self.swing * swing
    }
}

/// A textured object in front of the panorama.
#[derive(Clone, Debug)]
pub struct Mover {
    /// Where it is at time 0, px.
    pub position: Vec2,
    /// How it moves.
    pub motion: Motion,
    /// Half axes of its superellipse, px.
    pub half_axes: Vec2,
    /// Exponent of its superellipse: 2 an ellipse, 8 nearly a rectangle, 1 a rhombus.
    pub exponent: f32,
    /// Camera that sees its texture.
    pub texture: Pinhole,
    /// Panorama of its texture.
    pub panorama: Arc<Panorama>,
    /// Factor on its texture.
    pub gain: f32,
}

/// Light that changes with time: factor 1 + depth·sin.
#[derive(Clone, Copy, Debug, Default)]
pub struct Flicker {
    /// Relative amplitude, 0 to 1.
    pub depth: f32,
    /// Period in frames.
    pub period: f32,
    /// Phase at time 0, in periods.
    pub phase: f32,
}

impl Flicker {
    fn factor(&self, t: f32) -> f32 {
        if self.depth > 0.0 { 1.0 + self.depth * (TAU * (t / self.period + self.phase)).sin() } else { 1.0 }
    }
}

/// A clip: a camera that turns inside a panorama, and movers in front.
#[derive(Clone, Debug)]
pub struct PanoramaScene {
    /// What the camera sees.
    pub panorama: Arc<Panorama>,
    /// The camera at time 0.
    pub camera: Pinhole,
    /// How the image moves.
    pub motion: Motion,
    /// Objects, the nearest first.
    pub movers: Vec<Mover>,
    /// Flicker of all light on the background.
    pub flicker: Flicker,
    /// Flicker of the movers.
    pub mover_flicker: Flicker,
}

impl Pinhole {
    /// Matrix from image position relative to the centre (x right, y down, and the focal length) to a direction
    /// in the panorama, for an image that has moved by `shift` px and turned by `angle`.
    fn rays(&self, shift: Vec2, angle: f32) -> Mat3 {
        // The image moves right if the camera turns left (about +y), and down if it turns up (about +x).
        let turn = Quat::from_scaled_axis(Vec3::new(shift.y, shift.x, 0.0) / self.focal);
        let roll = Quat::from_rotation_z(angle);
        Mat3::from_quat(self.orientation * turn * roll) * Mat3::from_diagonal(Vec3::new(1.0, -1.0, -1.0))
    }
}

impl Scene for PanoramaScene {
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_> {
        let camera = self.camera;
        let rays = camera.rays(self.motion.displacement(t), self.motion.rotation * t);
        let light = self.flicker.factor(t);
        let movers: Vec<_> = self
            .movers
            .iter()
            .map(|mover| {
                let position = mover.position + mover.motion.displacement(t);
                let turn = Vec2::from_angle(-mover.motion.rotation * t);
                (mover, position, turn, mover.texture.rays(Vec2::ZERO, 0.0))
            })
            .collect();
        let mover_light = self.mover_flicker.factor(t);
        Box::new(move |at| {
            for (mover, position, turn, texture) in &movers {
                let own = turn.rotate(at - *position);
                let inside = (own / mover.half_axes).abs();
                if inside.max_element() > 1.0 {
                    continue;
                }
                if inside.x.powf(mover.exponent) + inside.y.powf(mover.exponent) <= 1.0 {
                    return mover_light
                        * mover.gain
                        * mover.panorama.look(*texture * own.extend(mover.texture.focal));
                }
            }
            light * self.panorama.look(rays * (at - camera.centre).extend(camera.focal))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_close_to_the_library() {
        for i in 0..1000 {
            let angle = (i as f32 / 1000.0 - 0.5) * 2.0 * PI;
            let (y, x) = angle.sin_cos();
            assert!((atan2(3.0 * y, 3.0 * x) - y.atan2(x)).abs() < 2e-5, "at {angle}");
        }
        assert!(atan2(0.0, 0.0).abs() < 1e-6);
    }

    /// The image moves by the speed that is asked for, in the direction that is asked for.
    #[test]
    fn image_speed_is_as_asked() {
        let camera =
            Pinhole { orientation: Quat::from_rotation_y(0.7), focal: 150.0, centre: Vec2::splat(64.0) };
        for velocity in [Vec2::new(2.0, 0.0), Vec2::new(0.0, -1.5), Vec2::new(0.3, 0.4)] {
            let ray = camera.rays(Vec2::ZERO, 0.0) * Vec2::ZERO.extend(camera.focal);
            // Where the point on the axis at time 0 is seen at time 1.
            let seen = camera.rays(velocity, 0.0).inverse() * ray;
            let moved = Vec2::new(seen.x, seen.y) * camera.focal / seen.z;
            assert!((moved - velocity).length() < 0.01, "{velocity} became {moved}");
        }
    }
}

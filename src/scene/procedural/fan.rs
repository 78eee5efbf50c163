//! A fan beside a bulb.

use std::f32::consts::TAU;

use glam::{FloatExt, Vec2, Vec3};

use super::super::Scene;
use super::chart::Chart;
use super::glyph::Text;
use super::light::{Lamp, glow};
use super::shape::{Lathe, Stage, ellipse, fract, rectangle, rounded, segment, smooth_step, sphere_normal};
use super::texture::NoiseTexture;

/// Hub of the fan.
const HUB: Vec2 = Vec2::new(-0.40, -0.12);
/// Radius of the blades.
const REACH: f32 = 0.55;
/// How far the blades are before the wall.
const BLADES_Z: f32 = 0.2;
/// Middle of the bulb. Its filament is there, too.
const BULB: Vec3 = Vec3::new(0.52, -0.50, 0.55);
/// Edge of the desk against the wall.
const DESK: f32 = 0.70;
/// Left end, upper edge, thickness and depth of the shelf, which keeps the light from the chart.
const SHELF: Vec2 = Vec2::new(0.20, 0.0);
const SHELF_HEIGHT: f32 = 0.05;
const SHELF_DEPTH: f32 = 0.5;
/// Middle and half extent of the chart.
const CHART: Vec2 = Vec2::new(0.63, 0.40);
const CHART_HALF: f32 = 0.29;
/// Light that comes from everywhere: radiance of a white surface.
const AMBIENT: f32 = 0.002;

/// The paper's scene: a fan whose three blades carry H, D and R, beside a bare hanging bulb with filament and
/// glow; in the shadow of a shelf a resolution chart; a plastered wall and a wooden desk. The bulb lights it
/// all (inverse square law), the blades' shadow runs over the wall.
///
/// Radiance: bulb glass about 1, filament 30, wall beside the bulb 0.15, white letters 0.03, chart 0.002 (white)
/// to 0.0002 (black).
#[derive(Clone, Debug)]
pub struct Fan {
    stage: Stage,
    /// Turn in radians per frame.
    turn: f32,
    plaster: NoiseTexture,
    wood: NoiseTexture,
    lamp: Lamp,
    letters: [Text; 3],
    chart: Chart,
    bulb: Lathe,
    sign: Text,
}

impl Fan {
    /// The scene for images of `height` × `width` pixels. The fan turns in 150 frames: 400 rpm at 1000 fps, and
    /// the letters move by 1.2 px/frame at 128 × 128.
    pub fn new(height: usize, width: usize, seed: u64) -> Self {
        Self {
            stage: Stage::new(height, width),
            turn: TAU / 150.0,
            plaster: NoiseTexture::new(seed, 0),
            wood: NoiseTexture::new(seed, 1),
            lamp: Lamp { position: BULB, intensity: 0.11 },
            letters: ["H", "D", "R"].map(|letter| Text::new(letter, 0.25, 0.17)),
            chart: Chart::new(),
            bulb: Lathe::new(&[(0.045, -0.72), (0.045, -0.66), (0.118, -0.49), (0.0, -0.375)]),
            sign: Text::new("PIX2HDR", 0.036, 0.18),
        }
    }

    /// The same with the fan turning once in `frames` (backwards if negative, not at all if infinite or 0).
    #[must_use]
    pub fn with_period(self, frames: f32) -> Self {
        let turn = TAU / frames;
        Self { turn: if turn.is_finite() { turn } else { 0.0 }, ..self }
    }

    /// Radiance of a white surface: the bulb, shadowed by the shelf, and the rest of the room.
    fn light(&self, point: Vec3, normal: Vec3) -> f32 {
        let bulb = self.lamp.on(point, normal);
        if point.y <= SHELF.y || point.x < SHELF.x - 0.75 {
            return bulb + AMBIENT;
        }
        // Below the shelf it gets darker the deeper and the further from the open end.
        let under = smooth_step(SHELF.y, SHELF.y + 0.05, point.y) * smooth_step(0.0, 0.35, point.x - SHELF.x);
        let ambient = AMBIENT * (1.0 - 0.55 * under * smooth_step(0.6, 0.0, point.z));
        // Where the way to the bulb crosses the shelf, and how wide the bulb's half shadow is there.
        let share = (point.y - SHELF.y) / (point.y - BULB.y);
        let crossing = point.lerp(BULB, share);
        let blur = 0.02 + 0.12 * share;
        let blocked = smooth_step(-blur, blur, crossing.x - SHELF.x)
            * smooth_step(blur, -blur, crossing.z - SHELF_DEPTH);
        bulb * (1.0 - blocked) + ambient
    }

    fn wall(&self, p: Vec2, blades: &Blades) -> f32 {
        let point = p.extend(0.0);
        // Shadow of the blades, where the way to the bulb crosses their plane.
        let crossing = p.lerp(BULB.truncate(), BLADES_Z / BULB.z) - HUB;
        let open = if crossing.length_squared() < (REACH + 0.08).powi(2) {
            let (blade, _) = blades.at(crossing);
            smooth_step(-0.04, 0.04, blade.min(crossing.length() - 0.1))
        } else {
            1.0
        };
        let light = self.light(point, Vec3::Z);
        let light = open * light + (1.0 - open) * light.min(AMBIENT);
        let skirting = if p.y > DESK - 0.09 { 1.25 } else { 1.0 };
        let groove = smooth_step(0.0, 0.012, (p.y - DESK + 0.09).abs());
        0.42 * skirting * (0.4 + 0.6 * groove) * light * self.plaster.plaster(p)
    }

    fn desk(&self, p: Vec2) -> f32 {
        let z = 2.0 * (p.y - DESK);
        let point = Vec3::new(p.x, DESK, z);
        let foot = ellipse(p - Vec2::new(HUB.x, DESK + 0.12), Vec2::new(0.24, 0.09));
        let contact = 0.45 + 0.55 * smooth_step(-0.03, 0.07, foot);
        let grain = self.wood.wood(Vec2::new(p.x, z));
        let shine = 0.02 * glow(p.x - BULB.x, 0.16) * grain * smooth_step(0.15, 0.3, p.y - DESK);
        0.4 * grain * contact * self.light(point, Vec3::NEG_Y) + shine
    }

    /// Foot, pole and motor of the fan.
    fn stand(&self, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        let q = p - HUB;
        if q.x.abs() > 0.3 || q.y < 0.0 {
            return below();
        }
        let foot = ellipse(q - Vec2::new(0.0, DESK + 0.10 - HUB.y), Vec2::new(0.22, 0.075));
        let foot_light = || {
            let lit = self.light(Vec3::new(p.x, DESK, 0.2), Vec3::NEG_Y);
            0.25 * lit * (1.0 + 2.0 * smooth_step(0.03, 0.0, (foot + 0.025).abs()))
        };
        let pole = rounded(q - Vec2::new(0.0, 0.45), Vec2::new(0.032, 0.47), 0.02);
        let pole_light = || {
            let s = (q.x / 0.032).clamp(-1.0, 1.0);
            let normal = Vec3::new(s, 0.0, (1.0 - s * s).sqrt());
            let point = p.extend(0.1);
            let shine = 0.08 * self.lamp.highlight(point, normal, 60.0);
            0.3 * self.light(point, normal) + shine
        };
        self.stage.cover_with(pole, pole_light, || self.stage.cover_with(foot, foot_light, below))
    }

    fn blades(&self, p: Vec2, blades: &Blades, below: impl FnOnce() -> f32) -> f32 {
        let q = p - HUB;
        let r = q.length();
        if r > REACH + 0.06 {
            return below();
        }
        let (d, place) = blades.at(q);
        let blade = || {
            // The blades are pitched: the side that leads is nearer to the viewer.
            let across = blades.leading(place.index);
            let normal = (Vec3::Z + 0.45 * across.extend(0.0) + 0.25 * q.extend(0.0)).normalize();
            let point = p.extend(BLADES_Z);
            let light = self.light(point, normal);
            let letter = self.letters[place.index].distance(Vec2::new(place.across, 0.365 - place.along));
            let rim = smooth_step(0.0, 0.02, -d);
            let plastic =
                (0.045 + 0.05 * (1.0 - rim)) * light + 0.006 * self.lamp.highlight(point, normal, 25.0);
            self.stage.paint(plastic, letter, || 0.9 * light)
        };
        let hub = || {
            let normal = sphere_normal(q, 0.13);
            let point = p.extend(BLADES_Z + 0.05);
            let screw = if r < 0.03 { 0.5 } else { 1.0 };
            0.5 * screw * self.light(point, normal) + 0.25 * self.lamp.highlight(point, normal, 120.0)
        };
        let mut v = self.stage.cover_with(r - 0.105, hub, || self.stage.cover_with(d, blade, below));
        // Two rings of the guard.
        for (radius, wire) in [(0.575, 0.008), (0.40, 0.004)] {
            v = self.stage.paint(v, (r - radius).abs() - wire, || {
                let s = ((r - radius) / wire).clamp(-1.0, 1.0);
                let normal = (q / r * s).extend((1.0 - s * s).max(0.0).sqrt());
                let point = p.extend(BLADES_Z + 0.12);
                0.45 * self.light(point, normal) + 0.15 * self.lamp.highlight(point, normal, 40.0)
            });
        }
        v
    }

    fn shelf(&self, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        let reach = self.stage.extent().x.max(1.0) + 1.0;
        let half = Vec2::new((reach - SHELF.x) / 2.0, SHELF_HEIGHT / 2.0);
        let q = p - SHELF - half;
        let front = || {
            let light = self.light(p.with_y(SHELF.y).extend(SHELF_DEPTH), Vec3::Z);
            let grain = self.wood.wood(Vec2::new(p.x + 5.0, 0.15 + 0.5 * q.y));
            let text = self.sign.distance(p - SHELF - Vec2::new(0.17, SHELF_HEIGHT / 2.0));
            let edge = 1.0 + 2.0 * smooth_step(0.012, 0.0, p.y - SHELF.y);
            self.stage.paint(0.35 * grain * edge * light, text, || 0.02 * light)
        };
        self.stage.cover_with(rectangle(q, half), front, below)
    }

    fn card(&self, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        let q = p - CHART;
        let card = || {
            let light = self.light(p.extend(0.02), Vec3::Z);
            let ink = self.chart.ink(&self.stage, q / CHART_HALF, CHART_HALF);
            light * 0.9.lerp(0.05, ink) * (0.95 + 0.1 * self.plaster.value(30.0 * p))
        };
        self.stage.cover_with(rounded(q, Vec2::splat(CHART_HALF), 0.01), card, below)
    }

    /// Bulb, socket and cord; the glow is over everything.
    fn bulb(&self, below: f32, p: Vec2) -> f32 {
        let q = p - BULB.truncate();
        let r = q.length();
        let v = below + 0.10 * glow(r, 0.12) + 0.0012 * glow(r, 0.6);
        if q.x.abs() > 0.13 || p.y > -0.36 {
            return v;
        }
        let v = self.stage.paint(v, rectangle(q + Vec2::new(0.0, 2.0), Vec2::new(0.009, 1.78)), || 0.003);
        let glass = self.bulb.distance(Vec2::new(q.x, p.y));
        let mut v = self.stage.paint(v, glass, || {
            let normal = self.bulb.normal(Vec2::new(q.x, p.y));
            // Pearly glass: brightest where the filament shines through.
            0.35 + 0.55 * normal.z + 2.5 * glow(r, 0.045)
        });
        // The filament hangs in a zigzag.
        let zigzag = 0.016 * (4.0 * (fract(q.x / 0.04) - 0.5).abs() - 1.0);
        let filament = (q.y - zigzag).abs().max(q.x.abs() - 0.052) - 0.007;
        v = self.stage.paint(v, filament, || 30.0);
        for side in [-0.052_f32, 0.052] {
            let wire = segment(q, Vec2::new(side, 0.0), Vec2::new(0.4 * side, -0.17)) - 0.003;
            v = self.stage.paint(v, wire.max(glass), || 0.15);
        }
        let socket = rounded(q + Vec2::new(0.0, 0.19), Vec2::new(0.05, 0.055), 0.012);
        self.stage.paint(v, socket, || {
            let s = (q.x / 0.05).clamp(-1.0, 1.0);
            let thread = 0.6 + 0.4 * (q.y * 230.0).sin();
            0.008 + 0.09 * thread * (1.0 - s * s) * smooth_step(-0.26, -0.12, q.y)
        })
    }
}

/// The blades at an instant.
struct Blades {
    /// Direction of each blade.
    along: [Vec2; 3],
}

/// A place on a blade.
struct OnBlade {
    index: usize,
    /// Distance from the axis along the middle of the blade.
    along: f32,
    /// Distance from the middle of the blade, positive clockwise.
    across: f32,
}

impl Blades {
    fn new(angle: f32) -> Self {
        Self { along: [0.0, 1.0, 2.0].map(|i| Vec2::from_angle(angle + i * TAU / 3.0)) }
    }

    /// Approximate signed distance to the blades at `q` from the hub, and the place on the nearest.
    fn at(&self, q: Vec2) -> (f32, OnBlade) {
        let reach = self.along.map(|direction| direction.dot(q));
        let mut index = usize::from(reach[1] > reach[0]);
        index = if reach[2] > reach[index] { 2 } else { index };
        let (along, across) = (reach[index], self.along[index].perp_dot(q));
        // Broad outside, swept a little, with round corners.
        let sweep = 0.10 * (along / REACH).powi(2) - 0.03;
        let half = 0.055 + 0.165 * smooth_step(0.05, 0.42, along);
        let (side, end) = ((across - sweep).abs() - half, q.length() - REACH);
        let round = 0.06;
        let corner = Vec2::new(side + round, end + round);
        let d = corner.max(Vec2::ZERO).length() + corner.max_element().min(0.0) - round;
        (d, OnBlade { index, along, across: across - sweep })
    }

    /// Direction from the middle of a blade to its leading side.
    fn leading(&self, index: usize) -> Vec2 {
        self.along[index].perp()
    }
}

impl Scene for Fan {
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_> {
        let blades = Blades::new((self.turn * t).rem_euclid(TAU) - TAU / 4.0);
        Box::new(move |position| {
            let p = self.stage.point(position);
            // From the front to the back: what is hidden is not worked out.
            let back = || if p.y < DESK { self.wall(p, &blades) } else { self.desk(p) };
            let shelf = || self.shelf(p, || self.card(p, back));
            let v = self.blades(p, &blades, || self.stand(p, shelf));
            self.bulb(v, p)
        })
    }
}

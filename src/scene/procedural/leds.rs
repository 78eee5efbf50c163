//! Two LEDs.

use glam::{FloatExt, Vec2, Vec3};

use super::super::Scene;
use super::glyph::Text;
use super::light::{Lamp, glow};
use super::shape::{Buckets, Stage, floor, fract, rectangle, rounded, segment, smooth_step, sphere_normal};
use super::texture::NoiseTexture;

/// Frames from one switching-on to the next.
const CYCLE: f32 = 32.0;
/// Frames in a cycle at which the right LED and the left LED go on: 2 ms apart at 1000 fps.
const ON: [f32; 2] = [4.0, 6.0];
/// Frames for which each is on.
const LIT: f32 = 12.0;
/// Where the right and the left LED are.
const PLACES: [Vec2; 2] = [Vec2::new(0.36, -0.18), Vec2::new(-0.36, -0.18)];
/// Radius of an LED's lens.
const LENS: f32 = 0.145;
/// How far the light of an LED is above the board.
const HEIGHT: f32 = 0.12;
/// Room light: radiance of a white surface.
const AMBIENT: f32 = 0.003;

/// A circuit board from above with two LEDs, R and L. R goes on at frame 4, L at frame 6, both for 12 frames,
/// again every 32 frames (the paper's transient events, 2 ms apart). An LED that is on lights the board
/// (inverse square law) with its parts and printed marks and has a glow; the rest of the time there is only a
/// little room light.
///
/// Radiance: lens of an LED that is on 1 to 4, its die 40, white print beside it 0.1 and in room light 0.0025,
/// black parts 0.0001.
#[derive(Clone, Debug)]
pub struct Leds {
    stage: Stage,
    board: NoiseTexture,
    lamps: [Lamp; 2],
    prints: Vec<(Vec2, Text)>,
    prints_at: Buckets,
    tracks: Vec<[Vec2; 2]>,
    tracks_at: Buckets,
    parts: Vec<Part>,
}

/// A part in a black housing with leads at its ends or sides.
#[derive(Clone, Debug)]
struct Part {
    middle: Vec2,
    half: Vec2,
    /// Leads on each of the long sides; 0 is a chip with a metal cap at each end.
    leads: usize,
    mark: Text,
}

impl Leds {
    /// The scene for images of `height` × `width` pixels.
    pub fn new(height: usize, width: usize, seed: u64) -> Self {
        let print = |x: f32, y: f32, size: f32, text: &str| (Vec2::new(x, y), Text::new(text, size, 0.17));
        let part = |x: f32, y: f32, half: Vec2, leads: usize, mark: &str| Part {
            middle: Vec2::new(x, y),
            half,
            leads,
            mark: Text::new(mark, if leads == 0 { 0.055 } else { 0.075 }, 0.16),
        };
        let resistor = Vec2::new(0.115, 0.055);
        let corners = |points: &[(f32, f32)]| -> Vec<[Vec2; 2]> {
            points.windows(2).map(|ends| [ends[0], ends[1]].map(Vec2::from)).collect()
        };
        let prints = vec![
            print(-0.36, -0.50, 0.15, "L"),
            print(0.36, -0.50, 0.15, "R"),
            print(0.0, -0.84, 0.11, "PIX2HDR"),
            print(-0.73, -0.06, 0.06, "D2"),
            print(0.73, -0.06, 0.06, "D1"),
            print(-0.36, 0.37, 0.06, "R2"),
            print(0.36, 0.37, 0.06, "R1"),
            print(0.0, -0.32, 0.065, "2 MS"),
            print(-0.62, 0.89, 0.05, "REV 1.0"),
            print(0.62, 0.89, 0.05, "1000 FPS"),
        ];
        let tracks: Vec<[Vec2; 2]> = [
            corners(&[(-0.36, -0.05), (-0.36, 0.26), (-0.47, 0.26)]),
            corners(&[(0.36, -0.05), (0.36, 0.26), (0.47, 0.26)]),
            corners(&[(-0.25, 0.26), (-0.12, 0.40), (-0.12, 0.52)]),
            corners(&[(0.25, 0.26), (0.12, 0.40), (0.12, 0.52)]),
            corners(&[(-0.50, -0.18), (-0.85, -0.18), (-0.85, 0.55), (-0.30, 0.55)]),
            corners(&[(0.50, -0.18), (0.85, -0.18), (0.85, 0.55), (0.30, 0.55)]),
            corners(&[(-0.22, -0.18), (-0.08, -0.04), (-0.08, 0.20), (-0.02, 0.26), (-0.02, 0.52)]),
            corners(&[(0.22, -0.18), (0.08, -0.04), (0.08, 0.20), (0.02, 0.26), (0.02, 0.52)]),
        ]
        .concat();
        let prints_at = Buckets::new(prints.iter().map(|(at, text)| (*at, text.half() + 0.05)));
        let span = |[a, b]: &[Vec2; 2]| ((*a + *b) / 2.0, (*b - *a).abs() / 2.0 + 0.06);
        let tracks_at = Buckets::new(tracks.iter().map(span));
        Self {
            stage: Stage::new(height, width),
            board: NoiseTexture::new(seed, 0),
            lamps: PLACES.map(|place| Lamp { position: place.extend(HEIGHT), intensity: 0.012 }),
            prints,
            prints_at,
            tracks,
            tracks_at,
            parts: vec![
                part(-0.36, 0.26, resistor, 0, "221"),
                part(0.36, 0.26, resistor, 0, "221"),
                part(0.0, 0.66, Vec2::new(0.30, 0.13), 6, "MPVE-4"),
            ],
        }
    }

    /// Whether the right and the left LED are on at time `t`.
    fn on(t: f32) -> [bool; 2] {
        let phase = t.rem_euclid(CYCLE);
        ON.map(|on| (on..on + LIT).contains(&phase))
    }

    /// Radiance of a white surface and strength of the highlights there.
    fn light(&self, p: Vec2, height: f32, normal: Vec3, on: [bool; 2], sharpness: f32) -> (f32, f32) {
        let point = p.extend(height);
        // Room light comes from the upper left.
        let room = AMBIENT
            * (0.75 - 0.18 * p.x - 0.18 * p.y).max(0.2)
            * (0.4 + 0.6 * normal.z - 0.4 * (normal.x + normal.y)).max(0.1);
        let mut sum = (room, 0.0);
        for (lamp, _) in self.lamps.iter().zip(on).filter(|(_, on)| *on) {
            sum.0 += lamp.on(point, normal);
            if sharpness > 0.0 {
                sum.1 += lamp.highlight(point, normal, sharpness) * glow(point.distance(lamp.position), 0.3);
            }
        }
        sum
    }

    fn board(&self, p: Vec2, on: [bool; 2]) -> f32 {
        // Solder mask over glass fibre; over copper it is lighter.
        let weave = (fract(14.0 * p.x) - 0.5).abs() + (fract(14.0 * p.y) - 0.5).abs();
        let mask = 0.05 * (0.7 + 0.25 * weave + 0.5 * self.board.fractal(5.0 * p, 2));
        let track = self.tracks_at.at(p).fold(1.0_f32, |d, index| {
            let [a, b] = self.tracks[index];
            d.min(segment(p, a, b))
        });
        let mut reflectance = self.stage.paint(mask, track - 0.022, || 0.17);
        // Plated holes in a row at the lower edge and at the ends of the tracks.
        let row = Vec2::new(floor(p.x / 0.17 + 0.5).clamp(-2.0, 2.0) * 0.17, -0.66);
        let hole = p.distance(row);
        reflectance = self.stage.paint(reflectance, hole - 0.05, || 0.45);
        reflectance = self.stage.paint(reflectance, hole - 0.026, || 0.01);
        for (at, text) in self.prints_at.at(p).map(|index| &self.prints[index]) {
            reflectance = self.stage.paint(reflectance, text.distance(p - *at), || 0.85);
        }
        // Outlines of the LEDs, flat on the side of the cathode.
        for place in PLACES {
            let q = p - place;
            let outline = (q.length() - LENS - 0.05).max(q.y - LENS);
            reflectance = self.stage.paint(reflectance, outline.abs() - 0.008, || 0.85);
        }
        let (light, shine) = self.light(p, 0.0, Vec3::Z, on, 60.0);
        reflectance * light + 0.004 * shine
    }

    fn part(&self, below: f32, p: Vec2, part: &Part, on: [bool; 2]) -> f32 {
        let Part { middle, half, leads, mark } = part;
        let q = p - *middle;
        let bound = rectangle(q, *half + 0.06);
        if bound > 0.0 {
            return below;
        }
        let mut v = below * (0.35 + 0.65 * smooth_step(-0.01, 0.05, rectangle(q - 0.012, *half)));
        let metal = if *leads == 0 {
            rounded(q, *half, 0.01)
        } else {
            let pitch = 2.0 * half.x / *leads as f32;
            let x = fract(q.x / pitch + 0.5) - 0.5;
            rectangle(Vec2::new(x * pitch, q.y.abs() - half.y), Vec2::new(0.25 * pitch, 0.05))
                .max(q.x.abs() - half.x)
        };
        v = self.stage.paint(v, metal, || {
            let normal = Vec3::new(0.0, 0.5 * q.y.signum(), 0.87);
            let (light, shine) = self.light(p, 0.02, normal, on, 12.0);
            0.5 * light + 0.1 * shine
        });
        let housing = if *leads == 0 { *half - Vec2::new(0.03, 0.0) } else { *half - Vec2::new(0.0, 0.012) };
        self.stage.paint(v, rounded(q, housing, 0.008), || {
            let bevel = rounded(q, housing - 0.018, 0.008).max(0.0) * 35.0;
            let normal = (Vec3::Z + bevel * q.signum().extend(0.0) * 0.7).normalize();
            let (light, shine) = self.light(p, 0.05, normal, on, 20.0);
            let speckle = 0.8 + 0.4 * self.board.value(90.0 * p);
            let black = 0.028 * speckle * light + 0.003 * shine;
            let dot = if *leads == 0 { 1.0 } else { (q - Vec2::new(-0.25, 0.07)).length() - 0.018 };
            let black = self.stage.paint(black, dot, || 0.008 * light);
            self.stage.paint(black, mark.distance(q), || 0.6 * light)
        })
    }

    fn led(&self, below: f32, p: Vec2, index: usize, on: [bool; 2]) -> f32 {
        let q = p - PLACES[index];
        let r = q.length();
        let mut v = below;
        if on[index] {
            v += 0.10 * glow(r, 0.16) + 0.0015 * glow(r, 0.8);
        } else if r < 0.3 {
            v *= 0.35 + 0.65 * smooth_step(LENS - 0.02, LENS + 0.05, (q - 0.015).length());
        }
        self.stage.paint(v, r - LENS, || {
            let normal = sphere_normal(q, LENS);
            // The cup with the die, the bond wire and the rim of the lens are seen whether it is on or not.
            let cup = smooth_step(0.085, 0.075, r);
            let die = rectangle(q, Vec2::splat(0.027));
            let wire = segment(q, Vec2::new(0.0, 0.0), Vec2::new(0.10, -0.03)) - 0.006;
            let rim = smooth_step(0.80, 0.95, r / LENS);
            let mut others = on;
            others[index] = false;
            let (light, shine) = self.light(p, 0.1, normal, others, 80.0);
            let window = rounded(q + Vec2::new(0.055, 0.06), Vec2::new(0.022, 0.016), 0.005);
            let off = (0.22 - 0.10 * cup + 0.12 * rim) * light + 0.05 * shine;
            let off = self.stage.paint(off, wire, || 0.5 * light);
            let off = self.stage.paint(off, die, || 0.35 * light);
            let off = self.stage.paint(off, window, || 0.012);
            if !on[index] {
                return off;
            }
            let lit = 0.8.lerp(3.0, cup) * (0.55 + 0.45 * normal.z) * (1.0 - 0.35 * rim);
            let lit = self.stage.paint(lit, die, || 40.0);
            self.stage.paint(lit, wire, || 0.9)
        })
    }
}

impl Scene for Leds {
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_> {
        let on = Self::on(t);
        Box::new(move |position| {
            let p = self.stage.point(position);
            let v = self.board(p, on);
            let v = self.parts.iter().fold(v, |v, part| self.part(v, p, part, on));
            (0..2).fold(v, |v, index| self.led(v, p, index, on))
        })
    }
}

//! Pouring.

use std::f32::consts::TAU;

use glam::{FloatExt, Vec2, Vec3};

use super::super::Scene;
use super::glyph::Text;
use super::light::Lamp;
use super::shape::{
    Buckets, Lathe, Stage, ellipse, floor, fract, rectangle, rounded, smooth_step, sphere_normal,
};
use super::texture::NoiseTexture;

/// Gravity in units/frame²: 9.81 m/s² at 1000 fps, the square of the layout being 0.14 m wide.
const GRAVITY: f32 = 1.4e-4;
/// Speed of the liquid at the mouth of the bottle, in units/frame.
const EXIT: f32 = 0.007;
/// The mouth, and where the stream has fallen apart into drops.
const MOUTH: f32 = -0.60;
const BREAK: f32 = -0.12;
/// Frames between drops.
const PERIOD: f32 = 9.0;
/// The glass: half width inside at the bottom and the slope of its sides, rim, inner bottom, outer bottom.
const GLASS: f32 = 0.27;
const SLOPE: f32 = 0.10;
const RIM: f32 = 0.05;
const BOTTOM: f32 = 0.72;
const FOOT: f32 = 0.79;
/// Thickness of the glass.
const WALL: f32 = 0.028;
/// Edge of the table against the wall.
const TABLE: f32 = 0.66;
/// Light that comes from everywhere: radiance of a white surface.
const AMBIENT: f32 = 0.002;

/// A liquid runs from a bottle, breaks into drops and fills a glass that is lit from behind through a frosted
/// pane with a grating; a small lamp in front makes glints. The stream and the drops refract what is behind
/// them upside down. Drops splash, bubbles rise, the surface rings; the level rises ever more slowly, so that
/// the scene goes on for any length of time.
///
/// Radiance: pane 0.05 to 0.6, glints 1 to 8, liquid 0.1, bottle and table 0.01 to 0.0002.
#[derive(Clone, Debug)]
pub struct Pouring {
    stage: Stage,
    texture: NoiseTexture,
    chance: NoiseTexture,
    lamp: Lamp,
    bottle: Lathe,
    label: Text,
    marks: [Text; 3],
}

/// A ball of liquid.
struct Drop {
    middle: Vec2,
    radius: f32,
    /// Height over width: drops swing.
    stretch: f32,
}

/// The liquid at an instant.
struct Liquid {
    t: f32,
    level: f32,
    drops: Vec<Drop>,
    drops_at: Buckets,
    bubbles: Vec<Drop>,
    bubbles_at: Buckets,
}

impl Drop {
    /// Where drops may be seen.
    fn buckets(drops: &[Drop]) -> Buckets {
        Buckets::new(drops.iter().map(|drop| (drop.middle, Vec2::splat(1.4 * drop.radius + 0.01))))
    }
}

impl Pouring {
    /// The scene for images of `height` × `width` pixels.
    pub fn new(height: usize, width: usize, seed: u64) -> Self {
        Self {
            stage: Stage::new(height, width),
            texture: NoiseTexture::new(seed, 0),
            chance: NoiseTexture::new(seed, 1),
            lamp: Lamp { position: Vec3::new(-0.9, -1.1, 1.6), intensity: 0.05 },
            bottle: Lathe::new(&[(0.26, -1.9), (0.26, -0.90), (0.085, -0.76), (0.085, MOUTH)]),
            label: Text::new("COLD", 0.075, 0.17),
            marks: ["300", "200", "100"].map(|text| Text::new(text, 0.055, 0.17)),
        }
    }

    /// Height of the surface without waves.
    fn level(t: f32) -> f32 {
        0.48.lerp(0.14, 1.0 - (-t.max(0.0) / 4000.0).exp())
    }

    fn liquid(&self, t: f32) -> Liquid {
        let level = Self::level(t);
        // A drop leaves the stream where it breaks, at the speed that it has there.
        let speed = (EXIT * EXIT + 2.0 * GRAVITY * (BREAK - MOUTH)).sqrt();
        let fall = |age: f32| BREAK + speed * age + 0.5 * GRAVITY * age * age;
        let (mut drops, mut bubbles) = (Vec::new(), Vec::new());
        let latest = (t / PERIOD).floor() as i32;
        for number in latest - 40..=latest {
            let age = t - number as f32 * PERIOD;
            let chance = |what: i32| self.chance.cell(what, number);
            let radius = 0.030 + 0.014 * chance(0);
            let impact = (2.0 * GRAVITY * (level - BREAK) + speed * speed).sqrt();
            let flight = (impact - speed) / GRAVITY;
            if age < flight {
                let x = 0.02 * (chance(1) - 0.5) * age / flight;
                let stretch = 1.0 + 0.25 * (-age / 30.0).exp() * (age * TAU / 11.0 + 6.0 * chance(2)).cos();
                drops.push(Drop { middle: Vec2::new(x, fall(age)), radius, stretch });
                continue;
            }
            let since = age - flight;
            for splash in 0..3 {
                // Small drops thrown up by the impact.
                let chance = |what: i32| self.chance.cell(20 * (splash + 1) + what, number);
                let (up, side) = (0.005 + 0.006 * chance(3), 0.003 * (chance(4) - 0.5));
                let y = level - up * since + 0.5 * GRAVITY * since * since;
                if y <= level + 0.01 {
                    let x = side * since;
                    drops.push(Drop {
                        middle: Vec2::new(x, y),
                        radius: 0.008 + 0.008 * chance(5),
                        stretch: 1.0,
                    });
                }
            }
            // A bubble goes down with the drop and rises.
            let depth = 0.20 * (1.0 - (-since / 18.0).exp()) - 0.0012 * since;
            if depth > 0.01 && level + depth < BOTTOM - 0.02 {
                let x = 0.18 * (chance(6) - 0.5) + 0.012 * (since / 9.0 + 9.0 * chance(7)).sin();
                bubbles.push(Drop {
                    middle: Vec2::new(x, level + depth),
                    radius: 0.007 + 0.016 * chance(8),
                    stretch: 0.9,
                });
            }
        }
        let (drops_at, bubbles_at) = (Drop::buckets(&drops), Drop::buckets(&bubbles));
        Liquid { t, level, drops, drops_at, bubbles, bubbles_at }
    }

    /// The wall with the pane.
    fn wall(&self, p: Vec2) -> f32 {
        let q = p - Vec2::new(0.08, -0.16);
        let pane = rounded(q, Vec2::new(0.66, 0.66), 0.05);
        if pane > 0.04 {
            let light = 0.010 * (-4.0 * pane).exp() + 0.25 * AMBIENT;
            return light * self.texture.plaster(p) * if bricks(p) < 0.0 { 0.35 } else { 0.12 };
        }
        // The lamp behind the pane is not in its middle.
        let frost = 0.92 + 0.16 * self.texture.fractal(20.0 * q, 2);
        let hot = (q - Vec2::new(0.18, -0.12)).length_squared();
        let bright = (0.05 + 0.55 * (-4.5 * hot).exp()) * frost;
        let bar = |x: f32| 0.22 * (fract(x / 0.22 + 0.5) - 0.5).abs() - 0.008;
        let grid = bar(q.x).min(bar(q.y));
        let bright = self.stage.paint(bright, grid, || 0.22 * bright);
        self.stage.paint(0.0035, pane, || bright)
    }

    fn table(&self, p: Vec2) -> f32 {
        let depth = 2.0 * (p.y - TABLE);
        let grain = self.texture.wood(Vec2::new(p.x, depth));
        let mirrored = self.wall(Vec2::new(p.x, 2.0 * TABLE - p.y - 0.12));
        let shade = smooth_step(-0.02, 0.25, ellipse(p - Vec2::new(0.0, FOOT), Vec2::new(0.34, 0.07)));
        // The glass gathers light into a bright figure on the table.
        let caustic = (p - Vec2::new(-0.05, FOOT + 0.10)) / Vec2::new(0.14, 0.035);
        let caustic = 0.16 * (-caustic.length_squared()).exp() * (0.6 + 0.8 * self.texture.value(22.0 * p));
        let matte = 0.25 * grain * (AMBIENT + 0.02 * (-2.0 * depth).exp());
        (matte + 0.06 * mirrored * (0.5 + 0.5 * grain)) * (0.25 + 0.75 * shade) + caustic * grain
    }

    fn back(&self, p: Vec2) -> f32 {
        if p.y < TABLE { self.wall(p) } else { self.table(p) }
    }

    /// A lens of liquid whose surface has `normal`: what is behind, shifted, less at the rim, and the glint.
    fn lens(&self, p: Vec2, normal: Vec3, size: f32, clear: f32) -> f32 {
        let behind = self.back(p - 3.2 * size * normal.truncate());
        let rim = 1.0 - normal.z;
        let glint = self.lamp.highlight(p.extend(0.2), normal, 260.0);
        // Towards the rim the way bends so far that only the dark room is seen.
        behind * clear * (1.0 - 0.93 * smooth_step(0.12, 0.55, rim)) + 8.0 * glint + 0.3 * AMBIENT
    }

    /// The stream and the drops before whatever is `below`.
    fn air(&self, p: Vec2, liquid: &Liquid, below: impl FnOnce() -> f32) -> f32 {
        let mut drops = liquid.drops_at.at(p).map(|index| &liquid.drops[index]).peekable();
        if drops.peek().is_none() {
            return self.stream(p, liquid.t, below);
        }
        drops.fold(self.stream(p, liquid.t, below), |v, drop| self.drop(v, p, drop))
    }

    fn stream(&self, p: Vec2, t: f32, below: impl FnOnce() -> f32) -> f32 {
        if p.x.abs() > 0.1 || !(MOUTH..BREAK + 0.02).contains(&p.y) {
            return below();
        }
        // It gets thinner as it gets faster; ripples run down with it and grow until they cut it.
        let speed = (EXIT * EXIT + 2.0 * GRAVITY * (p.y - MOUTH)).sqrt();
        let age = (speed - EXIT) / GRAVITY;
        let whole = ((BREAK - MOUTH) * 2.0 * GRAVITY + EXIT * EXIT).sqrt();
        let whole = (whole - EXIT) / GRAVITY;
        let growth = (5.5 * (age / whole - 1.0)).exp();
        let phase = TAU * (t - age + whole) / PERIOD;
        let radius =
            0.052 * (EXIT / speed).sqrt() * (1.0 + growth * phase.cos()) + 0.004 * (1.0 - age / whole);
        let twist = 0.10 * (p.y * 17.0 + 0.09 * t).sin() * (1.0 - age / whole);
        let thread = || {
            let s = (p.x / radius + twist).clamp(-1.0, 1.0);
            // The ripple's slope makes it a row of lenses.
            let slope = 0.6 * growth * phase.sin();
            let normal = Vec3::new(s, slope, (1.0 - s * s).max(0.0).sqrt() + 0.05).normalize();
            self.lens(p, normal, radius, 0.85)
        };
        self.stage.cover_with(p.x.abs() - radius, thread, below)
    }

    fn drop(&self, below: f32, p: Vec2, drop: &Drop) -> f32 {
        let q = p - drop.middle;
        if q.abs().max_element() > 1.4 * drop.radius {
            return below;
        }
        let radii = drop.radius * Vec2::new(drop.stretch.sqrt().recip(), drop.stretch);
        self.stage
            .paint(below, ellipse(q, radii), || self.lens(p, sphere_normal(q / radii, 1.0), drop.radius, 0.9))
    }

    /// Everything behind the front of the glass at `p`.
    fn inside(&self, p: Vec2, liquid: &Liquid) -> f32 {
        let half = GLASS + SLOPE * (BOTTOM - p.y);
        let s = (p.x / half).clamp(-1.0, 1.0);
        // Rings run over the surface, which is seen as a narrow ellipse.
        let ring = (70.0 * p.x.abs() - 0.55 * liquid.t).sin() * (-6.0 * p.x.abs()).exp();
        let crown = 0.025 * (-(p.x / 0.05).powi(2)).exp() * (0.5 + 0.5 * (TAU * liquid.t / PERIOD).cos());
        let surface = liquid.level + 0.006 * ring + crown;
        let oval = ellipse(p - Vec2::new(0.0, surface), Vec2::new(half, 0.035));
        let mut v = if p.y < surface {
            self.air(p, liquid, || 0.85 * self.back(p))
        } else {
            // A big lens: left is right, and it is darker at the sides.
            let deep = (p.y - surface) / (BOTTOM - liquid.level);
            let bend = Vec2::new(-1.6 * p.x, 0.15 * p.y) + 0.05 * ring;
            let tint = 0.34 - 0.14 * deep;
            let mut v = tint * self.wall(bend.min(Vec2::splat(TABLE - 0.05))) * (1.0 - 0.75 * s.powi(4))
                + 0.2 * AMBIENT;
            for bubble in liquid.bubbles_at.at(p).map(|index| &liquid.bubbles[index]) {
                let q = p - bubble.middle;
                v = self.stage.paint(v, q.length() - bubble.radius, || {
                    let normal = sphere_normal(q, bubble.radius);
                    v * (0.15 + 1.1 * normal.z.powi(2))
                        + 2.5 * self.lamp.highlight(p.extend(0.2), normal, 120.0)
                });
            }
            v
        };
        v = self.stage.paint(v, oval, || {
            let wave = (50.0 * (p.x.abs() + 3.0 * (p.y - surface).abs()) - 0.55 * liquid.t).sin();
            let v = self.wall(Vec2::new(p.x, -0.2 - 4.0 * (p.y - surface))) * (0.55 + 0.3 * wave);
            v + 0.9 * smooth_step(0.92, 1.0, wave) * smooth_step(0.22, 0.05, p.x.abs())
        });
        // The meniscus is a bright line with a dark one below.
        let line = p.y - surface - 0.035 * (1.0 - s * s).sqrt();
        v = self.stage.paint(v, (line - 0.012).abs() - 0.006, || 0.25 * v);
        self.stage.paint(v, line.abs() - 0.005, || v + 0.12 * (1.0 - s * s))
    }

    fn glass(&self, p: Vec2, liquid: &Liquid, below: impl FnOnce() -> f32) -> f32 {
        let half = GLASS + SLOPE * (BOTTOM - p.y);
        let outer = (p.x.abs() - half - WALL).max(RIM - p.y).max(p.y - FOOT);
        if outer > 0.03 {
            return below();
        }
        let within = || {
            let inner = (p.x.abs() - half).max(p.y - BOTTOM);
            // The wall and the thick bottom pipe light: dark with bright streaks.
            let wall = if p.y > BOTTOM {
                let wave = (p.x * 26.0).sin() * ((p.y - BOTTOM) * 60.0).cos();
                0.03 + 0.22 * wave.max(0.0).powi(3)
            } else {
                let s = (p.x.abs() - half) / WALL;
                0.012 + 0.30 * smooth_step(0.12, 0.0, (s - 0.65).abs()) * (1.0 - 0.6 * p.y)
            };
            self.stage.cover_with(inner, || self.inside(p, liquid), || wall)
        };
        let mut v = self.stage.cover_with(outer, within, below);
        // Rim, reflection of the lamp along the side, scale.
        let rim = ellipse(p - Vec2::new(0.0, RIM), Vec2::new(half + WALL, 0.03)).abs() - 0.006;
        v = self.stage.paint(v, rim, || 0.05 + 0.5 * smooth_step(0.25, 0.0, (p.x + 0.16).abs()));
        let side = p.x + 0.72 * half;
        let streak = (side.abs() - 0.013).max((p.y - 0.33).abs() - 0.20).max(0.008 - (p.y - 0.40).abs());
        v = self.stage.paint(v, streak, || v + 1.2);
        for (line, text) in self.marks.iter().enumerate() {
            let q = p - Vec2::new(0.20, 0.24 + 0.15 * line as f32);
            let tick = rectangle(q + Vec2::new(0.14, 0.0), Vec2::new(0.04, 0.005));
            v = self.stage.paint(v, tick.min(text.distance(q)), || 0.004);
        }
        v
    }

    fn bottle(&self, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        if p.y > MOUTH + 0.02 || p.x.abs() > 0.28 {
            return below();
        }
        // Held upside down; dark glass with light along its rims.
        let glass = || {
            let normal = self.bottle.normal(p);
            let rim = smooth_step(0.75, 0.93, normal.x.abs()) * smooth_step(1.0, 0.95, normal.x.abs());
            let through = self.back(Vec2::new(-1.5 * p.x, p.y + 0.35));
            let lip = if p.y > MOUTH - 0.045 { 0.5 } else { 1.0 };
            let v = lip * (0.06 * through * normal.z + 0.05 * rim)
                + 0.0008
                + 1.5 * self.lamp.highlight(p.extend(0.2), normal, 500.0);
            let paper = rectangle(p + Vec2::new(0.0, 1.03), Vec2::new(1.0, 0.15));
            self.stage.paint(v, paper, || {
                let q = Vec2::new(0.26 * normal.x.asin(), p.y);
                let ink = self.label.distance(q + Vec2::new(0.0, 0.945));
                let light = AMBIENT + self.lamp.on(p.extend(0.2), normal);
                self.stage.paint(0.6 * light, ink, || 0.04 * light)
            })
        };
        self.stage.cover_with(self.bottle.distance(p), glass, below)
    }
}

/// Signed distance to the bricks of a wall (their joints are outside).
fn bricks(p: Vec2) -> f32 {
    let row = floor(p.y / 0.11);
    let x = p.x / 0.26 + fract(0.5 * row);
    let q = Vec2::new((fract(x) - 0.5) * 0.26, (p.y / 0.11 - row - 0.5) * 0.11);
    rectangle(q, Vec2::new(0.12, 0.045))
}

impl Scene for Pouring {
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_> {
        let liquid = self.liquid(t);
        Box::new(move |position| {
            let p = self.stage.point(position);
            // From the front to the back: what is hidden is not worked out.
            let back = || self.back(p);
            let air = || if p.y < RIM + 0.03 { self.air(p, &liquid, back) } else { back() };
            self.glass(p, &liquid, || self.bottle(p, air))
        })
    }
}

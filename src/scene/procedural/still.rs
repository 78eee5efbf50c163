//! A still life.

use glam::{FloatExt, Vec2, Vec3};

use super::super::Scene;
use super::chart::Chart;
use super::glyph::Text;
use super::light::{Lamp, glow};
use super::shape::{
    Lathe, Stage, ellipse, floor, fract, rectangle, rounded, segment, smooth_step, sphere_normal,
};
use super::texture::NoiseTexture;

/// The bulb of the lamp, under its shade.
const BULB: Vec3 = Vec3::new(-0.50, -0.36, 0.35);
/// Lower and upper edge of the shade and their half widths.
const SHADE: [Vec2; 2] = [Vec2::new(0.30, -0.33), Vec2::new(0.15, -0.70)];
/// Edge of the desk against the wall.
const DESK: f32 = 0.44;
/// Where things stand on the desk.
const STAND: f32 = 0.60;
/// Middle and half extent of the chart.
const CHART: Vec2 = Vec2::new(0.71, 0.19);
const CHART_HALF: f32 = 0.24;
/// Left end of the books and their width.
const BOOKS: f32 = 0.06;
/// The ball of the moving scene: radius, middle of its way, and how far it swings to either side.
const BALL: f32 = 0.2;
const SWING: Vec2 = Vec2::new(-0.05, 0.2);
const REACH: f32 = 0.6;
/// Light that comes from everywhere: radiance of a white surface.
const AMBIENT: f32 = 0.002;

/// A desk: a lamp whose bulb shows under the shade, a bottle and an orange, books with titles on their spines,
/// and in their shadow a dark corner with a resolution chart; on the wall a picture. Nothing moves, but for a banded ball, if
/// there is one, that swings to and fro in front.
///
/// Radiance: bulb 3 to 20, shade 0.5, wall in the light 0.15, desk 0.1, the corner 0.001 (white) to 0.0002.
#[derive(Clone, Debug)]
pub struct Still {
    stage: Stage,
    texture: NoiseTexture,
    wood: NoiseTexture,
    lamp: Lamp,
    shade: Lathe,
    bulb: Lathe,
    bottle: Lathe,
    label: [Text; 2],
    books: Vec<Book>,
    chart: Chart,
    page: Text,
    /// Highest speed of the ball in units/frame; 0 if there is none.
    speed: f32,
}

/// A book that stands upright, its spine to the viewer.
#[derive(Clone, Debug)]
struct Book {
    /// Left side, width and height.
    left: f32,
    width: f32,
    height: f32,
    reflectance: f32,
    title: Text,
}

impl Still {
    /// The scene for images of `height` × `width` pixels; with a `speed` above 0 px/frame, there is a ball.
    pub fn new(height: usize, width: usize, seed: u64, speed: f32) -> Self {
        let stage = Stage::new(height, width);
        let mut left = BOOKS;
        let book = |(title, width, height, reflectance): (&str, f32, f32, f32)| {
            let book = Book { left, width, height, reflectance, title: Text::new(title, 0.5 * width, 0.17) };
            left += width + 0.004;
            book
        };
        Self {
            stage,
            texture: NoiseTexture::new(seed, 0),
            wood: NoiseTexture::new(seed, 1),
            lamp: Lamp { position: BULB, intensity: 0.09 },
            shade: Lathe::new(&[(SHADE[1].x, SHADE[1].y), (SHADE[0].x, SHADE[0].y)]),
            bulb: Lathe::new(&[(0.04, -0.46), (0.075, -0.33), (0.0, -0.262)]),
            bottle: Lathe::new(&[
                (0.042, -0.24),
                (0.042, -0.20),
                (0.036, -0.19),
                (0.036, 0.02),
                (0.115, 0.16),
                (0.115, 0.57),
                (0.10, 0.60),
            ]),
            label: [Text::new("OLIO", 0.065, 0.18), Text::new("1951", 0.045, 0.18)],
            books: [
                ("OPTICS", 0.105, 0.70, 0.10),
                ("PHOTON", 0.075, 0.58, 0.55),
                ("SIGNALS", 0.12, 0.76, 0.22),
                ("NOISE", 0.07, 0.64, 0.05),
            ]
            .into_iter()
            .map(book)
            .collect(),
            chart: Chart::new(),
            page: Text::new("HDR", 0.13, 0.18),
            speed: speed * stage.pixel(),
        }
    }

    /// Light of the lamp and of the room on a white surface, with the shadow of the shade and of the books.
    fn light(&self, point: Vec3, normal: Vec3) -> f32 {
        let to = point - BULB;
        // The shade lets light out below and above; the edge is as soft as the bulb is large.
        let out = (to.x * to.x + to.z * to.z).sqrt();
        let below = out / to.y.max(1e-3);
        let above = out / (-to.y).max(1e-3);
        let open_below = SHADE[0].x / (SHADE[0].y - BULB.y).max(0.03);
        let open_above = SHADE[1].x / (BULB.y - SHADE[1].y);
        let free = smooth_step(1.25, 0.8, below / (0.35 * open_below)).max(smooth_step(
            1.3,
            0.75,
            above / open_above,
        ));
        let bulb = self.lamp.on(point, normal) * free;
        // The books stand between the lamp and the corner.
        let corner = smooth_step(0.45, 0.52, point.x - 0.45 * (point.z - 0.1).max(0.0));
        if corner == 0.0 {
            return bulb + AMBIENT;
        }
        let top = -0.16 + 0.35 * (point.x - 0.44);
        let dark = corner * smooth_step(top - 0.10, top + 0.06, point.y);
        let depth = 1.0 - 0.45 * corner * smooth_step(-0.3, 0.5, point.y);
        bulb * (1.0 - dark) + AMBIENT * depth
    }

    fn wall(&self, p: Vec2) -> f32 {
        let light = self.light(p.extend(0.0), Vec3::Z);
        let plaster = self.texture.plaster(p);
        let mut v = 0.5 * plaster * light;
        // A framed picture of hills and a moon.
        let q = p - Vec2::new(0.36, -0.62);
        let frame = rectangle(q, Vec2::new(0.34, 0.26));
        if frame > 0.1 {
            return v;
        }
        v *= 1.0 - 0.5 * smooth_step(0.06, 0.0, rectangle(q - 0.02, Vec2::new(0.34, 0.26)));
        v = self
            .stage
            .paint(v, frame, || 0.10 * light * (1.0 + 2.0 * smooth_step(0.02, 0.0, (frame + 0.03).abs())));
        v = self.stage.paint(v, frame + 0.045, || 0.8 * light);
        self.stage.paint(v, frame + 0.085, || {
            let ridge = |x: f32, layer: f32| 0.09 * self.texture.fractal(Vec2::new(5.0 * x, layer), 3);
            let mut v = 0.45 * light;
            v = self.stage.paint(v, (q - Vec2::new(0.12, -0.09)).length() - 0.035, || 0.9 * light);
            v = self.stage.paint(v, 0.01 - ridge(q.x, 3.0) - q.y + 0.03, || 0.22 * light);
            v = self.stage.paint(v, 0.10 - ridge(q.x, 9.0) - q.y, || 0.09 * light);
            self.stage.paint(v, 0.16 - ridge(q.x, 20.0) - q.y, || 0.03 * light)
        })
    }

    fn desk(&self, p: Vec2) -> f32 {
        let depth = 1.6 * (p.y - DESK);
        let point = Vec3::new(p.x, STAND, depth);
        let grain = self.wood.wood(Vec2::new(p.x, depth));
        let light = self.light(point, Vec3::NEG_Y);
        let mut shadow = 1.0;
        for (x, y, radii, lean) in [
            (-0.14, STAND, Vec2::new(0.13, 0.04), 0.5),
            (-0.32, STAND + 0.11, Vec2::new(0.10, 0.035), 0.35),
            (-0.50, STAND + 0.05, Vec2::new(0.19, 0.06), 0.0),
        ] {
            // Shadows point away from the lamp.
            let away = (Vec2::new(x, y) - Vec2::new(BULB.x, DESK + 0.05)).normalize_or_zero();
            let q = p - Vec2::new(x, y) - Vec2::new(0.10, 0.045);
            let along = q.dot(away).max(0.0);
            let d = ellipse(q - lean * along.min(0.3) * away, radii);
            shadow *= 0.25 + 0.75 * smooth_step(-0.03, 0.03 + 0.2 * along, d);
        }
        let contact = rectangle(p - Vec2::new(BOOKS + 0.19, STAND - 0.02), Vec2::new(0.20, 0.015));
        shadow *= 0.2 + 0.8 * smooth_step(0.0, 0.09, contact);
        let polish = 0.035 * glow(p.x - BULB.x, 0.13) * smooth_step(0.62, 0.80, p.y) * (0.4 + 0.6 * grain);
        let mut v = shadow * (0.45 * grain * light) + polish;
        // A sheet of paper with a heading and lines, and a pencil.
        let q = Vec2::from_angle(0.16).rotate((p - Vec2::new(0.28, 0.82)) * Vec2::new(1.0, 1.6));
        v = self.stage.paint(v, rectangle(q, Vec2::new(0.30, 0.21)), || {
            let lit = 0.85 * light * (0.5 + 0.5 * shadow);
            let row = (q.y - 0.01) / 0.055;
            let rows = (fract(row) - 0.5).abs() * 0.055 - 0.02;
            let words = self.texture.value(Vec2::new(24.0 * q.x, floor(row))) - 0.72;
            let text =
                (-rows).max(words * 0.04).max(rectangle(q - Vec2::new(0.0, 0.08), Vec2::new(0.24, 0.10)));
            let ink = text.min(self.page.distance(q + Vec2::new(0.10, 0.12)));
            self.stage.paint(lit, ink, || 0.12 * lit)
        });
        let (a, b) = (Vec2::new(-0.12, 0.90), Vec2::new(-0.52, 0.84));
        v *= 1.0 - 0.6 * smooth_step(0.035, 0.012, segment(p - Vec2::new(0.01, 0.018), a, b));
        let pencil = segment(p, a, b) - 0.014;
        self.stage.paint(v, pencil, || {
            let along = (p - b).dot((a - b).normalize()) / (a - b).length();
            let paint = match along {
                ..0.02 => 0.02,
                ..0.09 => 0.6,
                ..0.92 => 0.30,
                _ => 0.15,
            };
            paint * light * (0.6 + 1.2 * smooth_step(0.008, 0.0, (pencil + 0.018).abs()))
        })
    }

    fn chart(&self, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        let q = p - CHART;
        let card = || {
            let light = self.light(p.extend(0.05), Vec3::Z);
            let ink = self.chart.ink(&self.stage, q / CHART_HALF, CHART_HALF);
            light * 0.9.lerp(0.04, ink)
        };
        self.stage.cover_with(rounded(q, Vec2::splat(CHART_HALF), 0.01), card, below)
    }

    fn books(&self, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        let end = self.books.last().map_or(BOOKS, |book| book.left + book.width);
        if p.x < BOOKS - 0.02 || p.x > end + 0.02 || p.y > STAND + 0.02 || p.y < -0.25 {
            return below();
        }
        // The books stand beside each other: the nearest is the only one here.
        let near = self.books.iter().rfind(|book| p.x >= book.left - 0.002).or(self.books.first());
        let Some(book) = near else { return below() };
        let half = Vec2::new(book.width, book.height) / 2.0;
        let q = p - Vec2::new(book.left + half.x, STAND - half.y);
        let spine = || {
            // The spine is round.
            let s = q.x / half.x;
            let normal = Vec3::new(0.75 * s, 0.0, 1.0).normalize();
            let light = self.light(p.extend(0.30), normal);
            let cloth = book.reflectance * (0.85 + 0.3 * self.texture.value(Vec2::new(70.0, 110.0) * p));
            let leather = 0.012 * self.lamp.highlight(p.extend(0.3), normal, 14.0);
            let bands = ((q.y.abs() - 0.40 * book.height).abs() - 0.012)
                .min((q.y.abs() - 0.34 * book.height).abs() - 0.004);
            let title = book.title.distance(Vec2::new(q.y, -q.x));
            let gold = if book.reflectance > 0.4 { 0.05 } else { 0.75 };
            self.stage.paint(cloth * light + leather, bands.min(title), || gold * light)
        };
        self.stage.cover_with(rounded(q, half, 0.012), spine, below)
    }

    fn bottle(&self, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        let q = p - Vec2::new(-0.14, 0.0);
        if q.x.abs() > 0.13 {
            return below();
        }
        let glass = || {
            let normal = self.bottle.normal(q);
            let point = p.extend(0.3);
            // Dark green glass: what is behind comes through bent, the far side glows, the rim is dark.
            let through = self.wall(Vec2::new(p.x - 1.2 * q.x, p.y.min(DESK)));
            let far = smooth_step(0.1, 0.9, normal.x) * smooth_step(1.0, 0.85, normal.x);
            let oil = if q.y > 0.02 { 0.55 } else { 1.0 };
            let mut v = oil * (0.22 * through * normal.z + 0.06 * far) + 0.0006;
            // Images of the bulb and of a far window.
            v += 9.0 * self.lamp.highlight(point, normal.with_y(-0.28).normalize(), 900.0);
            let pane = rounded(Vec2::new(normal.x - 0.55, (q.y - 0.30) * 3.0), Vec2::new(0.09, 0.42), 0.03);
            v = self.stage.paint(v, 0.1 * pane, || v + 0.035);
            let streak = (normal.x + 0.62).abs() - 0.05;
            v = self.stage.paint(v, 0.1 * streak.max((q.y - 0.30).abs() - 0.24), || v + 0.5);
            // Paper label round it.
            let label = rectangle(q - Vec2::new(0.0, 0.38), Vec2::new(1.0, 0.10));
            v = self.stage.paint(v, label, || {
                let light = self.light(point, normal);
                let around = Vec2::new(0.115 * normal.x.asin(), q.y);
                let ink = self.label[0].distance(around - Vec2::new(0.0, 0.35));
                let ink = ink
                    .min(self.label[1].distance(around - Vec2::new(0.0, 0.43)))
                    .min((label + 0.012).abs() - 0.004);
                self.stage.paint(0.75 * light, ink, || 0.06 * light)
            });
            let cork = q.y + 0.20;
            self.stage.paint(v, cork, || 0.35 * self.light(point, normal))
        };
        self.stage.cover_with(self.bottle.distance(q), glass, below)
    }

    fn orange(&self, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        let q = p - Vec2::new(-0.32, STAND + 0.02);
        let peel = || {
            let normal = sphere_normal(q, 0.10);
            // Pores.
            let pore = self.texture.value(110.0 * normal.truncate() * 0.3) - 0.5;
            let normal = (normal + 0.25 * Vec3::new(pore, pore, 0.0)).normalize();
            let point = p.extend(0.45);
            let stem = (q - Vec2::new(0.02, -0.07)).length() - 0.012;
            let peel = 0.45 * self.lamp.around(point, normal, 0.15)
                + 0.45 * AMBIENT
                + 0.5 * self.lamp.highlight(point, normal, 55.0);
            self.stage.paint(peel, stem, || 0.05 * self.light(point, normal) + 0.001)
        };
        self.stage.cover_with(q.length() - 0.10, peel, below)
    }

    /// The ball at frame `t`, in front of everything.
    fn ball(&self, t: f32, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        if self.speed == 0.0 {
            return below();
        }
        let phase = self.speed / REACH * t;
        let q = p - SWING - Vec2::new(REACH * phase.sin(), 0.0);
        let skin = || {
            let normal = sphere_normal(q, BALL);
            let point = p.extend(0.5);
            // It rolls as it swings.
            let around = normal.x.atan2(normal.z) - REACH / BALL * phase.sin();
            let band = 0.1 * ((3.0 * around).sin() + 0.4 * (5.0 * normal.y).sin());
            let paint = if normal.y.abs() < 0.85 && band > 0.0 { 0.08 } else { 0.6 };
            paint * (self.lamp.around(point, normal, 0.25) + 2.0 * AMBIENT)
                + 0.2 * self.lamp.highlight(point, normal, 40.0)
        };
        self.stage.cover_with(q.length() - BALL, skin, below)
    }

    fn lamp(&self, p: Vec2, below: impl FnOnce() -> f32) -> f32 {
        let q = Vec2::new(p.x - BULB.x, p.y);
        let r = p.distance(BULB.truncate() + Vec2::new(0.0, 0.06));
        let shade = self.shade.distance(q);
        let mut v = if self.stage.cover(shade) < 1.0 { below() } else { 0.0 };
        v += 0.09 * glow(r, 0.10) + 0.0012 * glow(r, 0.6);
        // Foot and pole.
        if q.x.abs() < 0.25 && p.y > -0.4 {
            let foot = ellipse(q - Vec2::new(0.0, STAND + 0.05), Vec2::new(0.17, 0.05));
            v = self.stage.paint(v, foot, || {
                let light = self.light(Vec3::new(p.x, STAND, 0.3), Vec3::NEG_Y);
                0.10 * light + 0.25 * light * smooth_step(0.02, 0.0, (foot + 0.02).abs())
            });
            let pole = rectangle(q - Vec2::new(0.0, 0.17), Vec2::new(0.018, 0.48));
            v = self.stage.paint(v, pole, || {
                let s = q.x / 0.018;
                let brass = 0.25 + 0.75 * smooth_step(0.5, 0.0, (s + 0.25).abs());
                0.008 + 0.16 * brass * glow(p.y + 0.2, 0.35)
            });
        }
        if q.x.abs() > 0.32 {
            return v;
        }
        v = self.stage.paint(v, self.bulb.distance(q), || {
            2.0 + 16.0 * glow(p.distance(BULB.truncate() + Vec2::new(0.0, 0.03)), 0.05)
        });
        self.stage.paint(v, shade, || {
            // Cloth lit from inside, brightest near the bulb; pleats; hems.
            let normal = self.shade.normal(q);
            let near = glow(p.distance(BULB.truncate() - Vec2::new(0.0, 0.08)), 0.22);
            let pleats = 0.85 + 0.15 * (normal.x.asin() * 34.0).sin();
            let weave = 0.9 + 0.2 * self.texture.value(Vec2::new(150.0, 90.0) * p);
            let hem = (p.y - SHADE[1].y).min(SHADE[0].y - p.y) - 0.022;
            let cloth = (0.06 + 0.75 * near) * pleats * weave * (0.45 + 0.55 * normal.z);
            self.stage.paint(cloth, hem, || 0.35 * cloth)
        })
    }
}

impl Scene for Still {
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_> {
        Box::new(move |position| {
            let p = self.stage.point(position);
            // From the front to the back: what is hidden is not worked out.
            let back = || if p.y < DESK { self.wall(p) } else { self.desk(p) };
            let books = || self.books(p, || self.chart(p, back));
            self.ball(t, p, || self.lamp(p, || self.orange(p, || self.bottle(p, books))))
        })
    }
}

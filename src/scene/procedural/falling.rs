//! Falling and bouncing things.

use std::f32::consts::TAU;

use glam::{FloatExt, Mat3, Quat, Vec2, Vec3};

use super::super::Scene;
use super::glyph::Text;
use super::light::Lamp;
use super::shape::{Brick, Face, Stage, ellipse, fract, rectangle, smooth_step, sphere_normal};
use super::texture::NoiseTexture;

/// Gravity in units/frame²: 9.81 m/s² at 1000 fps, the square of the layout being 0.2 m wide.
const GRAVITY: f32 = 9.81e-5;
/// Speed at which things come into the picture, in units/frame: they have fallen 0.11 m before.
const ENTRY: f32 = 0.0148;
/// Share of the speed that is left after a bounce.
const BOUNCE: f32 = 0.72;
/// Frames from one throw of a thing to its next.
const CYCLE: f32 = 560.0;
/// Edge of the table against the wall.
const TABLE: f32 = 0.46;
/// The window.
const WINDOW: Vec2 = Vec2::new(-0.30, -0.38);
const WINDOW_HALF: Vec2 = Vec2::new(0.50, 0.44);
/// Light that comes from everywhere: radiance of a white surface.
const AMBIENT: f32 = 0.003;

/// Two balls, a die, a lettered block and an envelope fall into a dark room, bounce on a polished table (air
/// drag left out, but for the envelope, which flutters) and leave it sideways; each comes again after 560
/// frames, thrown differently. A bright window lights the room from behind; sun-lit clouds are in it.
///
/// Radiance: clouds 0.2 to 2, sky 0.15, lit sides of things 0.05, their dark sides and the room 0.005 to 0.0002.
#[derive(Clone, Debug)]
pub struct Falling {
    stage: Stage,
    texture: NoiseTexture,
    throws: NoiseTexture,
    window: Lamp,
    letters: [Text; 6],
    address: Vec<(Vec2, Text)>,
    poster: [Text; 2],
}

/// What falls.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// A matte ball with a dark band and a number.
    Banded,
    /// A polished ball.
    Polished,
    Die,
    /// A wooden block with a letter on each side.
    Block,
    Envelope,
}

/// All things, those in the back first: kind, radius to the table, middle of the lane on the table, frame at
/// which it is thrown first (less one cycle).
const THINGS: [(Kind, f32, f32, f32); 5] = [
    (Kind::Polished, 0.13, 0.56, 455.0),
    (Kind::Banded, 0.17, 0.64, 500.0),
    (Kind::Block, 0.17, 0.72, 330.0),
    (Kind::Die, 0.13, 0.80, 410.0),
    (Kind::Envelope, 0.22, f32::MAX, 480.0),
];

/// A thing at an instant.
struct Body {
    kind: Kind,
    middle: Vec2,
    /// The height of the table under it, seen.
    floor: f32,
    radius: f32,
    /// Radius of what may be seen of it.
    bound: f32,
    block: Brick,
    turn: Mat3,
}

impl Falling {
    /// The scene for images of `height` × `width` pixels.
    pub fn new(height: usize, width: usize, seed: u64) -> Self {
        let line = |y: f32, size: f32, text: &str| (Vec2::new(0.03, y), Text::new(text, size, 0.16));
        Self {
            stage: Stage::new(height, width),
            texture: NoiseTexture::new(seed, 0),
            throws: NoiseTexture::new(seed, 1),
            window: Lamp { position: Vec3::new(WINDOW.x, WINDOW.y, 0.1), intensity: 0.045 },
            letters: ["H", "D", "R", "P", "I", "X"].map(|letter| Text::new(letter, 0.13, 0.2)),
            address: vec![line(-0.02, 0.045, "TO ALICE"), line(0.05, 0.045, "9 HIGH ST")],
            poster: ["1000", "FPS"].map(|text| Text::new(text, 0.13, 0.16)),
        }
    }

    /// Where and how turned thing `index` is at time `t`.
    fn body(&self, index: usize, t: f32) -> Body {
        let (kind, radius, lane, first) = THINGS[index];
        let since = t + CYCLE - first;
        let throw = (since / CYCLE).floor();
        let (age, throw) = (since - throw * CYCLE, throw as i32);
        let chance = |what: i32| self.throws.cell(8 * index as i32 + what, throw);
        // From somewhere in the middle out to one side, so that it is gone when its time is over.
        let side = if (index as i32 + throw).rem_euclid(2) == 0 { 1.0 } else { -1.0 };
        let from = side * (-0.62 + 0.5 * chance(0));
        let reach = self.stage.extent();
        let x = from.lerp(side * (reach.x + 2.0 * radius), age / CYCLE);
        let axis = Vec3::new(chance(1) - 0.5, chance(2) - 0.5, 1.2 * (chance(3) - 0.5)).normalize_or(Vec3::X);
        let spin = TAU / (90.0 + 60.0 * chance(4)) * side;
        let start = TAU * chance(5);
        let top = -reach.y - 1.6 * radius;
        let (y, angle) = if kind == Kind::Envelope {
            // Sinks at a steady speed, swaying, before the table and out below.
            (top + 0.0062 * age, start + 0.35 * spin * age)
        } else {
            let (y, whirl) = bounce(top, lane - radius, age);
            (y, start + spin * whirl)
        };
        let sway = if kind == Kind::Envelope { 0.16 * (age * TAU / 130.0).sin() } else { 0.0 };
        let turn = Mat3::from_quat(Quat::from_axis_angle(axis, angle) * Quat::from_rotation_x(0.4));
        let half = match kind {
            Kind::Envelope => Vec3::new(0.22, 0.14, 0.006),
            // Corners may go into the table a little when it lies there; a compromise between side and corner.
            _ => Vec3::splat(0.78 * radius),
        };
        let block = Brick::new(half, turn);
        let bound = match kind {
            Kind::Banded | Kind::Polished => radius + self.stage.pixel(),
            _ => block.radius(),
        };
        Body { kind, middle: Vec2::new(x + sway, y), floor: lane, radius, bound, block, turn }
    }

    /// What is seen through the window at `q` from its middle.
    fn outdoors(&self, q: Vec2) -> f32 {
        let sky = 0.10 + 0.08 * (q.y + 0.44);
        let cloud = smooth_step(0.47, 0.72, self.texture.fractal(Vec2::new(2.6, 4.6) * q + 5.0, 4));
        let sun = (q - Vec2::new(0.12, -0.24)).length_squared();
        let v = sky + (0.25 + 2.2 * (-14.0 * sun).exp()) * cloud + 0.25 * (-25.0 * sun).exp();
        let hill = q.y - 0.24 + 0.10 * self.texture.value(Vec2::new(5.0 * q.x, 3.0));
        let v = self.stage.paint(v, -hill, || 0.05 + 0.05 * self.texture.value(28.0 * q));
        // A house on the hill.
        let house = rectangle(q - Vec2::new(-0.25, 0.22), Vec2::new(0.09, 0.10));
        let roof = (q.x + 0.25).abs() * 0.8 - q.y + 0.02;
        let v = self.stage.paint(v, roof.max(q.y - 0.12), || 0.03);
        self.stage.paint(v, house, || {
            let pane = Vec2::new(fract((q.x + 0.25) / 0.06) - 0.5, fract((q.y - 0.14) / 0.07) - 0.5);
            if pane.abs().max_element() < 0.22 { 0.01 } else { 0.12 }
        })
    }

    fn wall(&self, p: Vec2) -> f32 {
        let q = p - WINDOW;
        let frame = rectangle(q, WINDOW_HALF);
        if frame < 0.0 {
            // Mullions, a little lit from the side.
            let bar = q.x.abs().min((q.y + 0.08).abs()) - 0.018;
            return self.stage.paint(self.outdoors(q), bar, || 0.012);
        }
        // Splay and frame, then wallpaper that gets darker away from the window.
        let near = 0.02 * smooth_step(0.10, 0.0, frame);
        let stripes = smooth_step(0.35, 0.45, (fract(p.x / 0.09) - 0.5).abs());
        let dots =
            Vec2::new(fract((p.x - 0.02) / 0.09) - 0.5, fract((p.y - 0.02) / 0.09) - 0.5).length() - 0.14;
        let paper = 0.10 + 0.09 * stripes;
        let paper = self.stage.paint(paper, 0.09 * dots, || 0.28);
        let grain = self.texture.plaster(p);
        let shade = AMBIENT * (0.25 + 0.9 * (-2.2 * frame).exp());
        let wood = self.stage.paint(paper * grain * shade, frame - 0.06, || 0.007 + near);
        // A poster in the dark part.
        let r = p - Vec2::new(0.62, -0.42);
        self.stage.paint(wood, rectangle(r, Vec2::new(0.27, 0.33)), || {
            let shade = shade * (0.9 + 0.2 * grain);
            let mut v = 0.55 * shade;
            let disk = (r - Vec2::new(0.05, -0.12)).length();
            v = self.stage.paint(v, disk - 0.13, || 0.10 * shade);
            v = self.stage.paint(v, (disk - 0.08).abs() - 0.02, || 0.7 * shade);
            v = self.stage.paint(v, self.poster[0].distance(r - Vec2::new(0.0, 0.10)), || 0.03 * shade);
            v = self.stage.paint(v, self.poster[1].distance(r - Vec2::new(-0.03, 0.25)), || 0.03 * shade);
            self.stage.paint(v, rectangle(r, Vec2::new(0.27, 0.33)).abs() - 0.012, || 0.02 * shade)
        })
    }

    fn table(&self, p: Vec2, bodies: &[Body]) -> f32 {
        let depth = 2.2 * (p.y - TABLE);
        let grain = self.texture.wood(Vec2::new(0.8 * p.x, depth));
        let matte = 0.3 * grain * self.window.around(Vec3::new(p.x, TABLE, depth), Vec3::NEG_Y, 0.3);
        // The polish mirrors the window, upside down and smeared more the further down.
        let blur = 0.03 + 0.25 * (p.y - TABLE);
        let mirrored = Vec2::new(p.x, 2.0 * TABLE - p.y - 0.10) - WINDOW;
        let inside = smooth_step(blur, -blur, mirrored.x.abs() - WINDOW_HALF.x)
            * smooth_step(blur, -blur, mirrored.y.abs() - WINDOW_HALF.y);
        let bars = smooth_step(0.0, 0.03 + blur, mirrored.x.abs() + 0.01);
        let mut v =
            matte + 0.035 * inside * (0.3 + 0.7 * bars) * (0.55 + 0.45 * grain) + 0.12 * AMBIENT * grain;
        for body in bodies.iter().filter(|body| body.kind != Kind::Envelope) {
            // Shadows grow soft and weak with height.
            let height = (body.floor - body.radius - body.middle.y).max(0.0);
            let q = p - Vec2::new(body.middle.x + 0.15 * height, body.floor + 0.02 + 0.05 * height);
            let soft = 0.05 + 0.35 * height;
            let dark = smooth_step(soft, -soft, ellipse(q, Vec2::new(1.05, 0.42) * body.radius));
            v *= 1.0 - 0.8 * dark / (1.0 + 3.0 * height);
        }
        v
    }

    /// Light on a thing: the window, which is large, and the room.
    fn light(&self, point: Vec3, normal: Vec3) -> f32 {
        self.window.around(point, normal, 0.25) + AMBIENT * (0.7 + 0.3 * normal.z)
    }

    fn ball(&self, body: &Body, q: Vec2) -> f32 {
        let normal = sphere_normal(q, body.radius);
        let point = body.middle.extend(0.4) + body.radius * normal;
        let own = body.turn.transpose() * normal;
        if body.kind == Kind::Banded {
            let light = self.light(point, normal);
            let latitude = own.y;
            let mut reflectance = 0.72 + 0.15 * self.texture.value(14.0 * own.truncate());
            reflectance = self.stage.paint(reflectance, body.radius * (latitude.abs() - 0.22), || 0.06);
            // A round field with a digit on each side.
            let field = body.radius * (own.truncate().length() - 0.42);
            reflectance = self.stage.paint(reflectance, field, || 0.9);
            let digit = self.letters[4].distance(own.truncate() * body.radius);
            reflectance = self.stage.paint(reflectance, digit, || 0.03);
            return reflectance * light + 0.02 * self.window.highlight(point, normal, 40.0);
        }
        // Polished: the window and the room in the mirror, stronger at the rim.
        let mirrored = 2.0 * normal.z * normal - Vec3::Z;
        let fresnel = 0.06 + 0.94 * (1.0 - normal.z).powi(4);
        let to_window = (self.window.position - point).normalize();
        let side = mirrored.cross(to_window).truncate().abs();
        let pane = if mirrored.dot(to_window) > 0.0 { side.max_element() } else { 1.0 };
        let image = smooth_step(0.36, 0.33, pane) * smooth_step(0.0, 0.05, side.min_element() - 0.01);
        let stripes = if own.x.abs() < 0.10 || own.z.abs() < 0.10 { 0.35 } else { 0.07 };
        stripes * self.light(point, normal) + fresnel * (0.6 * image + 0.006 * (1.0 + mirrored.y.abs()))
    }

    fn solid(&self, body: &Body, q: Vec2, face: &Face) -> f32 {
        let point = (body.middle + q).extend(0.4);
        let light = self.light(point, face.normal);
        let place = face.place;
        let size = face.half.x;
        // Edges are worn and catch some light.
        let rim = rectangle(place, face.half - 0.012);
        match body.kind {
            Kind::Die => {
                let mut v = 0.85 * light * (1.0 - 0.4 * smooth_step(0.0, 0.012, rim));
                for pip in pips(face.index) {
                    v = self.stage.paint(v, (place - *pip * size).length() - 0.19 * size, || 0.03 * light);
                }
                v + 0.02 * self.window.highlight(point, face.normal, 30.0)
            }
            Kind::Block => {
                let ring = (0.55 + 0.35 * self.texture.value(Vec2::new(4.0, 60.0) * place)) * light;
                let groove = (rectangle(place, face.half * 0.78).abs() - 0.012).max(rim);
                let v = self
                    .stage
                    .paint(ring * (1.0 - 0.3 * smooth_step(0.0, 0.012, rim)), groove, || 0.08 * light);
                self.stage.paint(v, self.letters[face.index].distance(place), || 0.04 * light)
            }
            _ if face.index < 4 => 0.6 * light,
            _ => {
                let mut v = 0.8 * light * (0.94 + 0.12 * self.texture.value(40.0 * place));
                if face.index == 4 {
                    // The flap.
                    let seam = (place.y + 0.13 - 0.5 * (0.22 - place.x.abs())).abs() - 0.005;
                    return self.stage.paint(v, seam, || 0.25 * light);
                }
                for (at, text) in &self.address {
                    v = self.stage.paint(v, text.distance(place - *at), || 0.05 * light);
                }
                let stamp = place - Vec2::new(0.165, -0.09);
                v = self.stage.paint(v, rectangle(stamp, Vec2::new(0.036, 0.034)), || 0.2 * light);
                self.stage.paint(v, (stamp.length() - 0.018).abs() - 0.006, || 0.7 * light)
            }
        }
    }

    /// How much of a thing is seen at `p`, and its radiance.
    fn thing(&self, p: Vec2, body: &Body) -> (f32, f32) {
        let q = p - body.middle;
        if q.length_squared() > body.bound * body.bound {
            return (0.0, 0.0);
        }
        match body.kind {
            Kind::Banded | Kind::Polished => (self.stage.cover(q.length() - body.radius), self.ball(body, q)),
            _ => body.block.face(q).map_or((0.0, 0.0), |face| (1.0, self.solid(body, q, &face))),
        }
    }
}

/// Height and effective spinning time after falling for `age` frames from `top` and bouncing on `floor`. The
/// spin gets slower with each bounce, as the speed does.
fn bounce(top: f32, floor: f32, age: f32) -> (f32, f32) {
    let (mut y, mut speed, mut left, mut spin, mut whirl) = (top, ENTRY, age, 1.0, 0.0);
    // After these bounces it is lower than any pixel is high.
    for _ in 0..24 {
        let impact = (speed * speed + 2.0 * GRAVITY * (floor - y)).max(0.0).sqrt();
        let flight = (impact - speed) / GRAVITY;
        if left < flight {
            return (y + speed * left + 0.5 * GRAVITY * left * left, whirl + spin * left);
        }
        left -= flight;
        whirl += spin * flight;
        (y, speed, spin) = (floor, -BOUNCE * impact, BOUNCE * spin);
    }
    (floor, whirl)
}

/// Dots on the sides of a die, in half extents from the middle; opposite sides have seven together.
fn pips(face: usize) -> &'static [Vec2] {
    const D: f32 = 0.52;
    const ONE: [Vec2; 1] = [Vec2::ZERO];
    const TWO: [Vec2; 2] = [Vec2::new(-D, -D), Vec2::new(D, D)];
    const THREE: [Vec2; 3] = [TWO[0], Vec2::ZERO, TWO[1]];
    const FOUR: [Vec2; 4] = [TWO[0], TWO[1], Vec2::new(-D, D), Vec2::new(D, -D)];
    const FIVE: [Vec2; 5] = [FOUR[0], FOUR[1], FOUR[2], FOUR[3], Vec2::ZERO];
    const SIX: [Vec2; 6] = [FOUR[0], FOUR[1], FOUR[2], FOUR[3], Vec2::new(-D, 0.0), Vec2::new(D, 0.0)];
    match face {
        0 => &ONE,
        1 => &SIX,
        2 => &TWO,
        3 => &FIVE,
        4 => &THREE,
        _ => &FOUR,
    }
}

impl Scene for Falling {
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_> {
        let bodies: Vec<Body> = (0..THINGS.len()).map(|index| self.body(index, t)).collect();
        Box::new(move |position| {
            let p = self.stage.point(position);
            // From the front to the back: what is hidden is not worked out.
            let (mut sum, mut free) = (0.0, 1.0);
            for body in bodies.iter().rev() {
                let (cover, radiance) = self.thing(p, body);
                sum += free * cover * radiance;
                free *= 1.0 - cover;
                if free == 0.0 {
                    return sum;
                }
            }
            sum + free * if p.y < TABLE { self.wall(p) } else { self.table(p, &bodies) }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn things_fall_with_gravity_bounce_and_come_to_rest() {
        let y = |age| bounce(-1.0, 0.5, age).0;
        let second = y(20.0) - 2.0 * y(10.0) + y(0.0);
        assert!((second - GRAVITY * 100.0).abs() < 1e-4, "{second}");
        assert!((0..600).all(|age| y(age as f32) <= 0.5 + 1e-4));
        let highest = (200..260).map(|age| y(age as f32)).fold(1.0, f32::min);
        assert!(highest < 0.3 && highest > -0.9, "{highest}");
        assert!((y(5000.0) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn things_are_out_of_sight_when_they_start_anew() {
        for (height, width) in [(128, 128), (100, 300), (300, 100)] {
            let scene = Falling::new(height, width, 3);
            let reach = scene.stage.extent();
            for (index, (_, radius, _, first)) in THINGS.iter().enumerate() {
                for t in [first - 0.01, first + 0.01] {
                    let Body { middle, .. } = scene.body(index, t);
                    let outside = (middle.abs() - reach).max_element();
                    assert!(outside > radius * 0.9, "{index} at {middle}");
                }
            }
        }
    }
}

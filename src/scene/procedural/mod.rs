//! Built-in scenes: no file needed, any size, any length, the same from the same seed.
//!
//! They are laid out in the largest centred square of the image (`shape::Stage`) and go on beyond it in wider or
//! higher images. Radiance is in units of the scene's bright parts: about 1 at the 99th percentile, lamps and
//! glints far above, dark corners at 10⁻³ and less.

mod chart;
mod edge;
mod falling;
mod fan;
mod glyph;
mod leds;
mod light;
mod pouring;
mod shape;
mod still;
mod texture;
mod wedge;

pub use edge::Edge;
pub use falling::Falling;
pub use fan::Fan;
pub use leds::Leds;
pub use pouring::Pouring;
pub use still::Still;
pub use wedge::Wedge;

use super::Scene;

/// A scene by its name.
struct Entry {
    name: &'static str,
    /// One line on what is seen.
    shows: &'static str,
    /// Makes it, for (height, width, seed).
    make: fn(usize, usize, u64) -> Box<dyn Scene>,
}

/// All scenes.
const SCENES: [Entry; 10] = [
    Entry {
        name: "fan",
        shows: "a fan with letters on its blades at 400 rpm, a bare bulb, and a resolution chart in the dark",
        make: |height, width, seed| Box::new(Fan::new(height, width, seed)),
    },
    Entry {
        name: "leds",
        shows: "two LEDs on a circuit board, switched on 2 frames apart, again and again",
        make: |height, width, seed| Box::new(Leds::new(height, width, seed)),
    },
    Entry {
        name: "falling",
        shows: "balls, a die, a block and an envelope that fall and bounce in a dark room with a bright window",
        make: |height, width, seed| Box::new(Falling::new(height, width, seed)),
    },
    Entry {
        name: "pouring",
        shows: "a stream that breaks into drops and fills a glass, lit from behind, with glints",
        make: |height, width, seed| Box::new(Pouring::new(height, width, seed)),
    },
    Entry {
        name: "edge",
        shows: "a slanted edge (5°), static, for the modulation transfer function",
        make: |height, width, _| Box::new(Edge::new(height, width, 0.0)),
    },
    Entry {
        name: "edge-moving",
        shows: "the slanted edge, moving to and fro at 0.25 px/frame",
        make: |height, width, _| Box::new(Edge::new(height, width, 0.25)),
    },
    Entry {
        name: "wedge",
        shows: "a step wedge from 0.001 to 1 in quarter decades, with line pairs and a smooth ramp, static",
        make: |height, width, _| Box::new(Wedge::new(height, width, 0.0)),
    },
    Entry {
        name: "wedge-moving",
        shows: "the step wedge, drifting at 0.25 px/frame",
        make: |height, width, _| Box::new(Wedge::new(height, width, 0.25)),
    },
    Entry {
        name: "still",
        shows: "a desk with a lamp, books and a bottle, and a resolution chart in a dark corner, static",
        make: |height, width, seed| Box::new(Still::new(height, width, seed, 0.0)),
    },
    Entry {
        name: "still-moving",
        shows: "the still life, and a banded ball that swings to and fro in front of it at up to 0.5 px/frame",
        make: |height, width, seed| Box::new(Still::new(height, width, seed, 0.5)),
    },
];

/// Names of all scenes.
pub const NAMES: [&str; SCENES.len()] = {
    let mut names = [""; SCENES.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = SCENES[i].name;
        i += 1;
    }
    names
};

/// The scene of that name for images of `height` × `width` pixels. `seed` sets textures and the course of
/// events; `None` if there is no such scene.
pub fn by_name(name: &str, height: usize, width: usize, seed: u64) -> Option<Box<dyn Scene>> {
    SCENES.iter().find(|entry| entry.name == name).map(|entry| (entry.make)(height, width, seed))
}

/// One line on what the scene of that name shows.
pub fn describe(name: &str) -> Option<&'static str> {
    SCENES.iter().find(|entry| entry.name == name).map(|entry| entry.shows)
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use crate::scene::{Rendering, render};
    use crate::video::Video;

    fn video(scene: &dyn Scene, frames: usize, height: usize, width: usize) -> Video {
        render(scene, Rendering { frames, height, width, instants: 2, positions: 4, seed: 0 }, || ())
    }

    fn named(name: &str, height: usize, width: usize) -> Box<dyn Scene> {
        by_name(name, height, width, 1).expect("it is in the list")
    }

    #[test]
    fn every_name_makes_a_scene_and_has_a_line() {
        for (i, name) in NAMES.iter().enumerate() {
            assert!(by_name(name, 8, 8, 0).is_some() && !NAMES[..i].contains(name), "{name}");
            assert!(describe(name).is_some_and(|line| !line.contains('\n')), "{name}");
        }
        assert!(by_name("nothing", 8, 8, 0).is_none() && describe("nothing").is_none());
    }

    #[test]
    fn radiance_is_finite_and_not_negative_at_any_size_and_time() {
        for name in NAMES {
            for (height, width) in [(64, 64), (24, 96), (96, 24), (1, 1), (2, 7)] {
                let scene = named(name, height, width);
                video(&*scene, 3, height, width).check_finite().expect(name);
                for t in [-1e4, -50.5, 37.25, 611.0, 2e4, 1e6] {
                    let look = scene.instant(t);
                    for i in 0..256 {
                        let share = Vec2::new((i % 16) as f32 + 0.5, (i / 16) as f32 + 0.5) / 16.0;
                        let value = look(share * Vec2::new(width as f32, height as f32));
                        assert!(value.is_finite() && value >= 0.0, "{name} at {t}: {value}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_range_is_high_and_the_bright_part_small() {
        for name in ["fan", "leds", "falling", "pouring", "still"] {
            let mut sorted = video(&*named(name, 128, 128), 16, 128, 128).data;
            sorted.sort_by(f32::total_cmp);
            let at = |share: f32| sorted[(share * (sorted.len() - 1) as f32) as usize];
            // From what any camera sees as black up to lamps and glints; the anchor is among the lamps.
            assert!(at(1.0) > 1e3 * at(0.01), "{name}: {} … {}", at(0.01), at(1.0));
            assert!(at(0.99) > 10.0 * at(0.5), "{name}: median {}, 99% {}", at(0.5), at(0.99));
            // The dark half is no black hole: there is something to see in it.
            assert!(at(0.4) > 1.5 * at(0.02), "{name}: {} … {}", at(0.02), at(0.4));
        }
        let wedge = video(&*named("wedge", 128, 128), 1, 128, 128).data;
        let (low, high) = wedge.iter().fold((1.0_f32, 0.0_f32), |(low, high), v| (low.min(*v), high.max(*v)));
        assert!(low < 1e-3 && high > 0.95 && high < 1.001, "{low} … {high}");
    }

    #[test]
    fn what_is_static_is_and_what_moves_does() {
        for name in NAMES {
            let seen = video(&*named(name, 64, 64), 8, 64, 64);
            let still = (1..8).all(|t| seen.frame(t) == seen.frame(0));
            assert_eq!(still, ["edge", "wedge", "still"].contains(&name), "{name}");
        }
    }

    #[test]
    fn the_left_led_goes_on_two_frames_after_the_right_one() {
        let seen = video(&*named("leds", 64, 64), 80, 64, 64);
        // In the middle of each lens.
        let mean =
            |t: usize, column: usize| (24..29).map(|y| seen.frame(t)[y * 64 + column]).sum::<f32>() / 5.0;
        let rises = |column: usize, t: usize| mean(t, column) > 0.5 && mean(t - 1, column) < 0.1;
        let risen = |column: usize| (1..80).filter(|&t| rises(column, t)).collect::<Vec<_>>();
        assert_eq!(risen(43), [4, 36, 68]);
        assert_eq!(risen(20), [6, 38, 70]);
    }

    #[test]
    fn the_fan_comes_round() {
        let seen = video(&Fan::new(64, 64, 2).with_period(40.0), 81, 64, 64);
        let apart = |a: usize, b: usize| {
            let pairs = seen.frame(a).iter().zip(seen.frame(b));
            pairs.map(|(a, b)| (a - b).abs() / (a + b)).fold(0.0, f32::max)
        };
        assert!(apart(3, 43) < 1e-2 && apart(0, 80) < 1e-2, "{} {}", apart(3, 43), apart(0, 80));
        assert!(apart(0, 20) > 0.2);
        let seen = video(&Fan::new(64, 64, 2).with_period(f32::INFINITY), 2, 64, 64);
        assert_eq!(seen.frame(0), seen.frame(1));
    }

    #[test]
    fn neither_threads_nor_repetition_change_anything_but_the_seed_does() {
        let with = |threads: usize, name: &str, seed: u64| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let scene = by_name(name, 48, 48, seed).expect("it is in the list");
            pool.install(|| video(&*scene, 3, 48, 48))
        };
        for name in NAMES {
            assert_eq!(with(1, name, 5), with(3, name, 5), "{name}");
        }
        for name in ["fan", "leds", "falling", "pouring", "still"] {
            assert!(with(2, name, 5) != with(2, name, 6), "{name}");
        }
    }
}

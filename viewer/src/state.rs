//! What the interface is set to, and how each action changes it. No window is needed for any of this.

use crate::action::{Action, Effect};
use crate::choices::{ALLOWED_ERRORS, EXECUTORS, PRECISIONS, next, skips};
use crate::clock::{Clock, RATE_RANGE, Reach, Wish};
use crate::place::Look;
use crate::preferences::{Arrangement, EXPOSURES, Preferences, Theme};
use crate::tone::Curve;
use pix2hdr::synth::Settings;
use pix2hdr::synth::Skip;

/// Most pixels of which the time series is shown.
pub const MOST_PICKS: usize = 4;

/// All that the interface is set to.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// What is remembered.
    pub preferences: Preferences,
    /// The playhead.
    pub clock: Clock,
    /// Zoom and pan.
    pub look: Look,
    /// Pixels [row, column] of which the time series is shown.
    pub picks: Vec<[usize; 2]>,
    /// First and last frame of what is recorded; where there is none, what is in memory.
    pub range: [Option<usize>; 2],
    /// The pane that number keys change.
    pub pane: usize,
    /// Whether the list of keys is open.
    pub help: bool,
    /// The engine's settings.
    pub settings: Settings,
    /// The nets that the dial offers.
    pub nets: Vec<String>,
    /// Rows and columns of the pictures, and width and height of a pane in points, as they were last drawn.
    pub drawn: ([usize; 2], [f32; 2]),
    /// The pixel under the pointer.
    pub pointer: Option<[usize; 2]>,
}

impl State {
    /// A state with these preferences and settings.
    pub fn new(preferences: Preferences, settings: Settings) -> Self {
        let clock = Clock { rate: preferences.rate, looping: preferences.looping, ..Clock::default() };
        let nets = vec![settings.weights.clone()];
        Self {
            preferences,
            clock,
            look: Look::default(),
            picks: Vec::new(),
            range: [None; 2],
            pane: 0,
            help: false,
            settings,
            nets,
            drawn: ([0; 2], [0.0; 2]),
            pointer: None,
        }
    }

    /// Lets time pass.
    pub fn advance(&mut self, seconds: f64, reach: Reach) -> Option<Effect> {
        seek(self.clock.advance(seconds, reach))
    }

    /// Does what a user wants.
    // Long because each action has its arm, and the compiler names those that are missing.
    pub fn apply(&mut self, action: Action, reach: Reach) -> Option<Effect> {
        let preferences = &mut self.preferences;
        match action {
            Action::Play => {
                self.clock.playing = !self.clock.playing;
                let ended = reach.frames.is_some_and(|frames| self.clock.frame() + 1 >= frames);
                if self.clock.playing && ended {
                    return seek(self.clock.go_to(0, reach));
                }
            }
            Action::Step(by) => return seek(self.clock.step(by, reach)),
            Action::GoTo(frame) => return seek(self.clock.go_to(frame, reach)),
            Action::First => return seek(self.clock.go_to(0, reach)),
            Action::Last => return seek(self.clock.go_to(usize::MAX >> 1, reach)),
            Action::Rate(rate) => self.set_rate(rate),
            Action::Faster | Action::Slower => {
                self.clock.next_rate(action == Action::Faster);
                self.set_rate(self.clock.rate);
            }
            Action::Loop => {
                self.clock.looping = !self.clock.looping;
                preferences.looping = self.clock.looping;
            }
            Action::Exposure(stops) if stops.is_finite() => {
                preferences.display.exposure = stops.clamp(EXPOSURES[0], EXPOSURES[1]);
            }
            Action::Expose(by) => {
                let exposure = preferences.display.exposure + by;
                return self.apply(Action::Exposure(exposure), reach);
            }
            Action::Curve(curve) => preferences.display.curve = curve,
            Action::NextCurve => preferences.display.curve = next(&Curve::ALL, preferences.display.curve),
            Action::Clipping => preferences.display.clipping = !preferences.display.clipping,
            Action::Dither => preferences.display.dither = !preferences.display.dither,
            Action::WidenDifference(by) => {
                let range = preferences.display.difference * by;
                return self.apply(Action::Difference(range), reach);
            }
            Action::Difference(l) if l.is_finite() => preferences.display.difference = l.clamp(0.001, 1.0),
            Action::Arrange(arrangement) => {
                preferences.arrangement = arrangement;
                self.pane = self.pane.min(arrangement.panes() - 1);
            }
            Action::NextArrangement => {
                let arrangement = next(&Arrangement::ALL, preferences.arrangement);
                return self.apply(Action::Arrange(arrangement), reach);
            }
            Action::Show(pane, picture) => {
                if let Some(shown) = preferences.pictures_mut().get_mut(pane) {
                    *shown = picture;
                    self.pane = pane;
                }
            }
            Action::ShowHere(picture) => return self.apply(Action::Show(self.pane, picture), reach),
            Action::NextPane => self.pane = (self.pane + 1) % preferences.arrangement.panes(),
            Action::Divider(at) if at.is_finite() => preferences.divider = at.clamp(0.0, 1.0),
            Action::MoveDivider(by) => {
                let at = preferences.divider + by;
                return self.apply(Action::Divider(at), reach);
            }
            Action::Fit => self.look = Look::default(),
            Action::Actual => {
                let (extent, pane) = self.drawn;
                let scale = self.look.place(extent, pane).scale;
                self.look.zoom_by(1.0 / scale, pane.map(|s| 0.5 * s), extent, pane);
            }
            Action::Zoom(factor, at) => {
                let (extent, pane) = self.drawn;
                self.look.zoom_by(factor, at.unwrap_or(pane.map(|s| 0.5 * s)), extent, pane);
            }
            Action::Pan(by) => {
                // A fitted picture is moved from where it is.
                let (extent, pane) = self.drawn;
                if self.look.zoom.is_none() {
                    self.look.zoom_by(1.0, [0.0; 2], extent, pane);
                }
                self.look.pan(by, extent);
            }
            Action::PickHere => {
                let [height, width] = self.drawn.0;
                let pixel = self.pointer.unwrap_or([height / 2, width / 2]);
                return self.apply(Action::Pick(pixel), reach);
            }
            Action::Pick(pixel) => {
                let others = self.picks.len();
                self.picks.retain(|pick| *pick != pixel);
                if self.picks.len() == others {
                    self.picks.push(pixel);
                }
                if self.picks.len() > MOST_PICKS {
                    self.picks.remove(0);
                }
                preferences.series |= !self.picks.is_empty();
            }
            Action::Unpick => self.picks.clear(),
            Action::Overlay => preferences.overlay = !preferences.overlay,
            Action::Dials => preferences.dials = !preferences.dials,
            Action::Series => preferences.series = !preferences.series,
            Action::Help => self.help = !self.help,
            Action::NextTheme => {
                preferences.theme = next(&[Theme::System, Theme::Dark, Theme::Light], preferences.theme);
            }
            Action::RangeFrom => {
                let frame = self.clock.frame();
                self.range = [Some(frame), self.range[1].filter(|last| *last >= frame)];
            }
            Action::RangeTo => {
                let frame = self.clock.frame();
                self.range = [self.range[0].filter(|first| *first <= frame), Some(frame)];
            }
            Action::NoRange => self.range = [None; 2],
            Action::SaveExr => return Some(Effect::SaveExr),
            Action::SavePng => return Some(Effect::SavePng),
            Action::Record => {
                let [first, last] = reach.span?;
                return Some(Effect::Record([self.range[0].unwrap_or(first), self.range[1].unwrap_or(last)]));
            }
            Action::Copy => return Some(Effect::Copy),
            Action::Tune(settings) => {
                if settings != self.settings {
                    self.settings = settings.clone();
                    return Some(Effect::Tune(settings, self.clock.frame()));
                }
            }
            Action::NextNet => {
                let at = self.nets.iter().position(|net| *net == self.settings.weights);
                let next = self.nets.get(at.map_or(0, |at| (at + 1) % self.nets.len())).cloned();
                let weights = next.unwrap_or_else(|| self.settings.weights.clone());
                return self.apply(Action::Tune(Settings { weights, ..self.settings.clone() }), reach);
            }
            Action::NextExecutor => {
                let executor = next(&EXECUTORS, self.settings.executor);
                return self.apply(Action::Tune(Settings { executor, ..self.settings.clone() }), reach);
            }
            Action::NextPrecision => {
                let precision = next(&PRECISIONS, self.settings.precision);
                return self.apply(Action::Tune(Settings { precision, ..self.settings.clone() }), reach);
            }
            Action::NextSkip => {
                let skip = next(&skips(self.settings.skip), self.settings.skip);
                return self.apply(Action::Tune(Settings { skip, ..self.settings.clone() }), reach);
            }
            Action::AllowMore(by) => {
                if let Skip::Bounded(error) = self.settings.skip {
                    let skip = Skip::Bounded((error * by).clamp(ALLOWED_ERRORS[0], ALLOWED_ERRORS[1]));
                    return self.apply(Action::Tune(Settings { skip, ..self.settings.clone() }), reach);
                }
            }
            Action::Open(source) => {
                let Clock { rate, looping, .. } = self.clock;
                self.clock = Clock { rate, looping, ..Clock::default() };
                self.look = Look::default();
                self.picks.clear();
                self.range = [None; 2];
                return Some(Effect::Open(source));
            }
            Action::Type => return Some(Effect::Type),
            Action::Quit => return Some(Effect::Quit),
            // Numbers that are none change nothing.
            Action::Exposure(_) | Action::Difference(_) | Action::Divider(_) => {}
        }
        None
    }

    fn set_rate(&mut self, rate: f64) {
        if rate.is_finite() {
            self.clock.rate = rate.clamp(RATE_RANGE[0], RATE_RANGE[1]);
            self.preferences.rate = self.clock.rate;
        }
    }
}

fn seek(wish: Wish) -> Option<Effect> {
    match wish {
        Wish::None => None,
        Wish::Seek(frame) => Some(Effect::Seek(frame)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::choices::nets;
    use crate::picture::Picture;
    use pix2hdr::network::Precision;
    use pix2hdr::sensor::Pattern;
    use pix2hdr::synth;

    fn settings() -> Settings {
        Settings {
            weights: "fast".into(),
            executor: synth::ExecutorChoice::Cpu,
            adapter: None,
            precision: Precision::F32,
            skip: Skip::Off,
            tile: None,
            hop: None,
            ensemble: 1,
            accumulate: false,
        }
    }

    fn state() -> State {
        State::new(Preferences::default(), settings())
    }

    const FILE: Reach = Reach { span: Some([0, 40]), frames: Some(100), burst: 8 };

    #[test]
    fn playing_again_at_the_end_begins_anew() {
        let mut state = state();
        state.clock.looping = false;
        assert_eq!(state.apply(Action::Last, FILE), Some(Effect::Seek(99)));
        state.clock.playing = false;
        let reach = Reach { span: Some([90, 99]), ..FILE };
        assert_eq!(state.apply(Action::Play, reach), Some(Effect::Seek(0)));
        assert!(state.clock.playing);
    }

    #[test]
    fn each_arrangement_keeps_its_pictures() {
        let mut state = state();
        state.apply(Action::Show(3, Picture::Difference), FILE);
        assert_eq!((state.preferences.pictures()[3], state.pane), (Picture::Difference, 3));
        state.apply(Action::Arrange(Arrangement::Divider), FILE);
        assert_eq!((state.preferences.pictures(), state.pane), (&[Picture::Mosaic, Picture::Ours][..], 1));
        state.apply(Action::ShowHere(Picture::Truth), FILE);
        state.apply(Action::Show(7, Picture::Truth), FILE);
        assert_eq!(state.preferences.pictures(), [Picture::Mosaic, Picture::Truth]);
        state.apply(Action::Arrange(Arrangement::Four), FILE);
        assert_eq!(state.preferences.pictures()[3], Picture::Difference);
        (0..4).for_each(|_| drop(state.apply(Action::NextPane, FILE)));
        assert_eq!(state.pane, 1);
    }

    #[test]
    fn numbers_stay_within_their_bounds() {
        let mut state = state();
        for action in [
            Action::Exposure(1e9),
            Action::Exposure(f32::NAN),
            Action::Divider(7.0),
            Action::MoveDivider(f32::INFINITY),
            Action::Rate(f64::NAN),
            Action::Rate(1e99),
            Action::Difference(0.0),
        ] {
            state.apply(action, FILE);
        }
        let Preferences { display, divider, rate, .. } = &state.preferences;
        assert_eq!((display.exposure, *divider, *rate, display.difference), (16.0, 1.0, 10_000.0, 0.001));
    }

    #[test]
    fn pixels_are_picked_and_forgotten() {
        let mut state = state();
        for i in 0..6 {
            state.apply(Action::Pick([i, i]), FILE);
        }
        assert_eq!(state.picks, [[2, 2], [3, 3], [4, 4], [5, 5]]);
        assert!(state.preferences.series);
        state.apply(Action::Pick([3, 3]), FILE);
        assert_eq!(state.picks.len(), 3);
        state.apply(Action::Unpick, FILE);
        assert!(state.picks.is_empty());
    }

    #[test]
    fn a_range_is_in_order() {
        let mut state = state();
        assert_eq!(state.apply(Action::Record, FILE), Some(Effect::Record([0, 40])));
        state.apply(Action::GoTo(10), FILE);
        state.apply(Action::RangeTo, FILE);
        state.apply(Action::GoTo(20), FILE);
        state.apply(Action::RangeFrom, FILE);
        assert_eq!(state.range, [Some(20), None]);
        assert_eq!(state.apply(Action::Record, FILE), Some(Effect::Record([20, 40])));
        assert_eq!(state.apply(Action::Record, Reach { span: None, ..FILE }), None);
    }

    /// Every dial has a key, and turns back to where it was.
    #[test]
    fn dials_go_round() {
        let mut state = state();
        state.nets = nets(Pattern::built_in("mpve-1-4").ok().as_ref(), "mine.safetensors");
        assert!(state.nets.len() > 2 && state.nets.contains(&"fast".to_owned()), "{:?}", state.nets);
        assert_eq!(nets(Pattern::built_in("sve").ok().as_ref(), "fast"), ["fast"]);
        let rounds =
            [(Action::NextNet, state.nets.len()), (Action::NextExecutor, 3), (Action::NextPrecision, 2)];
        for (action, round) in rounds.into_iter().chain([(Action::NextSkip, 3)]) {
            for turn in 1..=round {
                let effect = state.apply(action.clone(), FILE);
                assert_eq!(effect, Some(Effect::Tune(state.settings.clone(), 0)), "{action:?}");
                assert_eq!(state.settings == settings(), turn == round, "{action:?} {turn}");
            }
        }
        assert_eq!(state.apply(Action::AllowMore(2.0), FILE), None);
        state.apply(Action::Tune(Settings { skip: Skip::Bounded(0.002), ..settings() }), FILE);
        state.apply(Action::AllowMore(2.0), FILE);
        assert_eq!(state.settings.skip, Skip::Bounded(0.004));
        state.apply(Action::AllowMore(1e9), FILE);
        assert_eq!(state.settings.skip, Skip::Bounded(ALLOWED_ERRORS[1]));
    }

    #[test]
    fn only_new_dials_disturb_the_engine() {
        let mut state = state();
        assert_eq!(state.apply(Action::Tune(settings()), FILE), None);
        let other = Settings { skip: Skip::Exact, ..settings() };
        state.apply(Action::GoTo(7), FILE);
        assert_eq!(state.apply(Action::Tune(other.clone()), FILE), Some(Effect::Tune(other, 7)));
    }

    #[test]
    fn settings_come_back_and_broken_ones_do_not_matter() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/view.json");
        assert_eq!(Preferences::read(&path), Preferences::default());
        let mut state = state();
        state.apply(Action::Arrange(Arrangement::Divider), FILE);
        state.apply(Action::NextCurve, FILE);
        state.apply(Action::Rate(240.0), FILE);
        state.preferences.write(&path).unwrap();
        assert_eq!(Preferences::read(&path), state.preferences);
        std::fs::write(&path, r#"{"divider": 1e30, "rate": -4, "unknown": 1}"#).unwrap();
        let read = Preferences::read(&path);
        assert_eq!((read.divider, read.rate), (1.0, 0.1));
        std::fs::write(&path, "{").unwrap();
        assert_eq!(Preferences::read(&path), Preferences::default());
    }
}

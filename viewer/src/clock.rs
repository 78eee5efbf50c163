//! Playback: which frame is looked at, and how fast a simulated camera runs.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Rates that the keyboard steps through, in frames per second of the viewer's time.
const RATES: [f64; 15] =
    [1.0, 2.0, 5.0, 10.0, 15.0, 24.0, 30.0, 60.0, 120.0, 240.0, 333.0, 500.0, 1000.0, 2000.0, 4000.0];

/// The least and the largest rate.
pub const RATE_RANGE: [f64; 2] = [0.1, 10_000.0];

/// The playhead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock {
    /// Whether it moves.
    pub playing: bool,
    /// Frames per second of the viewer's time.
    pub rate: f64,
    /// Whether it begins again at the end.
    pub looping: bool,
    /// Where it is, in frames.
    pub position: f64,
}

/// What can be shown now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reach {
    /// First and last frame in memory.
    pub span: Option<[usize; 2]>,
    /// Number of frames of a file; `None` for a live source.
    pub frames: Option<usize>,
    /// Result frames that come at once: a live picture may be that much behind the newest one.
    pub burst: usize,
}

/// What moving the playhead asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wish {
    /// Nothing.
    None,
    /// A frame that is not in memory.
    Seek(usize),
}

impl Default for Clock {
    /// 30 frames a second: 1000 fps slowed 33 times, as the paper's authors show their videos.
    fn default() -> Self {
        Self { playing: true, rate: 30.0, looping: true, position: 0.0 }
    }
}

impl Clock {
    /// The frame that is looked at.
    pub fn frame(&self) -> usize {
        self.position.max(0.0) as usize
    }

    /// Lets `seconds` pass. A frame that is not there yet is waited for. A live picture that has fallen behind catches
    /// up at once, so that its latency stays bounded.
    pub fn advance(&mut self, seconds: f64, reach: Reach) -> Wish {
        let Some([first, last]) = reach.span else { return Wish::None };
        if !self.playing {
            return Wish::None;
        }
        self.position += seconds.clamp(0.0, 1.0) * self.rate;
        match reach.frames {
            None => {
                // A quarter of a second, or what comes at once.
                let behind = (0.25 * self.rate).max(2.0 * reach.burst as f64);
                let oldest = (last as f64 - behind).max(first as f64);
                self.position = self.position.clamp(oldest, last as f64 + 0.999);
                Wish::None
            }
            Some(frames) if self.position >= frames as f64 && last + 1 >= frames => {
                if self.looping {
                    self.go_to(0, reach)
                } else {
                    self.position = frames.saturating_sub(1) as f64;
                    self.playing = false;
                    Wish::None
                }
            }
            Some(_) => {
                self.position = self.position.min(last as f64 + 0.999);
                Wish::None
            }
        }
    }

    /// Moves the playhead to frame `number`, as far as there are such frames.
    pub fn go_to(&mut self, number: usize, reach: Reach) -> Wish {
        match (reach.frames, reach.span) {
            (Some(frames), span) => {
                let number = number.min(frames.saturating_sub(1));
                self.position = number as f64;
                // The next frames are about to come; others have to be asked for.
                let coming = span.is_some_and(|[first, last]| (first..=last + reach.burst).contains(&number));
                if coming { Wish::None } else { Wish::Seek(number) }
            }
            (None, Some([first, last])) => {
                self.position = number.clamp(first, last) as f64;
                Wish::None
            }
            (None, None) => Wish::None,
        }
    }

    /// Stops, and moves by `by` frames.
    pub fn step(&mut self, by: i64, reach: Reach) -> Wish {
        self.playing = false;
        self.go_to(self.frame().saturating_add_signed(by as isize), reach)
    }

    /// The next of the usual rates above (`up`) or below the present one.
    pub fn next_rate(&mut self, up: bool) {
        let next = if up {
            RATES.iter().find(|rate| **rate > self.rate * 1.001)
        } else {
            RATES.iter().rev().find(|rate| **rate < self.rate * 0.999)
        };
        self.rate = next.copied().unwrap_or(self.rate);
    }

    /// How many times slower than real time it runs, for frames of `period_ms`.
    pub fn slowed(&self, period_ms: f64) -> f64 {
        1e3 / (self.rate * period_ms)
    }
}

/// The clock of a simulated camera: it exposes frames at a rate of its own, whether or not somebody takes them.
#[derive(Debug)]
pub struct CameraClock(Mutex<Running>);

#[derive(Clone, Copy, Debug)]
struct Running {
    /// Frames exposed at `since`.
    exposed: f64,
    since: Instant,
    /// Frames per second; 0 while it stands still.
    rate: f64,
}

impl CameraClock {
    /// A clock at frame 0 that stands still.
    pub fn new(now: Instant) -> Self {
        Self(Mutex::new(Running { exposed: 0.0, since: now, rate: 0.0 }))
    }

    /// Frames exposed by `now`.
    pub fn exposed(&self, now: Instant) -> f64 {
        let Running { exposed, since, rate } = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        exposed + rate * now.saturating_duration_since(since).as_secs_f64()
    }

    /// Goes on at `rate` frames per second; 0 stops it.
    pub fn set_rate(&self, rate: f64, now: Instant) {
        let exposed = self.exposed(now);
        let mut running = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if running.rate != rate {
            *running = Running { exposed, since: now, rate };
        }
    }

    /// Puts the clock to `exposed` frames.
    pub fn set(&self, exposed: f64, now: Instant) {
        let mut running = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *running = Running { exposed, since: now, ..*running };
    }

    /// Frames per second.
    pub fn rate(&self) -> f64 {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).rate
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn file(span: [usize; 2], frames: usize) -> Reach {
        Reach { span: Some(span), frames: Some(frames), burst: 8 }
    }

    #[test]
    fn a_file_waits_for_frames_and_loops() {
        let mut clock = Clock { rate: 10.0, ..Clock::default() };
        assert_eq!(clock.advance(1.0, Reach { span: None, frames: Some(20), burst: 8 }), Wish::None);
        assert_eq!(clock.frame(), 0);
        clock.advance(1.0, file([0, 3], 20));
        assert_eq!(clock.frame(), 3);
        clock.advance(0.5, file([0, 19], 20));
        assert_eq!(clock.frame(), 8);
        clock.advance(1.0, file([0, 19], 20));
        assert_eq!(clock.frame(), 18);
        // All is in memory: looping asks for nothing. If the beginning is gone, it is asked for.
        let mut other = clock;
        assert_eq!(clock.advance(0.5, file([0, 19], 20)), Wish::None);
        assert_eq!((clock.frame(), clock.playing), (0, true));
        assert_eq!(other.advance(0.5, file([9, 19], 20)), Wish::Seek(0));
        other = Clock { looping: false, position: 19.0, ..clock };
        other.advance(1.0, file([0, 19], 20));
        assert_eq!((other.frame(), other.playing), (19, false));
    }

    #[test]
    fn a_live_picture_stays_near_the_newest_frame() {
        let live = |first, last| Reach { span: Some([first, last]), frames: None, burst: 8 };
        let mut clock = Clock { rate: 30.0, ..Clock::default() };
        clock.advance(0.1, live(0, 500));
        assert_eq!(clock.frame(), 500 - 16);
        clock.advance(0.1, live(0, 500));
        assert_eq!(clock.frame(), 487);
        clock.advance(1.0, live(0, 500));
        assert_eq!(clock.frame(), 500);
        // Frames that are gone are passed over.
        clock.advance(0.01, live(10_000, 10_007));
        assert_eq!(clock.frame(), 10_000);
        clock.playing = false;
        clock.advance(1.0, live(20_000, 20_007));
        assert_eq!(clock.frame(), 10_000);
    }

    #[test]
    fn steps_stop_and_ask_for_what_is_not_there() {
        let mut clock = Clock { position: 5.5, ..Clock::default() };
        assert_eq!(clock.step(1, file([0, 9], 100)), Wish::None);
        assert_eq!((clock.frame(), clock.playing), (6, false));
        assert_eq!(clock.step(-100, file([0, 9], 100)), Wish::None);
        assert_eq!(clock.frame(), 0);
        assert_eq!(clock.step(50, file([0, 9], 100)), Wish::Seek(50));
        assert_eq!(clock.step(500, file([40, 60], 100)), Wish::Seek(99));
        let live = Reach { span: Some([40, 60]), frames: None, burst: 8 };
        clock.step(500, live);
        assert_eq!(clock.frame(), 60);
    }

    #[test]
    fn rates_go_up_and_down_within_bounds() {
        let mut clock = Clock::default();
        clock.next_rate(true);
        assert_eq!(clock.rate, 60.0);
        for _ in 0..40 {
            clock.next_rate(false);
        }
        assert_eq!(clock.rate, 1.0);
        assert!((Clock { rate: 30.0, ..clock }.slowed(1.0) - 33.33).abs() < 0.01);
    }

    #[test]
    fn a_camera_goes_on_by_itself() {
        let start = Instant::now();
        let camera = CameraClock::new(start);
        let at = |s: f64| start + Duration::from_secs_f64(s);
        assert_eq!(camera.exposed(at(5.0)), 0.0);
        camera.set_rate(1000.0, at(5.0));
        assert!((camera.exposed(at(7.0)) - 2000.0).abs() < 1e-6);
        camera.set_rate(10.0, at(7.0));
        assert!((camera.exposed(at(8.0)) - 2010.0).abs() < 1e-6);
        camera.set(64.0, at(8.0));
        assert!((camera.exposed(at(9.0)) - 74.0).abs() < 1e-6);
    }
}

//! What a recording shows of its own schedule.
//!
//! A pixel's count changes only when a read-out ends: at t ≡ φ (mod e). So the times at which the pixels of each place
//! change tell tile origin, orientation and schedule start ([`placing`]), and frames that were dropped or repeated
//! ([`gaps`]). Whether frames hold the exposure that covers them or the last finished one changes none of these times; it
//! shows where the scene moves, since long exposures see what the short ones beside them saw at the same time
//! ([`timing`]). What is not clear is not known: nothing is ever guessed.

mod changes;
mod gaps;
mod placing;
mod signature;
mod timing;

use self::changes::Changes;
pub use self::gaps::Gap;
use self::gaps::Track;
use self::placing::{Candidate, Placing};
use self::timing::Excerpt;
use super::{Pattern, Placement, Recording, Timing};
use crate::math::lcm;
use crate::video::Counts;

/// Largest square that a pattern repeats after, and largest period, that are looked for.
const MAX_GRID: usize = 8;
const MAX_PERIOD: usize = 64;

/// Looks at the counts of a recording, frame after frame, and says what they show of its schedule.
#[derive(Clone, Debug)]
pub struct Detector {
    /// That of the sensor.
    pattern: Pattern,
    described: Described,
    /// Nothing where the pattern is too large, or the frames are too small.
    seen: Option<Seen>,
}

/// What a description says of the schedule.
#[derive(Clone, Copy, Debug)]
struct Described {
    placement: Placement,
    schedule_start: i64,
}

#[derive(Clone, Debug)]
struct Seen {
    changes: Changes,
    excerpt: Excerpt,
}

/// What a recording shows of its schedule.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Detection {
    /// When its pixels read out; nothing if that is not known.
    pub schedule: Option<DetectedSchedule>,
    /// What its frames hold; nothing if that is not known.
    pub timing: Option<Timing>,
}

/// When the pixels of a recording read out.
#[derive(Clone, Debug, PartialEq)]
pub struct DetectedSchedule {
    /// How its frames lie on the sensor: as the description says, where that shows the same.
    pub placement: Placement,
    /// Schedule time of the first frame: as the description says, where that shows the same, else within the first period.
    pub schedule_start: i64,
    /// Whether the description says the same.
    pub as_described: bool,
    /// Where frames were dropped or repeated, in order.
    pub gaps: Vec<Gap>,
    /// How much the pixels change between read-outs, as a part of how much they change at them: 0 for a clean recording.
    pub leak: f64,
}

impl Detector {
    /// A detector for what `recording` is described as: its pattern is believed.
    pub fn new(recording: &Recording) -> Self {
        let pattern = recording.sensor_pattern();
        let Recording { info, height, width, .. } = recording;
        let grid = lcm(pattern.rows(), pattern.cols());
        let fits = grid <= MAX_GRID.min(*height).min(*width) && pattern.period() <= MAX_PERIOD;
        let seen = fits.then(|| Seen {
            changes: Changes::new(grid, *width),
            excerpt: Excerpt::new(grid, [*height, *width]),
        });
        let described = Described { placement: info.placement(), schedule_start: info.schedule_start };
        Self { pattern, described, seen }
    }

    /// Looks at the counts of the next frame.
    pub fn add(&mut self, counts: &Counts) {
        if let Some(Seen { changes, excerpt }) = &mut self.seen {
            changes.add(counts);
            excerpt.add(counts);
        }
    }

    /// What all frames so far show.
    pub fn detect(&self) -> Detection {
        let Some(Seen { changes, excerpt }) = &self.seen else { return Detection::default() };
        let Some((candidate, track)) = self.track(changes) else { return Detection::default() };
        let Candidate { placement, leak, .. } = candidate;
        let period = self.pattern.period() as i64;
        let (placement, schedule_start) = self.plainest(placement, track.start as i64);
        let Described { placement: said, schedule_start: start } = self.described;
        let as_described = placement == said && (schedule_start - start).rem_euclid(period) == 0;
        let timing = if track.gaps.is_empty() {
            excerpt.timing(&placement.shown(&self.pattern), schedule_start)
        } else {
            None
        };
        let schedule = DetectedSchedule { placement, schedule_start, as_described, gaps: track.gaps, leak };
        Detection { schedule: Some(schedule), timing }
    }

    /// The only way in which the frames can lie on the sensor, and how its schedule goes on through them.
    fn track(&self, changes: &Changes) -> Option<(Candidate, Track)> {
        let placing = Placing::new(&self.pattern, changes.grid());
        let candidate = match placing.steady(changes) {
            Some(candidate) => candidate,
            // Frames that are missing shift all that follow.
            None => placing.through_gaps(changes)?,
        };
        let track = candidate.track(changes)?;
        Some((candidate, track))
    }

    /// Of all ways to say that pixels read out as in `placement` with a recording that begins at `start`, the one that is
    /// nearest to the description.
    fn plainest(&self, placement: Placement, start: i64) -> (Placement, i64) {
        let (pattern, said) = (&self.pattern, self.described);
        let period = pattern.period() as i64;
        let found = placement.shown(pattern);
        let same = |placement: &Placement, other: i64| {
            placing::reads_alike(&found, start, &placement.shown(pattern), other)
        };
        if same(&said.placement, said.schedule_start) {
            return (said.placement, said.schedule_start);
        }
        let all = || Placement::all([pattern.rows(), pattern.cols()]);
        let turned_alike = all().filter(|placement| placement.orientation == said.placement.orientation);
        [said.placement]
            .into_iter()
            .chain(turned_alike)
            .chain(all())
            .flat_map(|placement| {
                let starts = [said.schedule_start].into_iter().chain(0..period);
                starts.map(move |start| (placement, start))
            })
            .find(|(placement, start)| same(placement, *start))
            .unwrap_or((placement, start))
    }
}

#[cfg(test)]
mod tests;

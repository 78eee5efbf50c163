//! A recording is held against its description: bit depth and levels ([`levels`]), how values scale with exposure
//! ([`exposure`]), and the schedule that it shows ([`Detector`]).
//!
//! An inspection looks at counts as they stream past, and says the cause of what does not fit, and the option that cures it.

mod exposure;
mod levels;

pub use self::exposure::RatioCheck;
use self::exposure::StaticPixels;
pub use self::levels::LevelFinding;
use self::levels::Levels;
use super::{DetectedSchedule, Detection, Detector, Gap, Placement, Recording, Timing};
use crate::video::Counts;

/// Frames of which pixel values are compared over time: static parts stay static.
const LOOKS: usize = 16;

/// Holds a recording against its description, frame after frame.
#[derive(Clone, Debug)]
pub struct Inspection {
    recording: Recording,
    levels: Levels,
    static_pixels: StaticPixels,
    detector: Detector,
    /// Frames seen, and after how many one is looked at for [`StaticPixels`].
    frames: usize,
    every: usize,
    /// What is said of missing frames.
    missing: Option<Finding>,
}

/// What of a recording contradicts its description.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Finding {
    /// Bit depth or levels.
    #[error("{0}")]
    Levels(LevelFinding),
    /// The black level.
    #[error(
        "static pixels of different exposure agree on black level {black_level:.1} ± {error:.1} (standard error, {pairs} \
         pairs), not on {described}: --black-level {black_level:.1}"
    )]
    Black {
        /// What they agree on.
        black_level: f64,
        /// Its standard error.
        error: f64,
        /// Pairs of pixels.
        pairs: usize,
        /// What the description says.
        described: f64,
    },
    /// Values do not scale with exposure.
    #[error(
        "static pixels do not scale with their exposure: doubling it multiplies the value by {:.2} instead of 2 (median of \
         {} pairs): the response is another one: `import --fit-response` finds it", .0.exponent.exp2(), .0.pairs
    )]
    Exposure(RatioCheck),
    /// Pixels read out at other times.
    #[error(
        "counts change when those of {} would, not of {}: {}",
        say(found),
        say(described),
        options(described, found)
    )]
    Schedule {
        /// Placement and schedule start that the recording shows.
        found: (Placement, i64),
        /// What the description says.
        described: (Placement, i64),
    },
    /// Frames hold something else.
    #[error("long exposures show what short ones saw {}: --timing {}", timing_text(*.0), timing_name(*.0))]
    Timing(Timing),
    /// Frames are missing by their numbers.
    #[error(
        "{missing} of {frames} frames are missing by their numbers: pixels show what the same read-out shows in another \
         frame, or the last one"
    )]
    Missing {
        /// Frames that are missing.
        missing: usize,
        /// Frames from the first one to the last.
        frames: usize,
    },
    /// Frames are missing, or there twice.
    #[error("{}", gaps_text(.0))]
    Gaps(Vec<Gap>),
}

impl Finding {
    /// Whether `other` is of the same kind, in other figures.
    pub fn is_like(&self, other: &Self) -> bool {
        std::mem::discriminant(self) == std::mem::discriminant(other)
    }
}

fn say((placement, start): &(Placement, i64)) -> String {
    let [row, col] = placement.tile_origin;
    format!("tile origin {row},{col}, orientation {}, schedule start {start}", placement.orientation.name())
}

fn options(described: &(Placement, i64), found: &(Placement, i64)) -> String {
    let mut options = Vec::new();
    let [row, col] = found.0.tile_origin;
    if found.0.tile_origin != described.0.tile_origin {
        options.push(format!("--tile-origin {row},{col}"));
    }
    if found.0.orientation != described.0.orientation {
        options.push(format!("--orientation {}", found.0.orientation.name()));
    }
    if found.1 != described.1 {
        options.push(format!("--schedule-start {}", found.1));
    }
    options.join(" ")
}

fn timing_text(timing: Timing) -> &'static str {
    match timing {
        Timing::Covering => "in the same frames, so frames hold the exposures that cover them",
        Timing::Hold => "before, so frames hold the last finished read-outs",
    }
}

fn timing_name(timing: Timing) -> &'static str {
    match timing {
        Timing::Covering => "covering",
        Timing::Hold => "hold",
    }
}

fn gaps_text(gaps: &[Gap]) -> String {
    const SHOWN: usize = 5;
    let text = |gap: &Gap| match gap.missing {
        -1 => format!("frame {} is the one before it once more", gap.frame),
        1 => format!("a frame is missing before frame {}", gap.frame),
        n => format!("{n} frames are missing before frame {}", gap.frame),
    };
    let shown: Vec<String> = gaps.iter().take(SHOWN).map(text).collect();
    let more = gaps.len().saturating_sub(SHOWN);
    let more = if more > 0 { format!(", and {more} more such places") } else { String::new() };
    format!(
        "the schedule does not go on through all frames: {}{more}: --frame-numbers (or frame_numbers in the description) \
         says which there are",
        shown.join(", ")
    )
}

impl Inspection {
    /// Of a recording of counts of 8 or 16 `bits`, which has `frames` frames, `missing` of them put together from others.
    pub fn new(recording: &Recording, bits: u32, frames: usize, missing: usize) -> Self {
        Self {
            levels: Levels::new(&recording.pattern, recording.width, bits),
            static_pixels: StaticPixels::new(recording.height * recording.width),
            detector: Detector::new(recording),
            recording: recording.clone(),
            frames: 0,
            missing: (missing > 0).then_some(Finding::Missing { missing, frames }),
            every: frames.div_ceil(LOOKS).max(1),
        }
    }

    /// Looks at the next frame.
    pub fn add(&mut self, counts: &Counts) {
        self.detector.add(counts);
        if self.frames.is_multiple_of(self.every) {
            self.glance(counts);
        } else {
            self.levels.add(counts);
        }
        self.frames += 1;
    }

    /// Looks at when the counts of the next frame change, and at nothing else.
    pub(super) fn follow(&mut self, counts: &Counts) {
        self.detector.add(counts);
    }

    /// Looks at the values of a frame somewhere else.
    pub(super) fn glance(&mut self, counts: &Counts) {
        self.levels.add(counts);
        self.static_pixels.add(|values| self.recording.info.pixel_values(counts, None, values, None));
    }

    /// How static pixels scale with their exposure, where that can be judged.
    pub fn exposure(&self) -> Option<RatioCheck> {
        self.static_pixels.ratio(&self.recording)
    }

    /// What the recording shows of its schedule.
    pub fn detection(&self) -> Detection {
        self.detector.detect()
    }

    /// What contradicts the description.
    pub fn findings(&self) -> Vec<Finding> {
        let info = &self.recording.info;
        let levels = self.levels.findings(&self.recording);
        let Detection { schedule, timing } = self.detection();
        // With wrong levels or places, values say nothing of the response.
        let placed = schedule.as_ref().is_none_or(|schedule| schedule.as_described);
        let exposure = if placed && levels.is_empty() { self.exposure() } else { None };
        let exposure = exposure.and_then(|check| match check.other_black_level(&self.recording) {
            Some([black_level, error]) => {
                let (pairs, described) = (check.pairs, info.black_level);
                Some(Finding::Black { black_level, error, pairs, described })
            }
            None => check.is_off().then_some(Finding::Exposure(check)),
        });
        let timing = timing.filter(|timing| *timing != info.timing).map(Finding::Timing);
        let (other, gaps) = schedule.map_or((None, Vec::new()), |schedule| {
            let DetectedSchedule { placement, schedule_start, as_described, gaps, .. } = schedule;
            let described = (info.placement(), info.schedule_start);
            let other = Finding::Schedule { found: (placement, schedule_start), described };
            ((!as_described).then_some(other), gaps)
        });
        let gaps = (!gaps.is_empty()).then_some(Finding::Gaps(gaps));
        let missing = self.missing.clone().into_iter();
        missing
            .chain(levels.into_iter().map(Finding::Levels))
            .chain(exposure)
            .chain(other)
            .chain(timing)
            .chain(gaps)
            .collect()
    }
}

#[cfg(test)]
mod tests;

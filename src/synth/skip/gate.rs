//! Which cells have to be computed, and which may keep their last result.
//!
//! The gate looks at raw pixel values alone, in all that a cell's result depends on: its surroundings, and the frames before and behind.
//!
//! **Exact.** A cell keeps the result of the slab before (at the same phase of the pattern) if everything that it
//! depends on is bit-identical there. Then its result would be, too.
//!
//! **Bounded.** A cell keeps its last result if what it depends on differs from what that was computed from by no more
//! than noise explains or the user allows ([`super::reference`]). Every [`RENEWAL`] frames everything is computed anew,
//! so that a run can begin there as well as at the first frame; how far results had moved away is reported. Behind a
//! window in which everything had to be computed, the next one is, too, without a question.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cells::{Active, Cells};
use super::noise::Scatter;
use super::reference::Reference;
use super::tally::Skipped;
use crate::frame::Frame;
use crate::network::Window;
use crate::sensor::{Calibration, Recording};
use crate::synth::footage::Seen;

/// Part of the allowed error that the pixel values may change by; the rest is for what nets make more of it.
const INPUT_SHARE: f64 = 0.75;

/// Cells [rows, columns] around one that has changed whose results change noticeably, which was measured
/// (docs/skipping.md).
const SPREAD: [usize; 2] = [2, 3];

/// Frames after which a run with bounded skipping computes everything again, however little changes.
const RENEWAL: usize = 2048;

/// What may be left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Skip {
    /// Nothing.
    #[default]
    Off,
    /// What gives the same bits.
    Exact,
    /// What differs by no more than noise explains, or by no more than this in l.
    Bounded(f64),
}

impl Skip {
    /// Error that is allowed where the user says nothing: 1.7% of the irradiance. It costs less than 0.1 dB of PSNR-µ
    /// at the quality that the nets reach (docs/skipping.md).
    pub const ALLOWED_ERROR: f64 = 0.002;

    /// `off`, `exact` or `bounded`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Exact => "exact",
            Self::Bounded(_) => "bounded",
        }
    }

    /// Cells [rows, columns] around one that has changed that are computed with it, where results depend on pixels within
    /// `halo` [rows, columns].
    pub fn spread(self, cells: &Cells, halo: [usize; 2]) -> [usize; 2] {
        let spread = [0, 1].map(|axis| halo[axis].div_ceil(cells.size[axis + 1]));
        match self {
            Self::Bounded(_) => [0, 1].map(|axis| spread[axis].min(SPREAD[axis])),
            _ => spread,
        }
    }
}

/// What holds for all windows that a gate decides about.
#[derive(Clone, Copy, Debug)]
pub struct Rules<'a> {
    /// What may be left out.
    pub skip: Skip,
    /// The cells of a window.
    pub cells: &'a Cells,
    /// Which frames a window sees.
    pub window: Window,
    /// Cells [rows, columns] around a changed one that are computed with it ([`Skip::spread`]).
    pub spread: [usize; 2],
}

/// Decides what of each window to compute.
pub struct Gate<'a> {
    rules: Rules<'a>,
    /// Noise as the capture states it.
    stated: Option<Scatter>,
    /// Frames ahead that results depend on noticeably: those whose measurements they are made of, not those that only
    /// tell which to believe. All frames behind count: a result that is kept for long must not remember what has passed.
    noticed: usize,
    reference: Reference<'a>,
    recording: &'a Recording,
    /// The first window of the run.
    from: i64,
    /// Whether the window before was asked about, and all of it had to be computed.
    moves_everywhere: bool,
}

/// What of a window to compute.
#[derive(Debug)]
pub struct Choice {
    /// Active cells; `None` where nothing may be skipped.
    pub active: Option<Active>,
    /// Cells of the first slab that could have been kept in a window that is computed in whole.
    pub audit: Option<Vec<bool>>,
}

impl<'a> Gate<'a> {
    /// A gate for a run that delivers frames of `recording` from frame `number` on.
    pub fn new(
        rules: Rules<'a>,
        recording: &'a Recording,
        calibration: &'a Calibration,
        number: usize,
    ) -> Self {
        let bounded = matches!(rules.skip, Skip::Bounded(_));
        let reference = Reference::new(rules.cells, calibration, recording, bounded);
        let stated = Scatter::stated(recording);
        let noticed = calibration.period;
        let mut gate =
            Self { rules, stated, noticed, reference, recording, from: 0, moves_everywhere: false };
        gate.from = gate.window_before(number);
        gate
    }

    /// The window with which the run has to begin.
    pub fn from(&self) -> i64 {
        self.from
    }

    /// Frames before those of a window that the gate compares with.
    pub fn before(&self) -> i64 {
        let Rules { skip, cells, .. } = self.rules;
        if skip == Skip::Off { 0 } else { cells.repeat as i64 }
    }

    /// Windows until every slab of the pattern's schedule has had its turn.
    fn turns(&self) -> i64 {
        let Rules { cells, window, .. } = self.rules;
        (cells.repeat as i64 / window.hop as i64).max(1)
    }

    /// Windows from one that is computed in whole to the next one.
    fn renewal(&self) -> i64 {
        (RENEWAL as i64 / self.rules.window.hop as i64).max(2 * self.turns())
    }

    /// The window with which a run must begin to give frame `number` as if it had begun with the first one.
    fn window_before(&self, number: usize) -> i64 {
        let (start, hop) = (self.recording.info.schedule_start, self.rules.window.hop as i64);
        let k = (start + number as i64).div_euclid(hop);
        match self.rules.skip {
            Skip::Bounded(_) => (k - k.rem_euclid(self.renewal())).max(start.div_euclid(hop)),
            _ => k,
        }
    }

    /// What a report says of skipping, before anything is.
    pub fn skipped(&self) -> Option<Skipped> {
        let allowed_error = match self.rules.skip {
            Skip::Off => return None,
            Skip::Exact => 0.0,
            Skip::Bounded(allowed) => allowed,
        };
        let cells = self.rules.cells;
        let [_, rows, cols] = cells.extent();
        Some(Skipped {
            noise: match (self.rules.skip, &self.stated) {
                (Skip::Bounded(_), Some(_)) => "stated",
                (Skip::Bounded(_), None) => "estimated",
                _ => "none",
            },
            allowed_error,
            cell: [cells.size[1], cells.size[2]],
            computed: vec![0; rows * cols],
            grid: [rows, cols],
            ..Skipped::default()
        })
    }

    /// Decides about window `k`, of whose frames those at schedule times `recorded` were recorded.
    pub fn choose(&mut self, k: i64, seen: &Seen<'_>, recorded: &Range<i64>) -> Choice {
        let first = k < self.from + self.turns();
        let Rules { skip, cells, spread, .. } = self.rules;
        match skip {
            Skip::Off => Choice { active: None, audit: None },
            Skip::Exact if first => self.whole(None),
            Skip::Exact => self.part(|gate, s| changed_at_all(seen, cells, gate.around(k, s), spread)),
            Skip::Bounded(allowed) => {
                let renewed = first || k.rem_euclid(self.renewal()) < self.turns();
                let moved_everywhere = std::mem::take(&mut self.moves_everywhere);
                if renewed || !self.reference.knows_noise() {
                    let audit = (!first && self.reference.knows_noise())
                        .then(|| self.changed(k, 0, seen, allowed).iter().map(|changed| !changed).collect());
                    let scatter = self.stated.clone().or_else(|| {
                        let pairs = self.pairs(seen, recorded);
                        Scatter::estimated(&pairs, cells, self.reference.readouts(), self.recording)
                    });
                    self.reference.set_scatter(scatter);
                    self.update_whole(k, seen);
                    return self.whole(audit);
                }
                if moved_everywhere {
                    self.update_whole(k, seen);
                    return self.whole(None);
                }
                let choice = self.part(|gate, s| {
                    let changed = gate.changed(k, s, seen, allowed);
                    gate.reference.update(seen, &gate.slab(k, s), &changed);
                    changed
                });
                self.moves_everywhere = choice.active.as_ref().is_some_and(Active::all);
                choice
            }
        }
    }

    /// All cells of a window.
    fn whole(&self, audit: Option<Vec<bool>>) -> Choice {
        Choice { active: Some(Active::filled(self.rules.cells.extent(), true)), audit }
    }

    /// Of each slab of a window, those cells that have `changed`.
    fn part(&mut self, mut changed: impl FnMut(&mut Self, usize) -> Vec<bool>) -> Choice {
        let cells = self.rules.cells;
        let mut active = Active::filled(cells.extent(), false);
        for s in 0..cells.slabs {
            active.slab_mut(s).copy_from_slice(&changed(self, s));
        }
        Choice { active: Some(active), audit: None }
    }

    /// Takes window `k`, all of which is computed, as the reference: its last slabs, which everything behind is compared
    /// with.
    fn update_whole(&mut self, k: i64, seen: &Seen<'_>) {
        let cells = self.rules.cells;
        let all = vec![true; cells.rows() * cells.cols()];
        let last = cells.repeat / cells.size[0];
        for s in cells.slabs.saturating_sub(last)..cells.slabs {
            self.reference.update(seen, &self.slab(k, s), &all);
        }
    }

    /// Pairs of frames at the same phase of the pattern, of which both were recorded, with the later one's time.
    fn pairs(&self, seen: &Seen<'_>, recorded: &Range<i64>) -> Vec<(Arc<Frame>, Arc<Frame>, i64)> {
        let before = |t: i64| t - self.rules.cells.repeat as i64;
        recorded
            .clone()
            .filter(|&t| before(t) >= self.recording.info.schedule_start)
            .map(|t| (Arc::clone(seen.frame(before(t))), Arc::clone(seen.frame(t)), t))
            .collect()
    }

    /// Cells of slab `s` of window `k` that have changed since they were last computed.
    fn changed(&self, k: i64, s: usize, seen: &Seen<'_>, allowed: f64) -> Vec<bool> {
        let Rules { cells, spread, .. } = self.rules;
        let allowed = (allowed * INPUT_SHARE) as f32;
        let changed = self.reference.changed(seen, &self.slab(k, s), &self.around(k, s), allowed);
        cells.dilate(&changed, spread)
    }

    /// Schedule times of slab `s` of window `k`.
    fn slab(&self, k: i64, s: usize) -> Range<i64> {
        let Rules { cells, window, .. } = self.rules;
        let len = cells.size[0] as i64;
        let begin = k * window.hop as i64 + s as i64 * len;
        begin..begin + len
    }

    /// Schedule times that the results of slab `s` of window `k` depend on.
    fn around(&self, k: i64, s: usize) -> Range<i64> {
        let Window { frames, lead, hop } = self.rules.window;
        let slab = self.slab(k, s);
        let ahead = frames - lead - hop;
        let ahead = if matches!(self.rules.skip, Skip::Bounded(_)) { ahead.min(self.noticed) } else { ahead };
        slab.start - lead as i64..slab.end + ahead as i64
    }
}

/// Cells whose frames `times` differ from those [`Cells::repeat`] frames before, anywhere in the
/// frames and within `spread` cells [rows, columns].
fn changed_at_all(seen: &Seen<'_>, cells: &Cells, times: Range<i64>, spread: [usize; 2]) -> Vec<bool> {
    let mut changed = vec![false; cells.rows() * cells.cols()];
    changed.par_chunks_mut(cells.cols()).enumerate().for_each(|(r, changed)| {
        let rows = r * cells.size[1]..((r + 1) * cells.size[1]).min(cells.height);
        for t in times.clone() {
            let [now, before] = [seen.at(t), seen.at(t - cells.repeat as i64)];
            for y in rows.clone() {
                let [now, before] =
                    [now, before].map(|frame| frame[y * cells.width..][..cells.width].chunks(cells.size[2]));
                for (changed, (now, before)) in changed.iter_mut().zip(now.zip(before)) {
                    *changed |= now != before;
                }
            }
        }
    });
    cells.dilate(&changed, spread)
}

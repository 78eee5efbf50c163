//! Which cells have to be computed, and which may keep their last result.
//!
//! A cell is a block of a few frames, rows and columns; a slab is all cells of the same frames. The gate looks at raw
//! pixel values alone, in all that a cell's result depends on: its surroundings, and the frames before and behind.
//!
//! **Exact.** A cell keeps the result of the slab before (at the same phase of the pattern) if everything that it
//! depends on is bit-identical there. Then its result would be, too.
//!
//! **Bounded.** A cell keeps its last result if what it depends on differs from what that was computed from by no more
//! than noise explains or the user allows ([`super::memory`]). Every [`RENEWAL`] frames everything is computed anew,
//! so that a run can begin there as well as at the first frame; how far results had moved away is reported. Behind a
//! window in which everything had to be computed, the next one is, too, without a question.

use std::ops::Range;

use rayon::prelude::*;

use super::Skip;
use super::cover::Active;
use super::footage::{Frame, Seen};
use super::memory::Memory;
use super::noise::Scatter;
use super::report::Skipped;
use crate::network::Window;
use crate::sensor::{Calibration, Recording};

/// Part of the allowed error that the pixel values may change by; the rest is for what nets make more of it.
const INPUT_SHARE: f64 = 0.75;

/// Frames after which a run with bounded skipping computes everything again, however little changes.
const RENEWAL: usize = 2048;

/// The grid of cells of one window.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cells {
    /// Frames, rows and columns of a cell.
    pub size: [usize; 3],
    /// Slabs of a window.
    pub slabs: usize,
    /// Rows of pixels, padded to the grid.
    pub height: usize,
    /// Columns of pixels, padded to the grid.
    pub width: usize,
    /// Frames after which pattern and slabs repeat together: a result can only be kept from that many frames before.
    pub repeat: usize,
}

impl Cells {
    /// Rows of cells.
    pub fn rows(&self) -> usize {
        self.height.div_ceil(self.size[1])
    }

    /// Columns of cells.
    pub fn cols(&self) -> usize {
        self.width.div_ceil(self.size[2])
    }

    /// Slabs, rows, columns.
    pub fn extent(&self) -> [usize; 3] {
        [self.slabs, self.rows(), self.cols()]
    }

    /// Marks all cells of a slab within `spread` [rows, columns] of a marked one.
    pub(super) fn dilate(&self, marked: &[bool], spread: [usize; 2]) -> Vec<bool> {
        let (rows, cols) = (self.rows(), self.cols());
        let mut wide = vec![false; marked.len()];
        for (i, _) in marked.iter().enumerate().filter(|(_, marked)| **marked) {
            let (r, c) = (i / cols, i % cols);
            let columns = c.saturating_sub(spread[1])..(c + spread[1] + 1).min(cols);
            for r in r.saturating_sub(spread[0])..(r + spread[0] + 1).min(rows) {
                wide[r * cols + columns.start..r * cols + columns.end].fill(true);
            }
        }
        wide
    }

    /// Frames of a window's results.
    pub fn hop(&self) -> usize {
        self.slabs * self.size[0]
    }
}

/// Decides what of each window to compute.
pub struct Gate<'a> {
    cells: &'a Cells,
    skip: Skip,
    window: Window,
    /// Cells [rows, columns] around a changed one that are computed with it.
    spread: [usize; 2],
    /// Noise as the capture states it.
    stated: Option<Scatter>,
    /// Frames ahead that results depend on noticeably: those whose measurements they are made of, not those that only
    /// tell which to believe. All frames behind count: a result that is kept for long must not remember what has passed.
    noticed: usize,
    memory: Memory<'a>,
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
        (cells, skip, window): (&'a Cells, Skip, Window),
        spread: [usize; 2],
        (recording, calibration): (&'a Recording, &'a Calibration),
        number: usize,
    ) -> Self {
        let memory = Memory::new(cells, calibration, recording, matches!(skip, Skip::Bounded(_)));
        let stated = Scatter::stated(recording);
        let noticed = calibration.period;
        let mut gate = Self {
            cells,
            skip,
            window,
            spread,
            stated,
            noticed,
            memory,
            recording,
            from: 0,
            moves_everywhere: false,
        };
        gate.from = gate.window_before(number);
        gate
    }

    /// The window with which the run has to begin.
    pub fn from(&self) -> i64 {
        self.from
    }

    /// Frames before those of a window that the gate compares with.
    pub fn before(&self) -> i64 {
        if self.skip == Skip::Off { 0 } else { self.cells.repeat as i64 }
    }

    /// Windows until every slab of the pattern's schedule has had its turn.
    fn turns(&self) -> i64 {
        (self.cells.repeat as i64 / self.window.hop as i64).max(1)
    }

    /// Windows from one that is computed in whole to the next one.
    fn renewal(&self) -> i64 {
        (RENEWAL as i64 / self.window.hop as i64).max(2 * self.turns())
    }

    /// The window with which a run must begin to give frame `number` as if it had begun with the first one.
    fn window_before(&self, number: usize) -> i64 {
        let (start, hop) = (self.recording.info.schedule_start, self.window.hop as i64);
        let k = (start + number as i64).div_euclid(hop);
        match self.skip {
            Skip::Bounded(_) => (k - k.rem_euclid(self.renewal())).max(start.div_euclid(hop)),
            _ => k,
        }
    }

    /// What a report says of skipping, before anything is.
    pub fn skipped(&self) -> Option<Skipped> {
        let allowed_error = match self.skip {
            Skip::Off => return None,
            Skip::Exact => 0.0,
            Skip::Bounded(allowed) => allowed,
        };
        let [_, rows, cols] = self.cells.extent();
        Some(Skipped {
            noise: match (self.skip, &self.stated) {
                (Skip::Bounded(_), Some(_)) => "stated",
                (Skip::Bounded(_), None) => "estimated",
                _ => "none",
            },
            allowed_error,
            cell: [self.cells.size[1], self.cells.size[2]],
            computed: vec![0; rows * cols],
            grid: [rows, cols],
            ..Skipped::default()
        })
    }

    /// Decides about window `k`, of whose frames those at schedule times `recorded` were recorded.
    pub fn choose(&mut self, k: i64, seen: &Seen<'_>, recorded: &Range<i64>) -> Choice {
        let first = k < self.from + self.turns();
        let whole = || Some(Active::filled(self.cells.extent(), true));
        match self.skip {
            Skip::Off => Choice { active: None, audit: None },
            Skip::Exact if first => Choice { active: whole(), audit: None },
            Skip::Exact => {
                let mut active = Active::filled(self.cells.extent(), false);
                for s in 0..self.cells.slabs {
                    let changed = changed_at_all(seen, self.cells, self.around(k, s), self.spread);
                    active.slab_mut(s).copy_from_slice(&changed);
                }
                Choice { active: Some(active), audit: None }
            }
            Skip::Bounded(allowed) => {
                let renewed = first || k.rem_euclid(self.renewal()) < self.turns();
                let moved_everywhere = std::mem::take(&mut self.moves_everywhere);
                if !renewed && self.memory.knows_noise() {
                    if moved_everywhere {
                        self.remember_whole(k, seen);
                        return Choice { active: whole(), audit: None };
                    }
                    let mut active = Active::filled(self.cells.extent(), false);
                    for s in 0..self.cells.slabs {
                        let changed = self.changed(k, s, seen, allowed);
                        self.memory.remember(seen, &self.slab(k, s), &changed);
                        active.slab_mut(s).copy_from_slice(&changed);
                    }
                    self.moves_everywhere = active.count() == active.cells.len();
                    return Choice { active: Some(active), audit: None };
                }
                let audit = (!first && self.memory.knows_noise())
                    .then(|| self.changed(k, 0, seen, allowed).iter().map(|changed| !changed).collect());
                let scatter = self.stated.clone().or_else(|| {
                    let pairs = self.pairs(seen, recorded);
                    Scatter::estimated(&pairs, self.cells, self.memory.readouts(), self.recording)
                });
                self.memory.set_scatter(scatter);
                self.remember_whole(k, seen);
                Choice { active: whole(), audit }
            }
        }
    }

    /// Remembers window `k`, all of which is computed: its last slabs, which everything behind is compared with.
    fn remember_whole(&mut self, k: i64, seen: &Seen<'_>) {
        let all = vec![true; self.cells.rows() * self.cells.cols()];
        let last = self.cells.repeat / self.cells.size[0];
        for s in self.cells.slabs.saturating_sub(last)..self.cells.slabs {
            self.memory.remember(seen, &self.slab(k, s), &all);
        }
    }

    /// Pairs of frames at the same phase of the pattern, of which both were recorded, with the later one's time.
    fn pairs(&self, seen: &Seen<'_>, recorded: &Range<i64>) -> Vec<(Frame, Frame, i64)> {
        let before = |t: i64| t - self.cells.repeat as i64;
        recorded
            .clone()
            .filter(|&t| before(t) >= self.recording.info.schedule_start)
            .map(|t| (Frame::clone(seen.at(before(t))), Frame::clone(seen.at(t)), t))
            .collect()
    }

    /// Cells of slab `s` of window `k` that have changed since they were last computed.
    fn changed(&self, k: i64, s: usize, seen: &Seen<'_>, allowed: f64) -> Vec<bool> {
        let allowed = (allowed * INPUT_SHARE) as f32;
        let changed = self.memory.changed(seen, &self.slab(k, s), &self.around(k, s), allowed);
        self.cells.dilate(&changed, self.spread)
    }

    /// Schedule times of slab `s` of window `k`.
    fn slab(&self, k: i64, s: usize) -> Range<i64> {
        let len = self.cells.size[0] as i64;
        let begin = k * self.window.hop as i64 + s as i64 * len;
        begin..begin + len
    }

    /// Schedule times that the results of slab `s` of window `k` depend on.
    fn around(&self, k: i64, s: usize) -> Range<i64> {
        let Window { frames, lead, hop } = self.window;
        let slab = self.slab(k, s);
        let ahead = frames - lead - hop;
        let ahead = if matches!(self.skip, Skip::Bounded(_)) { ahead.min(self.noticed) } else { ahead };
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

//! What a run did.

use std::time::Duration;

use super::cover::Active;

/// What a run did.
#[derive(Clone, Debug)]
pub struct Report {
    /// Result frames that were delivered.
    pub frames: usize,
    /// Windows.
    pub windows: usize,
    /// Tiles per window, where all of it is computed.
    pub tiles: usize,
    /// Time from one finished window to the next, everything included, for each result frame of it that was delivered.
    pub frame_times: Vec<Duration>,
    /// The executor, in words.
    pub executor: String,
    /// Operations of the convolutions per result frame, where all of it is computed.
    pub flop_per_frame: f64,
    /// Time of the whole run, from the first frame read to the last one delivered.
    pub wall: Duration,
    /// Part of it in which the executors computed or were waited for.
    pub inference: Duration,
    /// Part of it in which the gate chose what to compute.
    pub gating: Duration,
    /// What was left out, if that was allowed.
    pub skipping: Option<Skipped>,
}

/// What was left out.
#[derive(Clone, Debug, Default)]
pub struct Skipped {
    /// Cells of all windows.
    pub cells: u64,
    /// Those that were computed.
    pub active: u64,
    /// Operations that were done, halos and overlaps included, as a part of those without skipping.
    pub work: f64,
    /// Windows computed in whole, to begin with and to start anew.
    pub whole_windows: usize,
    /// Where the noise comes from: `stated` by the capture, `estimated`, or `none` if it was not needed.
    pub noise: &'static str,
    /// Largest change of l that a kept result may hide, and that noise does not.
    pub allowed_error: f64,
    /// Error of kept results, checked wherever a window was computed in whole though parts of it could have been kept.
    pub audit: Audit,
    /// Rows and columns of a cell, in pixels.
    pub cell: [usize; 2],
    /// How often each cell was computed, row by row.
    pub computed: Vec<u32>,
    /// Rows and columns of cells.
    pub grid: [usize; 2],
    /// Slabs, the most that a cell can have been computed.
    pub slabs: usize,
}

/// Differences of l between kept results and the ones computed anew.
#[derive(Clone, Copy, Debug, Default)]
pub struct Audit {
    /// Cells that were compared.
    pub cells: u64,
    /// Sum of squares of each cell's mean difference.
    pub squares: f64,
    /// Largest mean difference of a cell.
    pub largest: f64,
}

impl Audit {
    /// Adds the mean difference of a cell.
    pub(super) fn add(&mut self, difference: f64) {
        self.cells += 1;
        self.squares += difference * difference;
        self.largest = self.largest.max(difference.abs());
    }

    /// Root mean square of the cells' mean differences; `None` where nothing was compared.
    pub fn rms(&self) -> Option<f64> {
        (self.cells > 0).then(|| (self.squares / self.cells as f64).sqrt())
    }
}

impl Skipped {
    /// Counts a window of which the cells that are `active` were computed, with a part of the operations of a whole one.
    pub(super) fn add(&mut self, active: &Active, work: f64) {
        self.cells += active.cells.len() as u64;
        self.active += active.count() as u64;
        self.work += work;
        self.whole_windows += usize::from(active.count() == active.cells.len());
        for s in 0..active.extent[0] {
            self.slabs += 1;
            for (computed, active) in self.computed.iter_mut().zip(active.slab(s)) {
                *computed += u32::from(*active);
            }
        }
    }

    /// Part of all cells that was computed.
    pub fn active_fraction(&self) -> f64 {
        self.active as f64 / self.cells.max(1) as f64
    }
}

impl Report {
    /// Median time per result frame in milliseconds.
    pub fn ms_per_frame(&self) -> f64 {
        self.quantile_ms(0.5)
    }

    /// A quantile over windows of the time per result frame, in milliseconds.
    pub fn quantile_ms(&self, quantile: f64) -> f64 {
        let mut times = self.frame_times.clone();
        times.sort_unstable();
        let index = ((times.len() as f64 * quantile) as usize).min(times.len().saturating_sub(1));
        times.get(index).map_or(0.0, |time| 1e3 * time.as_secs_f64())
    }

    /// Mean time per result frame in milliseconds, from the first frame read to the last one delivered.
    pub fn mean_ms(&self) -> f64 {
        1e3 * self.wall.as_secs_f64() / self.frames.max(1) as f64
    }
}

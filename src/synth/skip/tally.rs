//! What a run left out, and what that changed.

use super::cells::Active;

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
    pub fn add(&mut self, active: &Active, work: f64) {
        self.cells += active.total() as u64;
        self.active += active.count() as u64;
        self.work += work;
        self.whole_windows += usize::from(active.all());
        for s in 0..active.extent()[0] {
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

//! Cells, the units that are skipped or computed: blocks of a few frames, rows and columns.

use crate::math::lcm;
use crate::sensor::Calibration;

/// Least frames of a cell, and least rows and columns.
const FRAMES: usize = 8;
const SIDE: usize = 4;

/// Frames of a cell, of a net and a pattern that repeat together every `repeat` frames.
pub fn cell_frames(repeat: usize) -> usize {
    repeat * FRAMES.div_ceil(repeat)
}

/// The grid of cells of one window. The cells of the same frames are a *slab*.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cells {
    /// Frames, rows and columns of a cell.
    pub(super) size: [usize; 3],
    /// Slabs of a window.
    pub(super) slabs: usize,
    /// Rows of pixels, padded to the grid of tiles.
    pub(super) height: usize,
    /// Columns of pixels, padded to the grid of tiles.
    pub(super) width: usize,
    /// Frames after which pattern and slabs repeat together: a result can only be kept from that many frames before.
    pub(super) repeat: usize,
}

impl Cells {
    /// Cells of `frames` frames in windows that give `hop` ≥ `frames`, of frames padded to `[height, width]` pixels.
    pub fn new(frames: usize, hop: usize, [height, width]: [usize; 2], calibration: &Calibration) -> Self {
        // Cells begin where the pattern's tile does.
        let side = |tile: usize| tile * SIDE.div_ceil(tile);
        Self {
            size: [frames, side(calibration.rows), side(calibration.cols)],
            slabs: hop / frames,
            height,
            width,
            repeat: lcm(frames, calibration.period),
        }
    }

    /// Frames, rows and columns of a cell.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

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

    /// Frames of a window's results.
    pub fn hop(&self) -> usize {
        self.slabs * self.size[0]
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
}

/// Which cells of a window are active, that is, computed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Active {
    /// Slabs, rows, columns.
    extent: [usize; 3],
    /// One flag a cell, the columns of a row side by side.
    cells: Vec<bool>,
}

impl Active {
    /// Of slabs, rows and columns, those cells for whose number, [slabs, rows, columns] in order, `active` says so.
    pub fn new(extent: [usize; 3], active: impl FnMut(usize) -> bool) -> Self {
        Self { extent, cells: (0..extent.iter().product()).map(active).collect() }
    }

    /// All cells alike.
    pub fn filled(extent: [usize; 3], active: bool) -> Self {
        Self::new(extent, |_| active)
    }

    /// Slabs, rows, columns.
    pub fn extent(&self) -> [usize; 3] {
        self.extent
    }

    /// Number of cells in a slab.
    fn slab_len(&self) -> usize {
        self.extent[1] * self.extent[2]
    }

    /// The cells of slab `s`, row by row.
    pub fn slab(&self, s: usize) -> &[bool] {
        &self.cells[s * self.slab_len()..][..self.slab_len()]
    }

    /// The cells of slab `s`, to be changed.
    pub(super) fn slab_mut(&mut self, s: usize) -> &mut [bool] {
        let len = self.slab_len();
        &mut self.cells[s * len..][..len]
    }

    /// Takes the cells of slab `s` and those behind it out.
    pub fn clear_from(&mut self, s: usize) {
        let first = (s * self.slab_len()).min(self.cells.len());
        self.cells[first..].fill(false);
    }

    /// Number of cells.
    pub(super) fn total(&self) -> usize {
        self.cells.len()
    }

    /// Number of active cells.
    pub fn count(&self) -> usize {
        self.cells.iter().filter(|&&active| active).count()
    }

    /// Whether every cell is active.
    pub fn all(&self) -> bool {
        self.cells.iter().all(|&active| active)
    }
}

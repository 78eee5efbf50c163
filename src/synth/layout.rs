//! From cuboids of cells to tiles, and what they cost.

use std::ops::Range;

use super::pool::{WindowExtent, with_hop};
use super::skip::{Cells, Cuboid};
use super::tiles::{Cut, Grid, Stretch};
use crate::Result;
use crate::network::{Model, NetworkError, Plan};

/// What a tile costs by itself, in pixels of one frame.
const TILE_COST: f64 = 2000.0;

/// A part of a window that is computed at once: result frames and pixels.
#[derive(Clone, Debug)]
pub struct Tile {
    /// Result frames, counted within the window.
    pub frames: Range<usize>,
    /// Rows.
    pub row: Stretch,
    /// Columns.
    pub col: Stretch,
}

impl Tile {
    /// Size of the window that the tile needs.
    pub fn size(&self) -> WindowExtent {
        [self.frames.len(), self.row.outer_len, self.col.outer_len]
    }
}

/// How windows become tiles.
#[derive(Debug)]
pub struct Layout {
    cut: Cut,
    grid: Grid,
    /// Result frames of a whole window.
    hop: usize,
    /// Frames, rows and columns of a cell.
    cell: [usize; 3],
    /// Most rows and columns of cells of one tile.
    most: [usize; 2],
    /// Frames that a window computes besides those that it gives, on an average of the layers.
    overlap: f64,
}

impl Layout {
    /// For windows of `model`, whole ones cut by `grid` and others by `cut`.
    pub fn new(model: &Model, cut: Cut, cells: &Cells, grid: &Grid) -> Result<Self> {
        let cell = cells.size();
        // No tile is larger than the grid's, which fit into memory.
        let most = [0, 1].map(|axis| {
            let (longest, whole) = (grid.tile_extent()[axis], grid.extent()[axis]);
            let kept = longest.saturating_sub(2 * cut.halo()[axis]);
            // A fifth is left for what aligning a tile to the net's granularity adds.
            if longest == whole { usize::MAX } else { (kept * 4 / 5 / cell[axis + 1]).max(1) }
        });
        Ok(Self { overlap: overlap(model, cells)?, cut, hop: cells.hop(), cell, grid: grid.clone(), most })
    }

    /// The tiles that compute the first `frames` of a window in whole.
    pub fn whole(&self, frames: usize) -> Vec<Tile> {
        self.grid.tiles().map(|(row, col)| Tile { frames: 0..frames, row, col }).collect()
    }

    /// The tiles that compute a cuboid of cells.
    pub fn tiles(&self, cuboid: &Cuboid) -> Vec<Tile> {
        let frames = cuboid[0].start * self.cell[0]..cuboid[0].end * self.cell[0];
        let mut tiles = Vec::new();
        for row in self.pieces(0, &cuboid[1]) {
            for col in self.pieces(1, &cuboid[2]) {
                tiles.push(Tile { frames: frames.clone(), row, col });
            }
        }
        tiles
    }

    /// Cuts cells along an axis into as few stretches of about equal length as the longest tile allows.
    fn pieces(&self, axis: usize, cells: &Range<usize>) -> impl Iterator<Item = Stretch> {
        let len = self.grid.extent()[axis];
        let count = cells.len().div_ceil(self.most[axis]);
        let (begin, cells, cell) = (cells.start, cells.len(), self.cell[axis + 1]);
        let pixel = move |piece: usize| ((begin + cells * piece / count) * cell).min(len);
        (0..count).map(move |piece| self.cut.place(axis, pixel(piece)..pixel(piece + 1), len))
    }

    /// What computing a cuboid of cells costs: pixels of a frame, for as many frames as the average layer computes.
    pub fn cost(&self, cuboid: &Cuboid) -> f64 {
        let [rows, cols] = [0, 1].map(|axis| {
            let lengths = self.pieces(axis, &cuboid[axis + 1]).map(|stretch| stretch.outer_len);
            lengths.fold((0, 0), |(count, sum), len| (count + 1, sum + len))
        });
        let frames = (cuboid[0].len() * self.cell[0]) as f64 + self.overlap;
        frames * (rows.1 * cols.1) as f64 + TILE_COST * f64::from(rows.0 * cols.0)
    }

    /// What tiles cost, compared with those of a whole window.
    pub fn work(&self, tiles: &[Tile]) -> f64 {
        let cost = |tile: &Tile| {
            let [frames, rows, cols] = tile.size();
            (frames as f64 + self.overlap) * (rows * cols) as f64
        };
        tiles.iter().map(cost).sum::<f64>() / self.whole(self.hop).iter().map(cost).sum::<f64>()
    }
}

/// Frames that a window computes besides those that it gives: operations grow with the number of result frames as
/// α·(hop + overlap).
fn overlap(model: &Model, cells: &Cells) -> Result<f64, NetworkError> {
    if cells.extent()[0] == 1 {
        return Ok(0.0);
    }
    let [_, y, x] = model.graph.granularity()?;
    let flop = |hop: usize| Ok::<_, NetworkError>(Plan::lower(&with_hop(model, hop), y, x)?.flop());
    let [frames, ..] = cells.size();
    let (one, two) = (flop(frames)?, flop(2 * frames)?);
    Ok(if two > one { frames as f64 * (2.0 * one - two) / (two - one) } else { 0.0 })
}

//! How a frame is cut into tiles that give the same result as the whole.

use std::ops::Range;

use crate::Result;
use crate::network::{Footprint, Graph, Model, NetworkError, Plan};
use crate::sensor::{Calibration, Symmetry};

/// A stretch of rows or columns: what is computed, and what of it is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stretch {
    /// First row that is kept.
    pub start: usize,
    /// Rows that are kept.
    pub len: usize,
    /// First row that is computed, ≤ `start`.
    pub outer_start: usize,
    /// Rows that are computed.
    pub outer_len: usize,
}

/// The tiles of a frame, all of which compute equally many rows and columns: all pairs of `rows` and `cols`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Stretches of rows, which together keep the padded height once.
    rows: Vec<Stretch>,
    /// Stretches of columns.
    cols: Vec<Stretch>,
    /// Rows and columns, padded to the granularity.
    extent: [usize; 2],
}

/// What limits the size of a tile.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Bytes of the largest single buffer.
    pub buffer: u64,
    /// Bytes of all buffers together.
    pub total: u64,
    /// Bytes that a few steps may leave for each other, if they are to be computed piece by piece.
    pub piece: Option<usize>,
    /// Longest side of a tile's kept part, in pixels, if the user limits it.
    pub side: Option<usize>,
}

impl Limits {
    /// The plan for windows of `model` of so many rows and columns, which mostly follow each other if it is for `streams`.
    pub fn plan(
        &self,
        model: &Model,
        [height, width]: [usize; 2],
        streams: bool,
    ) -> Result<Plan, NetworkError> {
        let bytes = self.piece.unwrap_or(usize::MAX);
        if streams {
            Plan::streaming(model, height, width, bytes)
        } else {
            Plan::in_pieces(model, height, width, bytes)
        }
    }

    /// What memory that plan takes.
    pub fn footprint(
        &self,
        model: &Model,
        [height, width]: [usize; 2],
        streams: bool,
    ) -> Result<Footprint, NetworkError> {
        Plan::footprint(model, height, width, self.piece.unwrap_or(usize::MAX), streams)
    }

    /// Whether windows compute only what is new: if those of each tile of `grid`, in each of `poses` that does not run
    /// backwards, can have a state.
    pub fn stream(&self, model: &Model, grid: &Grid, poses: &[Symmetry]) -> Result<bool, NetworkError> {
        let sequences = grid.count() * poses.iter().filter(|pose| !pose.backwards[0]).count();
        let Footprint { slots, state } = self.footprint(model, grid.tile_extent(), true)?;
        let values = state.map(|state| slots.iter().sum::<usize>() + sequences * state);
        Ok(values.is_some_and(|values| 4 * values as u64 <= self.total))
    }
}

impl Grid {
    /// The coarsest grid whose tiles stay within `limits`.
    pub fn fit(
        model: &Model,
        calibration: &Calibration,
        [height, width]: [usize; 2],
        limits: Limits,
    ) -> Result<Self> {
        let cut = Cut::exact(&model.graph, calibration)?;
        let [height, width] = [height.next_multiple_of(cut.unit[0]), width.next_multiple_of(cut.unit[1])];
        let side = limits.side.unwrap_or(usize::MAX);
        let mut parts = [height.div_ceil(side.max(cut.unit[0])), width.div_ceil(side.max(cut.unit[1]))];
        loop {
            let [rows, cols] = [cut.stretches(0, height, parts[0]), cut.stretches(1, width, parts[1])];
            let grid = Self { rows, cols, extent: [height, width] };
            let Footprint { slots, state } = limits.footprint(model, grid.tile_extent(), parts == [1, 1])?;
            let largest = 4 * slots.iter().max().copied().unwrap_or(0) as u64;
            let total = 4 * (slots.iter().sum::<usize>() + state.unwrap_or(0)) as u64;
            if largest <= limits.buffer && total <= limits.total {
                return Ok(grid);
            }
            // Cut the longer side once more, unless it is cut as finely as it can be.
            let finest = [height / cut.unit[0], width / cut.unit[1]];
            let [rows, cols] = grid.tile_extent();
            let axis = usize::from(cols > rows);
            let axis = if parts[axis] < finest[axis] { axis } else { 1 - axis };
            if parts[axis] >= finest[axis] {
                return Err(NetworkError::Graph(
                    model.graph.name.clone(),
                    format!(
                        "even its smallest tile needs {total} bytes, {largest} of them in one buffer; there are {}, and {} \
                         for a buffer: take a smaller net or another executor",
                        limits.total, limits.buffer
                    ),
                )
                .into());
            }
            parts[axis] += 1;
        }
    }

    /// Rows and columns of a frame, padded to the granularity.
    pub fn extent(&self) -> [usize; 2] {
        self.extent
    }

    /// Rows and columns that each tile computes.
    pub fn tile_extent(&self) -> [usize; 2] {
        [&self.rows, &self.cols].map(|stretches| stretches[0].outer_len)
    }

    /// Number of tiles.
    pub fn count(&self) -> usize {
        self.rows.len() * self.cols.len()
    }

    /// The tiles, row by row.
    pub fn tiles(&self) -> impl Iterator<Item = (Stretch, Stretch)> + '_ {
        self.rows.iter().flat_map(|&row| self.cols.iter().map(move |&col| (row, col)))
    }
}

/// Where a frame may be cut, and how much a tile must see beyond what it keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Tiles begin at multiples of this: granularity of the net and pattern tile.
    unit: [usize; 2],
    /// Pixels that a result depends on to each side.
    halo: [usize; 2],
}

impl Cut {
    /// With all that results depend on, so that they are those of the whole frame to the bit.
    pub fn exact(graph: &Graph, calibration: &Calibration) -> Result<Self> {
        let [_, gy, gx] = graph.granularity()?;
        let unit = [crate::math::lcm(gy, calibration.rows), crate::math::lcm(gx, calibration.cols)];
        let [_, ry, rx] = graph.reach()?;
        let halo = [ry.next_multiple_of(unit[0]), rx.next_multiple_of(unit[1])];
        Ok(Self { unit, halo })
    }

    /// Rows and columns that tiles begin at multiples of.
    pub fn unit(&self) -> [usize; 2] {
        self.unit
    }

    /// With what results depend on noticeably, which was measured (docs/skipping.md). Through layer after layer,
    /// influence spreads like a random walk, with the root of their number, while the reach grows with the number.
    #[must_use]
    pub fn bounded(&self) -> Self {
        let halo = |i: usize| {
            let root = ((self.unit[i] * self.halo[i]) as f64).sqrt();
            ((root / 4.0).ceil() as usize).min(self.halo[i])
        };
        Self { unit: self.unit, halo: [halo(0), halo(1)] }
    }

    /// Rows and columns that a result depends on to each side.
    pub fn halo(&self) -> [usize; 2] {
        self.halo
    }

    /// The stretch that keeps pixels `kept` along `axis` of a frame of `len` pixels.
    pub fn place(&self, axis: usize, kept: Range<usize>, len: usize) -> Stretch {
        let (halo, unit) = (self.halo[axis], self.unit[axis]);
        let first = kept.start.saturating_sub(halo) / unit * unit;
        let end = (kept.end + halo).next_multiple_of(unit).min(len);
        Stretch { start: kept.start, len: kept.len(), outer_start: first, outer_len: end - first }
    }

    /// Cuts `len` into `parts` of nearly equal length. All compute the same length, so that one executor does for all.
    fn stretches(&self, axis: usize, len: usize, parts: usize) -> Vec<Stretch> {
        let (unit, halo) = (self.unit[axis], self.halo[axis]);
        let units = len / unit;
        let cut = |part: usize| units * part / parts.max(1) * unit;
        let mut stretches: Vec<Stretch> = (0..parts.max(1))
            .map(|part| {
                let (start, end) = (cut(part), cut(part + 1));
                let outer_start = start.saturating_sub(halo);
                let outer_len = (end + halo).min(len) - outer_start;
                Stretch { start, len: end - start, outer_start, outer_len }
            })
            .filter(|stretch| stretch.len > 0)
            .collect();
        let longest = stretches.iter().map(|stretch| stretch.outer_len).max().unwrap_or(0);
        for stretch in &mut stretches {
            stretch.outer_len = longest;
            stretch.outer_start = stretch.outer_start.min(len - longest);
        }
        stretches
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::presets;
    use crate::sensor::{Form, Pattern, Response};

    #[test]
    fn tiles_and_poses_stream_if_memory_allows() {
        let model = Model::random(presets::by_name("tiny").unwrap().graph().unwrap(), 0).unwrap();
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let response = Response::new(Form::Linear, pattern.shortest_exposure() as f64).unwrap();
        let calibration = Calibration::new(&pattern, &response);
        let limits = |total| Limits { buffer: u64::MAX, total, piece: Some(2 << 20), side: Some(64) };
        let grid = Grid::fit(&model, &calibration, [128, 128], limits(u64::MAX)).unwrap();
        assert_eq!(grid.count(), 4);
        let Footprint { slots, state } =
            limits(u64::MAX).footprint(&model, grid.tile_extent(), true).unwrap();
        let poses: Vec<Symmetry> =
            calibration.symmetries.iter().filter(|pose| !pose.backwards[0]).copied().collect();
        for count in [1, poses.len()] {
            let values = slots.iter().sum::<usize>() + 4 * count * state.unwrap();
            let streams = |bytes| limits(bytes).stream(&model, &grid, &poses[..count]).unwrap();
            assert!(streams(4 * values as u64) && !streams(4 * values as u64 - 1));
        }
        // What runs backwards needs no state.
        let all = calibration.symmetries.as_slice();
        let values = slots.iter().sum::<usize>() + 4 * poses.len() * state.unwrap();
        assert!(all.len() > poses.len() && limits(4 * values as u64).stream(&model, &grid, all).unwrap());
    }

    #[test]
    fn a_placed_stretch_sees_all_that_it_needs() {
        let cut = Cut { unit: [2, 4], halo: [14, 28] };
        for axis in 0..2 {
            let (unit, len) = (cut.unit[axis], 240);
            for start in (0..len).step_by(8) {
                for end in (start + 8..=len).step_by(8) {
                    let Stretch { start, len: kept, outer_start, outer_len } =
                        cut.place(axis, start..end, len);
                    assert_eq!((start, kept), (start, end - start));
                    assert!(outer_start.is_multiple_of(unit) && outer_len.is_multiple_of(unit));
                    assert!(outer_start + outer_len <= len);
                    assert!(outer_start == 0 || outer_start + cut.halo[axis] <= start);
                    assert!(
                        outer_start + outer_len == len || outer_start + outer_len >= end + cut.halo[axis]
                    );
                }
            }
        }
    }
}

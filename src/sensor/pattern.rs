//! Sampling patterns: which pixel integrates when (design §3).

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::SensorError;
use crate::math::lcm;
use crate::{At, Result};

/// Longest period of a pattern, in frames: the tables of the kernels have one entry a frame.
const MAX_PERIOD: usize = 256;
/// Largest tile, in pixels.
const MAX_TILE: usize = 4096;

/// A tile of cells that repeats over the sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Pattern {
    /// Name, `custom` for an unnamed one.
    pub name: String,
    /// Rows of the tile.
    pub rows: usize,
    /// Columns of the tile.
    pub cols: usize,
    /// The cells, row by row.
    pub cells: Vec<Cell>,
}

/// When one pixel integrates: shutters that repeat every `period` frames and cover all of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// Frames after which the shutters repeat.
    pub period: usize,
    /// Shutters in order of their start; together they cover the period once.
    pub shutters: Vec<Shutter>,
}

/// One exposure: the frames that a read-out covers, and those of them in which light is collected.
#[derive(Clone, Debug, PartialEq)]
pub struct Shutter {
    /// Schedule time of the first frame, in [0, period).
    pub start: usize,
    /// Frames covered, from reset to read-out.
    pub frames: usize,
    /// Offsets of the frames in which the shutter is open, ascending.
    pub open: Vec<usize>,
}

/// The read-out that covers a frame.
#[derive(Clone, Copy, Debug)]
pub struct Readout<'a> {
    /// Schedule time of the first frame that it covers.
    pub start: i64,
    /// The shutter.
    pub shutter: &'a Shutter,
}

impl Readout<'_> {
    /// Schedule time of the read-out: the frame behind the last one covered.
    pub fn end(&self) -> i64 {
        self.start + self.shutter.frames as i64
    }
}

impl Shutter {
    /// Integration time in frames.
    pub fn exposure(&self) -> usize {
        self.open.len()
    }

    fn open_throughout(start: usize, frames: usize) -> Self {
        Self { start, frames, open: (0..frames).collect() }
    }
}

impl Cell {
    /// A pixel with exposure `exposure` that reads out at t ≡ `phase` (mod `exposure`).
    pub fn periodic(exposure: usize, phase: usize) -> Self {
        let start = phase % exposure.max(1);
        Self { period: exposure, shutters: vec![Shutter::open_throughout(start, exposure)] }
    }

    /// The read-out that covers schedule time `t`.
    pub fn covering(&self, t: i64) -> Readout<'_> {
        let period = self.period as i64;
        let phase = t.rem_euclid(period);
        // The shutter that started last; before the first start it is the last one of the period before.
        let begun = self.shutters.iter().rev().find(|s| s.start as i64 <= phase);
        let (shutter, lap) = begun.map_or((&self.shutters[self.shutters.len() - 1], period), |s| (s, 0));
        let start = t - phase - lap + shutter.start as i64;
        Readout { start, shutter }
    }

    fn check(&self) -> Result<(), String> {
        if self.period == 0 || self.period > MAX_PERIOD {
            return Err(format!("a period of {} frames; 1 to {MAX_PERIOD} can be used", self.period));
        }
        let within = |shutter: &Shutter| shutter.start < self.period && shutter.frames <= self.period;
        if let Some(shutter) = self.shutters.iter().find(|shutter| !within(shutter)) {
            return Err(format!("the shutter at frame {} does not lie within the period", shutter.start));
        }
        let mut covered = 0;
        for (i, shutter) in self.shutters.iter().enumerate() {
            let next = self.shutters.get(i + 1).map_or(self.shutters[0].start + self.period, |s| s.start);
            if shutter.start + shutter.frames != next {
                return Err(format!(
                    "the shutter at frame {} does not end where the next begins",
                    shutter.start
                ));
            }
            let ascending = shutter.open.is_sorted_by(|a, b| a < b);
            if shutter.open.is_empty() || !ascending || shutter.open.iter().any(|&f| f >= shutter.frames) {
                return Err(format!("the shutter at frame {} is open in {:?}", shutter.start, shutter.open));
            }
            covered += shutter.frames;
        }
        if covered == self.period { Ok(()) } else { Err("its shutters do not cover its period".into()) }
    }
}

impl Pattern {
    /// Names of the built-in patterns.
    pub const NAMES: [&str; 11] = [
        "mpve-1-4",
        "mpve-1-8",
        "mpve-1-16",
        "mpve-2x2-1-4",
        "mpve-2x2-1-8",
        "mpve-2x2-1-16",
        "global",
        "multi-phase",
        "sve",
        "interleaved",
        "coded",
    ];

    /// A built-in pattern.
    pub fn built_in(name: &str) -> Result<Self, SensorError> {
        let periodic =
            |cells: &[(usize, usize)]| cells.iter().map(|&(e, phase)| Cell::periodic(e, phase)).collect();
        let mpve = |layout: &str, kinds: [(usize, usize); 4]| {
            let [a, b, c, d] = kinds;
            match layout {
                "2x2" => (2, 2, periodic(&[a, b, c, d])),
                // Every 2×2 patch of this tile holds all four kinds too.
                _ => (2, 4, periodic(&[a, b, c, d, c, d, a, b])),
            }
        };
        let kinds_1_4 = [(2, 1), (4, 2), (8, 0), (8, 4)];
        let kinds_1_8 = [(2, 1), (4, 2), (8, 4), (16, 8)];
        let kinds_1_16 = [(2, 1), (4, 2), (8, 4), (32, 16)];
        let (rows, cols, cells) = match name {
            "mpve-1-4" => mpve("2x4", kinds_1_4),
            "mpve-1-8" => mpve("2x4", kinds_1_8),
            "mpve-1-16" => mpve("2x4", kinds_1_16),
            "mpve-2x2-1-4" => mpve("2x2", kinds_1_4),
            "mpve-2x2-1-8" => mpve("2x2", kinds_1_8),
            "mpve-2x2-1-16" => mpve("2x2", kinds_1_16),
            "global" => (1, 1, periodic(&[(4, 0)])),
            "multi-phase" => (2, 2, periodic(&[(4, 0), (4, 1), (4, 2), (4, 3)])),
            "sve" => (2, 2, periodic(&[(2, 0), (4, 0), (8, 0), (8, 0)])),
            "interleaved" => {
                let shutters = vec![Shutter::open_throughout(0, 2), Shutter::open_throughout(2, 8)];
                (1, 1, vec![Cell { period: 10, shutters }])
            }
            "coded" => (4, 4, coded(16, 8)),
            _ => {
                return Err(SensorError::Pattern(format!(
                    "no built-in '{name}'; there are {}, or name a JSON file",
                    Self::NAMES.join(", ")
                )));
            }
        };
        Ok(Self { name: name.to_owned(), rows, cols, cells })
    }

    /// A built-in pattern by name, or one from a JSON file where `name` ends in `.json`.
    pub fn load(name: &str) -> Result<Self> {
        let path = Path::new(name);
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json")) {
            let text = super::read_text(path).at(path)?;
            let tile: Tile =
                serde_json::from_str(&text).map_err(|e| SensorError::Pattern(e.to_string())).at(path)?;
            let fallback =
                path.file_stem().map_or("custom".into(), |stem| stem.to_string_lossy().into_owned());
            return tile.pattern(&fallback).at(path);
        }
        Ok(Self::built_in(name)?)
    }

    /// Whether `other` exposes every pixel as this pattern does, whatever their names.
    pub fn samples_like(&self, other: &Self) -> bool {
        (self.rows, self.cols, &self.cells) == (other.rows, other.cols, &other.cells)
    }

    /// The cell of the pixel in row `y`, column `x`.
    pub fn cell(&self, y: usize, x: usize) -> &Cell {
        &self.cells[(y % self.rows) * self.cols + x % self.cols]
    }

    /// Frames after which the whole pattern repeats.
    pub fn period(&self) -> usize {
        self.cells.iter().map(|cell| cell.period).fold(1, lcm)
    }

    fn shutters(&self) -> impl Iterator<Item = &Shutter> {
        self.cells.iter().flat_map(|cell| &cell.shutters)
    }

    /// Shortest exposure in frames. The sensor saturates where x reaches it (design §2, x_sat).
    pub fn shortest_exposure(&self) -> usize {
        self.shutters().map(Shutter::exposure).min().unwrap_or(1)
    }

    /// Most frames that one read-out covers: what a live source has to wait for.
    pub fn longest_readout(&self) -> usize {
        self.shutters().map(|shutter| shutter.frames).max().unwrap_or(1)
    }

    fn check(self) -> Result<Self, SensorError> {
        if self.cells.is_empty() || self.cells.len() > MAX_TILE || self.cells.len() != self.rows * self.cols {
            return Err(SensorError::Pattern(format!("a tile of {}×{} cells", self.rows, self.cols)));
        }
        for (i, cell) in self.cells.iter().enumerate() {
            cell.check().map_err(|problem| {
                SensorError::Pattern(format!("row {}, column {}: {problem}", i / self.cols, i % self.cols))
            })?;
        }
        let period = self.cells.iter().map(|cell| cell.period).try_fold(1, |period, cell| {
            let period = lcm(period, cell);
            (period <= MAX_PERIOD).then_some(period)
        });
        match period {
            Some(_) => Ok(self),
            None => Err(SensorError::Pattern(format!("it repeats only after more than {MAX_PERIOD} frames"))),
        }
    }
}

/// Random multiple-on codes, as in the paper's Fig. 4C: every pixel has its own code of `period` frames, open in
/// half of them.
fn coded(cells: usize, period: usize) -> Vec<Cell> {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let cell = |_| {
        let mut frames: Vec<usize> = (0..period).collect();
        for i in 0..period / 2 {
            frames.swap(i, rng.random_range(i..period));
        }
        let mut open = frames[..period / 2].to_vec();
        open.sort_unstable();
        Cell { period, shutters: vec![Shutter { start: 0, frames: period, open }] }
    };
    (0..cells).map(cell).collect()
}

/// A pattern as it stands in a JSON file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tile {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    tile: Vec<Vec<TileCell>>,
}

/// A cell as it stands in a JSON file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields)]
enum TileCell {
    /// [exposure, phase].
    Pair([usize; 2]),
    /// The same with names.
    Periodic { exposure: usize, phase: usize },
    /// Any shutters.
    Shutters { period: usize, shutters: Vec<TileShutter> },
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TileShutter {
    start: usize,
    frames: usize,
    /// Frames in which light is collected; all of them if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    open: Option<Vec<usize>>,
}

impl Tile {
    /// The pattern, checked.
    pub fn pattern(&self, fallback_name: &str) -> Result<Pattern, SensorError> {
        let cols = self.tile.first().map_or(0, Vec::len);
        if let Some(row) = self.tile.iter().position(|row| row.len() != cols) {
            return Err(SensorError::Pattern(format!("row {row} has not {cols} cells as row 0 has")));
        }
        let cell = |cell: &TileCell| match cell {
            &TileCell::Pair([exposure, phase]) | &TileCell::Periodic { exposure, phase } => {
                if exposure > MAX_PERIOD {
                    return Cell { period: exposure, shutters: Vec::new() };
                }
                Cell::periodic(exposure, phase)
            }
            TileCell::Shutters { period, shutters } => {
                let shutter = |s: &TileShutter| Shutter {
                    start: s.start,
                    frames: s.frames,
                    open: s.open.clone().unwrap_or_else(|| (0..s.frames.min(MAX_PERIOD + 1)).collect()),
                };
                Cell { period: *period, shutters: shutters.iter().map(shutter).collect() }
            }
        };
        Pattern {
            name: self.name.clone().unwrap_or_else(|| fallback_name.to_owned()),
            rows: self.tile.len(),
            cols,
            cells: self.tile.iter().flatten().map(cell).collect(),
        }
        .check()
    }
}

impl From<&Pattern> for Tile {
    fn from(pattern: &Pattern) -> Self {
        let cell = |cell: &Cell| TileCell::Shutters {
            period: cell.period,
            shutters: cell
                .shutters
                .iter()
                .map(|s| TileShutter { start: s.start, frames: s.frames, open: Some(s.open.clone()) })
                .collect(),
        };
        Self {
            name: Some(pattern.name.clone()),
            tile: pattern.cells.chunks(pattern.cols).map(|row| row.iter().map(cell).collect()).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_ins_are_sound() {
        for name in Pattern::NAMES {
            let pattern = Pattern::built_in(name).unwrap().check().unwrap();
            let tile = Tile::from(&pattern);
            let json = serde_json::to_string(&tile).unwrap();
            let read: Tile = serde_json::from_str(&json).unwrap();
            assert_eq!(read.pattern("x").unwrap(), pattern);
        }
    }

    /// design §3: exactly one kind of pixel reads out in each millisecond, in this order.
    #[test]
    fn mpve_reads_out_one_kind_per_frame() {
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let kinds: Vec<Vec<(usize, usize)>> = (0..8)
            .map(|t| {
                let mut kinds: Vec<_> = (0..4)
                    .map(|x| pattern.cell(0, x).covering(t - 1))
                    .filter(|readout| readout.end() == t)
                    .map(|readout| (readout.shutter.exposure(), readout.shutter.start))
                    .collect();
                kinds.dedup();
                kinds
            })
            .collect();
        let expected = [(8, 0), (2, 1), (4, 2), (2, 1), (8, 4), (2, 1), (4, 2), (2, 1)];
        assert_eq!(kinds, expected.map(|kind| vec![kind]));
    }

    #[test]
    fn every_patch_holds_all_four_kinds() {
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        for (y, x) in (0..4).flat_map(|y| (0..8).map(move |x| (y, x))) {
            let mut kinds: Vec<_> = [(0, 0), (0, 1), (1, 0), (1, 1)]
                .map(|(dy, dx)| &pattern.cell(y + dy, x + dx).shutters[0])
                .map(|shutter| (shutter.exposure(), shutter.start))
                .to_vec();
            kinds.sort_unstable();
            assert_eq!(kinds, [(2, 1), (4, 2), (8, 0), (8, 4)]);
        }
    }

    #[test]
    fn covering_intervals_end_at_the_phase() {
        let cell = Cell::periodic(8, 4);
        for t in -20..20 {
            let readout = cell.covering(t);
            assert!(readout.start <= t && t < readout.end());
            assert_eq!(readout.end().rem_euclid(8), 4);
        }
    }

    #[test]
    fn broken_tiles_are_refused_by_place() {
        let tile =
            |json: &str| serde_json::from_str::<Tile>(json).unwrap().pattern("x").unwrap_err().to_string();
        assert!(tile(r#"{"tile": []}"#).contains("0×0"));
        assert!(tile(r#"{"tile": [[[2, 1], [0, 0]]]}"#).contains("column 1"));
        assert!(tile(r#"{"tile": [[[2, 1]], [[2, 1], [4, 0]]]}"#).contains("row 1"));
        assert!(tile(r#"{"tile": [[[4000000000, 1]]]}"#).contains("period"));
        let gap = r#"{"tile": [[{"period": 10, "shutters": [{"start": 0, "frames": 3}]}]]}"#;
        assert!(tile(gap).contains("does not end"));
    }
}

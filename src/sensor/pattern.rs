//! Sampling patterns: which pixel integrates when (design §3).

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::SensorError;
use crate::math::lcm;
use crate::video::ending;
use crate::{At, Result};

/// Longest period of a pattern, in frames: the tables of the kernels have one entry a frame.
const MAX_PERIOD: usize = 256;
/// Largest tile, in pixels.
const MAX_TILE: usize = 4096;

/// A tile of pixels, each with a schedule of its own, that repeats over the sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Pattern {
    name: String,
    rows: usize,
    cols: usize,
    /// Those of the tile's pixels, row by row.
    schedules: Vec<Schedule>,
}

/// When one pixel integrates: shutters that repeat every `period` frames and cover all of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    period: usize,
    /// In order of their start; together they cover the period once.
    shutters: Vec<Shutter>,
}

/// One exposure: the frames that a read-out covers, and those of them in which light is collected.
#[derive(Clone, Debug, PartialEq)]
pub struct Shutter {
    start: usize,
    frames: usize,
    open: Vec<usize>,
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
    /// A shutter that covers `frames` frames from frame `start` of a period on, and collects light in those that lie
    /// `open` frames behind the first one. [`Schedule::new`] checks it.
    pub fn new(start: usize, frames: usize, open: Vec<usize>) -> Self {
        Self { start, frames, open }
    }

    /// The same, which collects light all the time.
    pub fn open_throughout(start: usize, frames: usize) -> Self {
        Self::new(start, frames, (0..frames).collect())
    }

    /// The first frame that it covers, in [0, period).
    pub fn start(&self) -> usize {
        self.start
    }

    /// Frames covered, from reset to read-out.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Offsets of the frames in which it is open, ascending.
    pub fn open(&self) -> &[usize] {
        &self.open
    }

    /// Integration time in frames.
    pub fn exposure(&self) -> usize {
        self.open.len()
    }
}

impl Schedule {
    /// Shutters in order of their start, which together cover `period` frames once; or what is wrong with them.
    pub fn new(period: usize, shutters: Vec<Shutter>) -> Result<Self, String> {
        check_period(period)?;
        let within = |shutter: &Shutter| shutter.start < period && shutter.frames <= period;
        if let Some(shutter) = shutters.iter().find(|shutter| !within(shutter)) {
            return Err(format!("the shutter at frame {} does not lie within the period", shutter.start));
        }
        let mut covered = 0;
        for (i, Shutter { start, frames, open }) in shutters.iter().enumerate() {
            let next = shutters.get(i + 1).map_or(shutters[0].start + period, |next| next.start);
            if start + frames != next {
                return Err(format!("the shutter at frame {start} does not end where the next begins"));
            }
            let ascending = open.is_sorted_by(|a, b| a < b);
            if open.is_empty() || !ascending || open.iter().any(|offset| offset >= frames) {
                return Err(format!("the shutter at frame {start} is open in {open:?}"));
            }
            covered += frames;
        }
        if covered == period {
            Ok(Self { period, shutters })
        } else {
            Err("its shutters do not cover its period".into())
        }
    }

    /// That of a pixel with exposure `exposure` that reads out at t ≡ `phase` (mod `exposure`).
    pub fn periodic(exposure: usize, phase: usize) -> Result<Self, String> {
        check_period(exposure)?;
        Self::new(exposure, vec![Shutter::open_throughout(phase % exposure, exposure)])
    }

    /// Frames after which the shutters repeat.
    pub fn period(&self) -> usize {
        self.period
    }

    /// In order of their start; together they cover the period once.
    pub fn shutters(&self) -> &[Shutter] {
        &self.shutters
    }

    /// The exposure in frames of all shutters, if they have one.
    pub fn exposure(&self) -> Option<usize> {
        let first = self.shutters[0].exposure();
        self.shutters.iter().all(|shutter| shutter.exposure() == first).then_some(first)
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
}

fn check_period(period: usize) -> Result<(), String> {
    if (1..=MAX_PERIOD).contains(&period) {
        Ok(())
    } else {
        Err(format!("a period of {period} frames; 1 to {MAX_PERIOD} can be used"))
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

    /// A tile of `rows` × `cols` pixels, whose schedules are given row by row.
    pub fn new(
        name: impl Into<String>,
        [rows, cols]: [usize; 2],
        schedules: Vec<Schedule>,
    ) -> Result<Self, SensorError> {
        if schedules.is_empty() || schedules.len() > MAX_TILE || schedules.len() != rows * cols {
            return Err(SensorError::Pattern(format!("a tile of {rows}×{cols} pixels")));
        }
        let period = schedules.iter().try_fold(1, |period, schedule| {
            let period = lcm(period, schedule.period);
            (period <= MAX_PERIOD).then_some(period)
        });
        match period {
            Some(_) => Ok(Self { name: name.into(), rows, cols, schedules }),
            None => Err(SensorError::Pattern(format!("it repeats only after more than {MAX_PERIOD} frames"))),
        }
    }

    /// A built-in pattern.
    pub fn built_in(name: &str) -> Result<Self, SensorError> {
        let periodic = |pixels: &[(usize, usize)]| {
            pixels.iter().map(|&(exposure, phase)| Schedule::periodic(exposure, phase)).collect()
        };
        // A 2×2 tile, and one of which every 2×2 patch holds all four kinds too.
        let square = |kinds: [(usize, usize); 4]| ([2, 2], periodic(&kinds));
        let mpve = |[a, b, c, d]: [(usize, usize); 4]| ([2, 4], periodic(&[a, b, c, d, c, d, a, b]));
        let kinds_1_4 = [(2, 1), (4, 2), (8, 0), (8, 4)];
        let kinds_1_8 = [(2, 1), (4, 2), (8, 4), (16, 8)];
        let kinds_1_16 = [(2, 1), (4, 2), (8, 4), (32, 16)];
        let (extent, schedules): ([usize; 2], Result<Vec<Schedule>, String>) = match name {
            "mpve-1-4" => mpve(kinds_1_4),
            "mpve-1-8" => mpve(kinds_1_8),
            "mpve-1-16" => mpve(kinds_1_16),
            "mpve-2x2-1-4" => square(kinds_1_4),
            "mpve-2x2-1-8" => square(kinds_1_8),
            "mpve-2x2-1-16" => square(kinds_1_16),
            "global" => ([1, 1], periodic(&[(4, 0)])),
            "multi-phase" => square([(4, 0), (4, 1), (4, 2), (4, 3)]),
            "sve" => square([(2, 0), (4, 0), (8, 0), (8, 0)]),
            "interleaved" => {
                let shutters = vec![Shutter::open_throughout(0, 2), Shutter::open_throughout(2, 8)];
                ([1, 1], Schedule::new(10, shutters).map(|schedule| vec![schedule]))
            }
            "coded" => ([4, 4], coded(16, 8)),
            _ => {
                return Err(SensorError::Pattern(format!(
                    "no built-in '{name}'; there are {}, or name a JSON file",
                    Self::NAMES.join(", ")
                )));
            }
        };
        Self::new(name, extent, schedules.map_err(SensorError::Pattern)?)
    }

    /// A built-in pattern by name, or one from a JSON file where `name` ends in `.json`.
    pub fn load(name: &str) -> Result<Self> {
        let path = Path::new(name);
        if ending(path) == "json" {
            let text = super::text::read_text(path).at(path)?;
            let tile: PatternTile =
                serde_json::from_str(&text).map_err(|e| SensorError::Pattern(e.to_string())).at(path)?;
            let fallback =
                path.file_stem().map_or("custom".into(), |stem| stem.to_string_lossy().into_owned());
            return tile.pattern(&fallback).at(path);
        }
        Ok(Self::built_in(name)?)
    }

    /// The tile of [rows, columns] that the same pixels make in another order.
    pub(super) fn rearranged(&self, [rows, cols]: [usize; 2], schedules: Vec<Schedule>) -> Self {
        Self { name: self.name.clone(), rows, cols, schedules }
    }

    /// The same pattern under another name.
    #[must_use]
    pub fn named(self, name: impl Into<String>) -> Self {
        Self { name: name.into(), ..self }
    }

    /// Its name; that of its file, or `custom`, for an unnamed one.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Rows of the tile.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Columns of the tile.
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// When the pixels of the tile integrate, row by row.
    pub fn schedules(&self) -> &[Schedule] {
        &self.schedules
    }

    /// Whether `other` exposes every pixel as this pattern does, whatever their names.
    pub fn samples_like(&self, other: &Self) -> bool {
        (self.rows, self.cols, &self.schedules) == (other.rows, other.cols, &other.schedules)
    }

    /// When the pixel in row `y`, column `x` integrates.
    pub fn schedule(&self, y: usize, x: usize) -> &Schedule {
        &self.schedules[(y % self.rows) * self.cols + x % self.cols]
    }

    /// Frames after which the whole pattern repeats.
    pub fn period(&self) -> usize {
        self.schedules.iter().map(Schedule::period).fold(1, lcm)
    }

    fn shutters(&self) -> impl Iterator<Item = &Shutter> {
        self.schedules.iter().flat_map(Schedule::shutters)
    }

    /// Shortest exposure in frames. The sensor saturates where x reaches it (design §2, x_sat).
    pub fn shortest_exposure(&self) -> usize {
        self.shutters().map(Shutter::exposure).min().unwrap_or(1)
    }

    /// Most frames that one read-out covers: what a live source has to wait for.
    pub fn longest_readout(&self) -> usize {
        self.shutters().map(Shutter::frames).max().unwrap_or(1)
    }
}

/// Random multiple-on codes, as in the paper's Fig. 4C: every pixel has its own code of `period` frames, open in
/// half of them.
fn coded(pixels: usize, period: usize) -> Result<Vec<Schedule>, String> {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let schedule = |_| {
        let mut frames: Vec<usize> = (0..period).collect();
        for i in 0..period / 2 {
            frames.swap(i, rng.random_range(i..period));
        }
        let mut open = frames[..period / 2].to_vec();
        open.sort_unstable();
        Schedule::new(period, vec![Shutter::new(0, period, open)])
    };
    (0..pixels).map(schedule).collect()
}

/// A pattern as it stands in a JSON file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatternTile {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    tile: Vec<Vec<Pixel>>,
}

/// A pixel's schedule as it stands in a JSON file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields)]
enum Pixel {
    /// [exposure, phase].
    Pair([usize; 2]),
    /// The same with names.
    Periodic { exposure: usize, phase: usize },
    /// Any shutters.
    Shutters { period: usize, shutters: Vec<PixelShutter> },
}

/// A shutter as it stands in a JSON file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PixelShutter {
    start: usize,
    frames: usize,
    /// Frames in which light is collected; all of them if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    open: Option<Vec<usize>>,
}

impl PatternTile {
    /// The pattern, checked.
    pub fn pattern(&self, fallback_name: &str) -> Result<Pattern, SensorError> {
        let cols = self.tile.first().map_or(0, Vec::len);
        if let Some(row) = self.tile.iter().position(|row| row.len() != cols) {
            return Err(SensorError::Pattern(format!("row {row} has not {cols} pixels as row 0 has")));
        }
        let schedule = |(i, pixel): (usize, &Pixel)| {
            pixel.schedule().map_err(|problem| {
                SensorError::Pattern(format!("row {}, column {}: {problem}", i / cols, i % cols))
            })
        };
        let schedules = self.tile.iter().flatten().enumerate().map(schedule).collect::<Result<_, _>>()?;
        let name = self.name.as_deref().unwrap_or(fallback_name);
        Pattern::new(name, [self.tile.len(), cols], schedules)
    }
}

impl Pixel {
    fn schedule(&self) -> Result<Schedule, String> {
        match self {
            &Self::Pair([exposure, phase]) | &Self::Periodic { exposure, phase } => {
                Schedule::periodic(exposure, phase)
            }
            Self::Shutters { period, shutters } => {
                // As many frames as are needed to see that they are too many.
                let throughout = |frames: usize| (0..frames.min(MAX_PERIOD + 1)).collect();
                let shutter = |s: &PixelShutter| {
                    Shutter::new(s.start, s.frames, s.open.clone().unwrap_or_else(|| throughout(s.frames)))
                };
                Schedule::new(*period, shutters.iter().map(shutter).collect())
            }
        }
    }
}

impl From<&Pattern> for PatternTile {
    fn from(pattern: &Pattern) -> Self {
        let shutter =
            |s: &Shutter| PixelShutter { start: s.start, frames: s.frames, open: Some(s.open.clone()) };
        let pixel = |schedule: &Schedule| Pixel::Shutters {
            period: schedule.period,
            shutters: schedule.shutters.iter().map(shutter).collect(),
        };
        Self {
            name: Some(pattern.name.clone()),
            tile: pattern.schedules.chunks(pattern.cols).map(|row| row.iter().map(pixel).collect()).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_ins_are_sound() {
        for name in Pattern::NAMES {
            let pattern = Pattern::built_in(name).unwrap();
            let tile = PatternTile::from(&pattern);
            let json = serde_json::to_string(&tile).unwrap();
            let read: PatternTile = serde_json::from_str(&json).unwrap();
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
                    .map(|x| pattern.schedule(0, x).covering(t - 1))
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
                .map(|(dy, dx)| &pattern.schedule(y + dy, x + dx).shutters[0])
                .map(|shutter| (shutter.exposure(), shutter.start))
                .to_vec();
            kinds.sort_unstable();
            assert_eq!(kinds, [(2, 1), (4, 2), (8, 0), (8, 4)]);
        }
    }

    #[test]
    fn covering_intervals_end_at_the_phase() {
        let schedule = Schedule::periodic(8, 4).unwrap();
        for t in -20..20 {
            let readout = schedule.covering(t);
            assert!(readout.start <= t && t < readout.end());
            assert_eq!(readout.end().rem_euclid(8), 4);
        }
    }

    #[test]
    fn broken_tiles_are_refused_by_place() {
        let tile = |json: &str| {
            serde_json::from_str::<PatternTile>(json).unwrap().pattern("x").unwrap_err().to_string()
        };
        assert!(tile(r#"{"tile": []}"#).contains("0×0"));
        assert!(tile(r#"{"tile": [[[2, 1], [0, 0]]]}"#).contains("column 1"));
        assert!(tile(r#"{"tile": [[[2, 1]], [[2, 1], [4, 0]]]}"#).contains("row 1"));
        assert!(tile(r#"{"tile": [[[4000000000, 1]]]}"#).contains("period"));
        let gap = r#"{"tile": [[{"period": 10, "shutters": [{"start": 0, "frames": 3}]}]]}"#;
        assert!(tile(gap).contains("does not end"));
    }
}

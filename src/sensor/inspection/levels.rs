//! Counts of a recording against its levels.

use crate::sensor::{Pattern, Recording};
use crate::video::Counts;

/// Least part of white that the brightest pixels of a recording are expected to reach.
const BRIGHT: f64 = 0.125;
/// Largest part of the counts that may lie outside of the levels, and how far outside, as a part of their range: noise, and
/// what lossy video adds.
const OUTSIDE: f64 = 0.001;
const FAR: f64 = 0.03;
/// A pile at which pixels saturate: the part of the counts that it has to be, within what part of the largest count, and
/// how much denser than below it.
const PILE: f64 = 0.002;
const NARROW: f64 = 0.015;
const STEEP: f64 = 4.0;
/// How far the white level may be from where pixels saturate, as a part of the range.
const WHITE: f64 = 0.015;
/// Values that counts with nothing in their last bits have to have, to be taken for left-justified ones.
const VALUES: usize = 16;

/// How often each count occurs, among pixels of each exposure.
#[derive(Clone, Debug)]
pub struct Levels {
    /// Exposures, ascending.
    exposures: Vec<usize>,
    /// Of each pixel of the tile that frames show, which of them it has.
    kinds: Vec<usize>,
    tile: [usize; 2],
    width: usize,
    /// [exposures, counts].
    histograms: Vec<Vec<u64>>,
}

impl Levels {
    pub fn new(pattern: &Pattern, width: usize, bits: u32) -> Self {
        let exposure = |i: usize| pattern.schedules()[i].exposure().unwrap_or(0);
        let pixels = pattern.schedules().len();
        let mut exposures: Vec<usize> = (0..pixels).map(exposure).collect();
        exposures.sort_unstable();
        exposures.dedup();
        let kind = |i: usize| exposures.binary_search(&exposure(i)).unwrap_or(0);
        Self {
            kinds: (0..pixels).map(kind).collect(),
            tile: [pattern.rows(), pattern.cols()],
            width,
            histograms: vec![vec![0; 1 << bits]; exposures.len()],
            exposures,
        }
    }

    /// Looks at the counts of a frame.
    pub fn add(&mut self, counts: &Counts) {
        match counts {
            Counts::U8(counts) => self.add_rows(counts),
            Counts::U16(counts) => self.add_rows(counts),
        }
    }

    fn add_rows<C: Copy + Into<usize>>(&mut self, counts: &[C]) {
        let [rows, cols] = self.tile;
        for (y, row) in counts.chunks(self.width).enumerate() {
            let kinds = &self.kinds[y % rows * cols..][..cols];
            for part in row.chunks(cols) {
                for (&count, &kind) in part.iter().zip(kinds) {
                    self.histograms[kind][count.into()] += 1;
                }
            }
        }
    }

    /// All counts with how often they occur, ascending.
    fn all(&self) -> impl Iterator<Item = (usize, u64)> + '_ {
        let times = |count: usize| self.histograms.iter().map(|histogram| histogram[count]).sum();
        (0..self.histograms[0].len()).map(move |count| (count, times(count))).filter(|(_, times)| *times > 0)
    }

    /// What is wrong with bit depth and levels of `recording`.
    pub fn findings(&self, recording: &Recording) -> Vec<LevelFinding> {
        let info = &recording.info;
        let (black, white) = (info.black_level, info.white_level);
        let total: u64 = self.all().map(|(_, times)| times).sum();
        let Some((largest, _)) = self.all().last() else { return Vec::new() };
        let array_bits = self.histograms[0].len().ilog2();
        if info.bit_depth > array_bits {
            return vec![LevelFinding::DepthOfArray {
                bit_depth: info.bit_depth,
                array_bits,
                white_level: white,
            }];
        }
        if largest >> info.bit_depth > 0 {
            let used = self.all().fold(0, |bits, (count, _)| bits | count);
            let empty_bits = used.trailing_zeros();
            let justified = empty_bits > 0
                && largest >> empty_bits >> info.bit_depth == 0
                && self.all().count() >= VALUES;
            let multiple = justified.then(|| 1 << empty_bits);
            let bit_depth = info.bit_depth;
            return vec![LevelFinding::BeyondDepth { largest, bit_depth, multiple, black_level: black }];
        }
        let share = |outside: &dyn Fn(f64) -> bool| {
            let counts = self.all().filter(|(count, _)| outside(*count as f64));
            counts.map(|(_, times)| times).sum::<u64>() as f64 / total as f64
        };
        let far = FAR * (white - black);
        let mut found = Vec::new();
        let below = share(&|count| count < black - far);
        if below > OUTSIDE {
            let least = self.all().map(|(count, _)| count).next().unwrap_or(0);
            found.push(LevelFinding::BelowBlack { percent: 100.0 * below, black_level: black, least });
        }
        let at_white = share(&|count| count >= white);
        let beyond = share(&|count| count > white + far);
        if let Some(saturation) =
            self.saturation().filter(|level| (level - white).abs() > WHITE * (white - black))
        {
            found.push(LevelFinding::Saturation { saturation, white_level: white });
        } else if beyond > OUTSIDE {
            found.push(LevelFinding::BeyondWhite { percent: 100.0 * beyond, white_level: white, largest });
        } else if at_white > 0.5 {
            found.push(LevelFinding::MostlyWhite { percent: 100.0 * at_white, white_level: white });
        }
        let reached = (largest as f64 - black) / (white - black);
        if found.is_empty() && reached < BRIGHT {
            found.push(LevelFinding::Dim { percent: 100.0 * reached.max(0.0), white_level: white, largest });
        }
        found
    }

    /// The count at which pixels saturate, if the histogram shows it: where pixels pile up, whatever their exposure. A
    /// bright part of the scene piles up too, but for each exposure at another count.
    fn saturation(&self) -> Option<f64> {
        let kinds = self.exposures.len();
        if kinds < 2 {
            return None;
        }
        let [second, longest] = [kinds - 2, kinds - 1].map(|kind| pile(&self.histograms[kind]));
        let ([second, longest], largest) = ([second?, longest?], self.all().last()?.0);
        let apart = second.abs_diff(longest) as f64;
        (apart <= NARROW * largest as f64).then_some(longest as f64)
    }
}

/// The middle of the pile at the upper end of a histogram, if there is one.
fn pile(histogram: &[u64]) -> Option<usize> {
    let largest = histogram.iter().rposition(|&times| times > 0)?;
    let total: u64 = histogram.iter().sum();
    let reach = (NARROW * largest as f64).ceil() as usize;
    let within = |from: usize, to: usize| histogram[from..=to.min(largest)].iter().sum::<u64>();
    let around = |count: usize| within(count.saturating_sub(reach), count + reach);
    let upper = largest - (largest / 10).min(largest)..=largest;
    // Lossy video spreads the pile; its middle is the count that most others are near.
    let middle = upper.clone().rev().max_by_key(|&count| (around(count), histogram[count]))?;
    let heaviest = (middle.saturating_sub(reach)..=(middle + reach).min(largest))
        .max_by_key(|&count| histogram[count])?;
    let below = within(heaviest.saturating_sub(5 * reach), heaviest.saturating_sub(3 * reach));
    let around = around(heaviest);
    (around as f64 >= PILE * total as f64 && around as f64 >= STEEP * below as f64).then_some(heaviest)
}

/// What is wrong with bit depth or levels.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LevelFinding {
    /// The description has more bits than the array.
    #[error(
        "a bit depth of {bit_depth} in an array of {array_bits}-bit counts: --bit-depth {array_bits}{}",
        white_option(*array_bits, *white_level)
    )]
    DepthOfArray {
        /// Described bits.
        bit_depth: u32,
        /// The array's.
        array_bits: u32,
        /// Described white level.
        white_level: f64,
    },
    /// Counts are larger than the described bits can be.
    #[error("counts reach {largest}, beyond the {} of {bit_depth} bits{}", (1u64 << bit_depth) - 1, beyond_cure(*largest, *bit_depth, *multiple, *black_level))]
    BeyondDepth {
        /// The largest count.
        largest: usize,
        /// Described bits.
        bit_depth: u32,
        /// What all counts are multiples of, if they are left-justified.
        multiple: Option<u64>,
        /// Described black level.
        black_level: f64,
    },
    /// Counts are less than black.
    #[error(
        "{percent:.1}% of the counts lie clearly below black level {black_level}: --black-level {least}, or what the camera says"
    )]
    BelowBlack {
        /// Part of all counts.
        percent: f64,
        /// Described black level.
        black_level: f64,
        /// The least count.
        least: usize,
    },
    /// Pixels saturate at another count than white.
    #[error(
        "pixels of all exposures pile up at {saturation}, where they saturate, not at white level {white_level}: --white-level {saturation}"
    )]
    Saturation {
        /// The count at which they do.
        saturation: f64,
        /// Described white level.
        white_level: f64,
    },
    /// Counts are more than white.
    #[error(
        "{percent:.1}% of the counts lie clearly beyond white level {white_level}: --white-level {largest}, or what the camera says"
    )]
    BeyondWhite {
        /// Part of all counts.
        percent: f64,
        /// Described white level.
        white_level: f64,
        /// The largest count.
        largest: usize,
    },
    /// Nothing but white.
    #[error(
        "{percent:.0}% of the pixels are at white or above: is white level {white_level} right (--white-level)?"
    )]
    MostlyWhite {
        /// Part of all counts.
        percent: f64,
        /// Described white level.
        white_level: f64,
    },
    /// Nothing but black.
    #[error(
        "no pixel gets beyond {percent:.1}% of white level {white_level}; the largest count is {largest}: --white-level, unless it was that dark"
    )]
    Dim {
        /// Part of white.
        percent: f64,
        /// Described white level.
        white_level: f64,
        /// The largest count.
        largest: usize,
    },
}

/// The option for white in counts of so many bits, unless it is within them.
fn white_option(bits: u32, white: f64) -> String {
    let most = f64::from((1u32 << bits) - 1);
    if white > most { format!(" --white-level {most}") } else { String::new() }
}

/// What to do about counts beyond the bit depth.
fn beyond_cure(largest: usize, bit_depth: u32, multiple: Option<u64>, black: f64) -> String {
    let Some(multiple) = multiple else {
        let bits = largest.ilog2() + 1;
        return format!(": --bit-depth {bits} --white-level {}", (1u64 << bits) - 1);
    };
    let white = ((1u64 << bit_depth) - 1) * multiple;
    let bits = (white + multiple).ilog2();
    let black =
        if black == 0.0 { String::new() } else { format!(" --black-level {}", black * multiple as f64) };
    format!(
        ", and all are multiples of {multiple}: they are left-justified: --bit-depth {bits} --white-level {white}{black}"
    )
}

//! How much a pixel value scatters when nothing changes.

use std::sync::Arc;

use super::cells::Cells;
use crate::frame::Frame;
use crate::sensor::{Readouts, Recording};

/// Entries of tables over the pixel value y = i/(n − 1).
pub const LEVELS: usize = 1024;
/// Intervals of pixel values in which scatter is estimated.
const INTERVALS: usize = 24;
/// Rows and columns of the pixels that one estimate comes from: small, so that their levels differ little.
const PATCH: [usize; 2] = [2, 4];
/// Fewest groups of pixels in an interval for an estimate.
const ENOUGH: usize = 6;

/// Index into a table of [`LEVELS`] entries.
pub fn level(y: f32) -> usize {
    ((y * (LEVELS - 1) as f32 + 0.5) as usize).min(LEVELS - 1)
}

/// From one entry of such a table to the next one.
const STEP: f64 = 1.0 / (LEVELS - 1) as f64;

/// Pixel value of an entry of such a table.
pub fn value(level: usize) -> f64 {
    level as f64 * STEP
}

/// dx/dy of R⁻¹, x = `exposure`(y), over the levels beside the one of `y`.
pub fn slope(y: f64, exposure: impl Fn(f64) -> f64) -> f64 {
    let (below, above) = ((y - STEP).max(0.0), (y + STEP).min(1.0));
    (exposure(above) - exposure(below)) / (above - below)
}

/// Variance of a pixel value by its level.
#[derive(Clone, Debug, PartialEq)]
pub struct Scatter {
    /// σ² of y, [`LEVELS`] entries, none below that of rounding to counts.
    pub variance: Vec<f32>,
}

/// Variance of rounding to counts, in units of y.
fn rounding(recording: &Recording) -> f64 {
    (recording.info.white_level - recording.info.black_level).recip().powi(2) / 12.0
}

impl Scatter {
    /// Shot and read noise (design §2) of a camera that says what they are; `None` where it does not.
    pub fn stated(recording: &Recording) -> Option<Self> {
        let full_well = recording.info.full_well_e.filter(|e| *e > 0.0)?;
        let read_noise = recording.info.read_noise_e?;
        let response = &recording.response;
        let per_x = full_well / response.saturation();
        let exposure = |y: f64| response.exposure(y);
        let variance = (0..LEVELS).map(value).map(|y| {
            let electrons = exposure(y) * per_x + read_noise * read_noise;
            (electrons / (per_x * slope(y, exposure).max(1e-9)).powi(2) + rounding(recording)) as f32
        });
        Some(Self { variance: variance.collect() })
    }

    /// Estimated from pairs of frames at the same phase of the pattern, as (earlier, later, schedule time of the later
    /// one).
    ///
    /// Half of the mean squared difference of a group, the read-outs of equal exposure in one [`PATCH`], is its variance
    /// plus whatever the scene changed there. The lower quartile of the groups of about equal level is taken, so
    /// that up to three quarters of a scene may move; χ² tells how far that lies below the variance itself.
    pub fn estimated(
        pairs: &[(Arc<Frame>, Arc<Frame>, i64)],
        cells: &Cells,
        readouts: &Readouts,
        recording: &Recording,
    ) -> Option<Self> {
        let kinds = readouts.exposures().len();
        let columns = cells.width.div_ceil(PATCH[1]);
        let groups = cells.height.div_ceil(PATCH[0]) * columns * kinds;
        // Sum of levels, of squared differences, and number of read-outs of each group.
        let mut sums = vec![(0.0f64, 0.0f64, 0usize); groups];
        for (earlier, later, t) in pairs {
            for y in 0..cells.height {
                let row = y / PATCH[0] * columns;
                for x in 0..cells.width {
                    let Some(kind) = readouts.beginning(*t, y, x) else { continue };
                    let [a, b] = [earlier, later].map(|frame| f64::from(frame.values()[y * cells.width + x]));
                    let sum = &mut sums[(row + x / PATCH[1]) * kinds + kind];
                    *sum = (sum.0 + b, sum.1 + (a - b) * (a - b), sum.2 + 1);
                }
            }
        }
        // Levels are finer where it is dark, as shot noise grows with the root.
        let interval = |y: f64| ((y.sqrt() * INTERVALS as f64) as usize).min(INTERVALS - 1);
        let mut found: Vec<Vec<f64>> = vec![Vec::new(); INTERVALS];
        for (levels, squares, n) in sums.into_iter().filter(|sum| sum.2 > 0) {
            let n = n as f64;
            if levels / n < 0.95 {
                found[interval(levels / n)].push(squares / (2.0 * n) / quartile_of_chi_square(n));
            }
        }
        let estimates: Vec<(f64, f64)> = found
            .into_iter()
            .enumerate()
            .filter(|(_, groups)| groups.len() >= ENOUGH)
            .map(|(i, mut groups)| {
                let quarter = groups.len() / 4;
                let variance = *groups.select_nth_unstable_by(quarter, f64::total_cmp).1;
                (((i as f64 + 0.5) / INTERVALS as f64).powi(2), variance)
            })
            .collect();
        if estimates.is_empty() {
            return None;
        }
        let floor = rounding(recording);
        let variance = (0..LEVELS).map(|i| {
            let y = i as f64 / (LEVELS - 1) as f64;
            interpolate(&estimates, y).max(floor) as f32
        });
        Some(Self { variance: variance.collect() })
    }
}

/// Lower quartile of χ²(n)/n, by Wilson and Hilferty's approximation.
fn quartile_of_chi_square(n: f64) -> f64 {
    let spread = 2.0 / (9.0 * n);
    (1.0 - spread - 0.6745 * spread.sqrt()).max(0.1).powi(3)
}

/// Linear between `points`, constant beyond them.
fn interpolate(points: &[(f64, f64)], x: f64) -> f64 {
    let behind = points.partition_point(|point| point.0 < x);
    match (behind.checked_sub(1).map(|i| points[i]), points.get(behind)) {
        (Some((x0, y0)), Some(&(x1, y1))) => y0 + (y1 - y0) * (x - x0) / (x1 - x0),
        (Some((_, y)), None) | (None, Some(&(_, y))) => y,
        (None, None) => 0.0,
    }
}

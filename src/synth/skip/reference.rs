//! What cells were last computed from, and whether they have changed since by more than noise explains.
//!
//! With d the difference of a read-out from that of the reference, w = 1/(2σ²) from the sensor's noise, and
//! a = dl/dy the slope of the tone curve at the read-out's exposure, the read-outs of a cell give
//!
//! - Σ w·d², which is about their number n if only noise differs, with a deviation of √(2n);
//! - M = Σ (w/a)·d / Σ w/a², the mean change of l, with a deviation of 1/√(Σ w/a²);
//! - the largest w·d², from which a single pixel that flashes cannot hide.
//!
//! A cell has changed if its mean square or mean change of l *may* exceed the allowed error. Where noise alone may
//! do so, it has changed if noise does not explain the change: what noise hides can't be told from nothing.
//!
//! The reference is what a cell was last *computed* from, so slow drift adds up until it is seen.

use std::ops::Range;

use rayon::prelude::*;

use super::cells::Cells;
use super::noise::{LEVELS, Scatter, level, slope, value};
use crate::cpu::inverse_response;
use crate::math::MU;
use crate::network::SATURATED;
use crate::sensor::{Calibration, Readouts, Recording};
use crate::synth::footage::Seen;

/// Deviations that noise may explain, for sums over many read-outs and for a single one.
const DEVIATIONS: f32 = 4.5;
const SINGLE_DEVIATIONS: f32 = 6.5;

/// Rows and columns of cells whose mean change is looked at together.
const GROUP: usize = 4;

/// What some read-outs say.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    /// Number of read-outs.
    n: f32,
    /// Σ w/a².
    information: f32,
    /// Σ w·d².
    squares: f32,
    /// Σ (w/a)·d.
    drift: f32,
    /// Largest w·d².
    peak: f32,
}

impl Sums {
    /// Whether the read-outs have changed by more than `allowed` in l, or, where noise hides as much, by more than
    /// noise.
    fn changed(&self, allowed: f32) -> bool {
        if self.n == 0.0 {
            return false;
        }
        // χ² to the power of 1/3 is nearly normal (Wilson and Hilferty).
        let spread = 2.0 / (9.0 * self.n);
        let noise = self.n * (1.0 - spread + DEVIATIONS * spread.sqrt()).powi(3) - self.n;
        let square = (allowed * allowed * self.information - noise).max(noise);
        self.squares - self.n > square
            || self.peak > SINGLE_DEVIATIONS * SINGLE_DEVIATIONS
            || self.drifted(allowed)
    }

    /// The same of their mean alone.
    fn drifted(&self, allowed: f32) -> bool {
        let noise = DEVIATIONS / self.information.sqrt();
        self.information > 0.0 && self.drift.abs() / self.information > (allowed - noise).max(noise)
    }

    /// These read-outs and others.
    fn and(self, other: Self) -> Self {
        Self {
            n: self.n + other.n,
            information: self.information + other.information,
            squares: self.squares + other.squares,
            drift: self.drift + other.drift,
            peak: self.peak.max(other.peak),
        }
    }
}

/// What every cell was last computed from, and how differences from it count.
pub struct Reference<'a> {
    cells: &'a Cells,
    calibration: &'a Calibration,
    readouts: Readouts,
    scatter: Option<Scatter>,
    /// w by level.
    weight: Vec<f32>,
    /// w/a and w/a² by level, for each exposure.
    slopes: Vec<Vec<[f32; 2]>>,
    /// Pixel values, w and w/a. w is 0 where no read-out begins. Rows of cells lie one behind the other, each as
    /// [repeat, rows of pixels, columns].
    values: Vec<f32>,
    weights: Vec<f32>,
    drifts: Vec<f32>,
    /// n and Σ w/a² of each cell, [rows of cells, repeat, columns of cells].
    known: Vec<[f32; 2]>,
}

impl<'a> Reference<'a> {
    /// Nothing yet, and never anything if it is not `used`.
    pub fn new(cells: &'a Cells, calibration: &'a Calibration, recording: &Recording, used: bool) -> Self {
        let frames = if used { cells.repeat } else { 0 };
        let len = frames * cells.rows() * cells.size[1] * cells.width;
        Self {
            cells,
            calibration,
            readouts: Readouts::new(&recording.pattern),
            scatter: None,
            weight: Vec::new(),
            slopes: Vec::new(),
            values: vec![0.0; len],
            weights: vec![0.0; len],
            drifts: vec![0.0; len],
            known: vec![[0.0; 2]; frames * cells.rows() * cells.cols()],
        }
    }

    /// When read-outs begin to show.
    pub fn readouts(&self) -> &Readouts {
        &self.readouts
    }

    /// Whether the noise is known.
    pub fn knows_noise(&self) -> bool {
        self.scatter.is_some()
    }

    /// Sets the noise by which differences count from the next [`Reference::update`] on.
    pub fn set_scatter(&mut self, scatter: Option<Scatter>) {
        let Some(scatter) = scatter else {
            self.scatter = None;
            return;
        };
        self.weight = scatter.variance.iter().map(|variance| 0.5 / variance).collect();
        self.slopes =
            self.readouts.exposures().iter().map(|&exposure| self.slopes(exposure as f64)).collect();
        self.scatter = Some(scatter);
    }

    /// w/a and w/a² by level for read-outs of an exposure; 0 where R⁻¹ does not rise or the read-out is saturated.
    fn slopes(&self, exposure: f64) -> Vec<[f32; 2]> {
        let x = |y: f64| inverse_response(&self.calibration.inverse_response, y);
        let of = |(y, &w): (f64, &f32)| {
            // dl/dp = µ/((1 + µp)·ln(1 + µ)), and p = x/e.
            let tone = MU / ((1.0 + MU * x(y) / exposure) * MU.ln_1p());
            let a = (tone / exposure * slope(y, x)) as f32;
            if y >= SATURATED || a <= 0.0 { [0.0; 2] } else { [w / a, w / (a * a)] }
        };
        (0..LEVELS).map(value).zip(&self.weight).map(of).collect()
    }

    /// Cells that have changed in the frames `around`, which the results of the frames `slab` depend on.
    pub fn changed(
        &self,
        seen: &Seen<'_>,
        slab: &Range<i64>,
        around: &Range<i64>,
        allowed: f32,
    ) -> Vec<bool> {
        let (rows, cols) = (self.cells.rows(), self.cells.cols());
        // Spans of up to a slab's frames, cut where slabs begin.
        let mut spans = Vec::new();
        let mut begin = around.start;
        while begin < around.end {
            let len = self.cells.size[0] as i64;
            let end = (begin + len - (begin - slab.start).rem_euclid(len)).min(around.end);
            spans.push(begin..end);
            begin = end;
        }
        // Where the slab itself has changed all along a row, as in a scene that moves everywhere, the others say no more.
        spans.sort_by_key(|span| span.start != slab.start);
        // Sums of every span and cell, [rows, spans, columns].
        let mut sums = vec![Sums::default(); rows * spans.len() * cols];
        sums.par_chunks_mut(spans.len() * cols).enumerate().for_each(|(r, sums)| {
            for (span, sums) in spans.iter().zip(sums.chunks_mut(cols)) {
                self.sums(seen, r, span.clone(), sums);
                if sums.iter().all(|sums| sums.changed(allowed)) {
                    break;
                }
            }
        });
        let of = |r: usize, span: usize, c: usize| sums[(r * spans.len() + span) * cols + c];
        let mut changed = vec![false; rows * cols];
        for (cell, changed) in changed.iter_mut().enumerate() {
            *changed = (0..spans.len()).any(|span| of(cell / cols, span, cell % cols).changed(allowed));
        }
        // What moves little but everywhere shows in the mean of many cells first. What moves much is no part of it.
        let apart = self.cells.dilate(&changed, [1, 1]);
        for (r, c) in (0..rows).step_by(GROUP).flat_map(|r| (0..cols).step_by(GROUP).map(move |c| (r, c))) {
            let columns = c..(c + GROUP).min(cols);
            let group = (r..(r + GROUP).min(rows)).flat_map(|r| columns.clone().map(move |c| (r, c)));
            let group: Vec<_> = group.filter(|(r, c)| !apart[r * cols + c]).collect();
            let sums = |span| group.iter().map(|&(r, c)| of(r, span, c)).fold(Sums::default(), Sums::and);
            if (0..spans.len()).any(|span| sums(span).drifted(allowed)) {
                for (r, c) in group {
                    changed[r * cols + c] = true;
                }
            }
        }
        changed
    }

    /// Sums over the frames `times` of each cell in row `r`.
    fn sums(&self, seen: &Seen<'_>, r: usize, times: Range<i64>, sums: &mut [Sums]) {
        let Cells { size: [_, cell_rows, cell_cols], repeat, width, .. } = *self.cells;
        // Squares, drift and peak of each column of pixels.
        let mut columns = vec![0.0f32; 3 * width];
        let (squares, others) = columns.split_at_mut(width);
        let (drift, peak) = others.split_at_mut(width);
        for t in times {
            let place = r * repeat + t.rem_euclid(repeat as i64) as usize;
            for (sums, known) in sums.iter_mut().zip(&self.known[place * self.cells.cols()..]) {
                sums.n += known[0];
                sums.information += known[1];
            }
            let frame = seen.at(t);
            for (y, now) in frame[r * cell_rows * width..].chunks(width).take(cell_rows).enumerate() {
                let begin = (place * cell_rows + y) * width;
                let [values, weights, drifts] =
                    [&self.values, &self.weights, &self.drifts].map(|own| &own[begin..][..width]);
                for x in 0..width {
                    let d = now[x] - values[x];
                    let square = weights[x] * d * d;
                    squares[x] += square;
                    drift[x] += drifts[x] * d;
                    peak[x] = if square > peak[x] { square } else { peak[x] };
                }
            }
        }
        for (c, sums) in sums.iter_mut().enumerate() {
            let columns = c * cell_cols..((c + 1) * cell_cols).min(width);
            sums.squares = squares[columns.clone()].iter().sum();
            sums.drift = drift[columns.clone()].iter().sum();
            sums.peak = peak[columns].iter().copied().fold(0.0, f32::max);
        }
    }

    /// Takes the frames `slab` as what the cells that are `active` are computed from.
    pub fn update(&mut self, seen: &Seen<'_>, slab: &Range<i64>, active: &[bool]) {
        if self.scatter.is_none() {
            return;
        }
        let Cells { size: [_, cell_rows, cell_cols], repeat, width, .. } = *self.cells;
        let cols = self.cells.cols();
        let (readouts, weight, slopes) = (&self.readouts, &self.weight, &self.slopes);
        let row_len = repeat * cell_rows * width;
        let values = self.values.par_chunks_mut(row_len).zip(self.weights.par_chunks_mut(row_len));
        let others = self.drifts.par_chunks_mut(row_len).zip(self.known.par_chunks_mut(repeat * cols));
        let rows = values.zip(others).zip(active.par_chunks(cols)).enumerate();
        rows.for_each(|(r, (((values, weights), (drifts, known)), active))| {
            for (t, c) in
                slab.clone().flat_map(|t| (0..cols).map(move |c| (t, c))).filter(|(_, c)| active[*c])
            {
                let place = t.rem_euclid(repeat as i64) as usize;
                let known = &mut known[place * cols + c];
                *known = [0.0; 2];
                let columns = c * cell_cols..((c + 1) * cell_cols).min(width);
                let frame = seen.at(t)[r * cell_rows * width..].chunks(width).take(cell_rows);
                for (y, now) in frame.enumerate() {
                    let now = &now[columns.clone()];
                    let begin = (place * cell_rows + y) * width;
                    let here = begin + columns.start..begin + columns.end;
                    values[here.clone()].copy_from_slice(now);
                    // Cells begin where the pattern's tile does.
                    let begins = readouts.beginning_in_row(t, r * cell_rows + y).iter().cycle();
                    let own = weights[here.clone()].iter_mut().zip(&mut drifts[here]);
                    for ((now, begins), (own_weight, own_drift)) in now.iter().zip(begins).zip(own) {
                        (*own_weight, *own_drift) = (0.0, 0.0);
                        if let Some(exposure) = *begins {
                            let level = level(*now);
                            let [drift, information] = slopes[exposure][level];
                            (*own_weight, *own_drift) = (weight[level], drift);
                            *known = [known[0] + 1.0, known[1] + information];
                        }
                    }
                }
            }
        });
    }
}

//! `blend`: predicted kernels. Each pixel has weights for the log irradiances around it, and a residual.
// Code gets the instructions of the function that it is inlined into.
#![allow(clippy::inline_always)]

use super::Real;
use super::calibration::Tone;
use super::features::frame;
use super::simd::{Simd, SimdToken, Task};
use super::view::{ScratchPool, TensorView, TensorViewMut};
use crate::network::{Fold, Tap};

/// What is computed.
#[derive(Clone, Copy, Debug)]
pub struct Blend<'a> {
    /// Block that is unfolded; it spans one frame.
    pub block: Fold,
    /// Offsets t, y, x of the pixels that the weights are for.
    pub taps: &'a [Tap],
    /// Frame and row of the log irradiance at which the result begins.
    pub origin: [usize; 2],
}

/// What is read.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a, R> {
    /// For each tap, and then for a residual, the values of all pixels of a block.
    pub weights: TensorView<'a, R>,
    /// Log irradiance.
    pub logs: TensorView<'a, R>,
    /// Estimate of the irradiance.
    pub estimate: TensorView<'a, R>,
}

/// What is done along a row of results, with b = l(estimate).
pub(super) trait Along<R>: Sync {
    /// Makes results of b.
    fn begin(&self, base: &[R], results: &mut [R]);
    /// Adds a tap: its weights, and its log irradiances.
    fn tap(&self, base: &[R], weights: &[R], logs: &[R], results: &mut [R]);
    /// Adds the residuals.
    fn end(&self, residuals: &[R], results: &mut [R]);
}

/// l⁻¹(clamp(b + Σ w·(log irradiance of the tap − b) + d, 0, 1)) with weights w and residual d.
struct Radiance<R>(Tone<R>);

impl<R: Real> Along<R> for Radiance<R> {
    fn begin(&self, base: &[R], results: &mut [R]) {
        results.copy_from_slice(base);
    }

    fn tap(&self, base: &[R], weights: &[R], logs: &[R], results: &mut [R]) {
        Simd::widest().run(AddTap { base, weights, logs, results });
    }

    fn end(&self, residuals: &[R], results: &mut [R]) {
        for (result, &residual) in results.iter_mut().zip(residuals) {
            *result += residual;
        }
        self.0.inverse_of_all(results);
    }
}

struct AddTap<'a, R> {
    base: &'a [R],
    weights: &'a [R],
    logs: &'a [R],
    results: &'a mut [R],
}

impl<R: Real> Task for AddTap<'_, R> {
    #[inline(always)]
    fn run<T: SimdToken>(self, _: T) {
        let taps = self.weights.iter().zip(self.logs).zip(self.base);
        for (result, ((&weight, &log), &base)) in self.results.iter_mut().zip(taps) {
            *result += weight * (log - base);
        }
    }
}

impl Blend<'_> {
    /// Computes the radiance.
    pub fn run<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        output: TensorViewMut<'_, R>,
        scratch: &ScratchPool<R>,
    ) {
        self.along_rows(inputs, output, scratch, &Radiance(Tone::new()));
    }

    /// Does `along` for each row. Taps outside of the frame or of the recording are left out.
    pub(super) fn along_rows<R: Real>(
        &self,
        Inputs { weights, logs, estimate }: Inputs<'_, R>,
        output: TensorViewMut<'_, R>,
        scratch: &ScratchPool<R>,
        along: &impl Along<R>,
    ) {
        let tone = Tone::new();
        let [_, by, bx] = self.block;
        let width = output.shape.x;
        let [first_t, first_y] = self.origin;
        output.for_each_rows(by, |mut rows| {
            scratch.with(|scratch| {
                for row in 0..rows.len() {
                    let (t, y) = (rows.t, rows.y + row);
                    let base = &mut scratch.sums;
                    base.clear();
                    base.extend(estimate.line(t, y));
                    tone.of_all(base);
                    let results = rows.line(row);
                    along.begin(base, results);
                    // The values of tap i (or the residual) along the row.
                    let gather = |i: usize, gathered: &mut Vec<R>| {
                        let first = (i * by + y % by) * bx;
                        gathered.clear();
                        let blocks = weights.row(t, y / by).map(|block| &block[first..first + bx]);
                        match bx {
                            2 => gathered.extend(blocks.flat_map(few::<R, 2>)),
                            4 => gathered.extend(blocks.flat_map(few::<R, 4>)),
                            _ => blocks.for_each(|values| gathered.extend_from_slice(values)),
                        }
                    };
                    for (i, &[dt, dy, dx]) in self.taps.iter().enumerate() {
                        let tap_t = frame(logs.shape.t, first_t + t, dt);
                        let place = tap_t.zip(frame(logs.shape.y, first_y + y, dy));
                        let Some((tap_t, tap_y)) = place else { continue };
                        // Columns whose tap lies inside.
                        let begin = (dx.min(0).unsigned_abs() as usize).min(width);
                        let end = width.saturating_sub(dx.max(0) as usize).max(begin);
                        let first = dx.max(0) as usize;
                        let logs = &logs.line(tap_t, tap_y)[first.min(width)..];
                        gather(i, &mut scratch.gathered);
                        let weights = &scratch.gathered[begin..end];
                        along.tap(&base[begin..end], weights, logs, &mut results[begin..end]);
                    }
                    gather(self.taps.len(), &mut scratch.gathered);
                    along.end(&scratch.gathered, results);
                }
            });
        });
    }
}

/// `N` values. To copy so few of them as a slice of any length would take several times as long.
fn few<R: Real, const N: usize>(values: &[R]) -> [R; N] {
    values.try_into().expect("blocks are N pixels wide")
}

//! `blend`: predicted kernels. Each pixel has weights for the log irradiances around it, and a residual.
// Code gets the instructions of the function that it is inlined into.
#![allow(clippy::inline_always)]

use super::calibration::Tone;
use super::features::frame;
use super::real::Real;
use super::rounding::{U, inverse_tone_error, tone_error};
use super::simd::{Simd, SimdToken, Task};
use super::twin::{Operands, Twin};
use super::view::{ScratchPool, TensorView, TensorViewMut};
use crate::network::{BlendStep, Tensor};

/// What is read.
#[derive(Clone, Copy, Debug)]
struct Inputs<'a, R> {
    /// For each tap, and then for a residual, the values of all pixels of a block.
    weights: TensorView<'a, R>,
    /// Log irradiance.
    logs: TensorView<'a, R>,
    /// Estimate of the irradiance.
    estimate: TensorView<'a, R>,
}

/// What is done along a row of results, with b = l(estimate).
trait Along<R>: Sync {
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

impl<'a, R: Real> Inputs<'a, R> {
    fn of(operands: &Operands<'a, R>) -> Self {
        Self { weights: operands.input(0), logs: operands.input(1), estimate: operands.input(2) }
    }
}

impl Twin for BlendStep {
    fn run<R: Real>(&self, operands: &Operands<'_, R>, output: TensorViewMut<'_, R>) {
        along_rows(self, Inputs::of(operands), output, operands.scratch, &Radiance(Tone::new()));
    }

    fn bound(&self, operands: &Operands<'_, f64>, output: &Tensor<f64>, _weights: f64) -> Tensor<f64> {
        let (inputs, scratch) = (Inputs::of(operands), operands.scratch);
        let mut magnitudes = Tensor::filled(output.shape, 0.0);
        along_rows(self, inputs, TensorViewMut::dense(&mut magnitudes), scratch, &Magnitudes);
        let mut error = Tensor::filled(output.shape, 0.0);
        along_rows(self, inputs, TensorViewMut::dense(&mut error), scratch, &WeightSums);
        let values = inputs.estimate.pixels().flatten().zip(&output.data);
        for ((error, magnitude), (&estimate, &result)) in
            error.data.iter_mut().zip(&magnitudes.data).zip(values)
        {
            let rounding = (self.taps.len() + 3) as f64 * U * magnitude;
            *error = inverse_tone_error(result, rounding + *error * tone_error(estimate, 0.0));
        }
        error
    }
}

/// |b| + Σ |w·(log irradiance − b)| + |d|: what roundings are in proportion to.
struct Magnitudes;

impl Along<f64> for Magnitudes {
    fn begin(&self, base: &[f64], results: &mut [f64]) {
        results.iter_mut().zip(base).for_each(|(result, base)| *result = base.abs());
    }

    fn tap(&self, base: &[f64], weights: &[f64], logs: &[f64], results: &mut [f64]) {
        for (((result, base), weight), log) in results.iter_mut().zip(base).zip(weights).zip(logs) {
            *result += (weight * (log - base)).abs();
        }
    }

    fn end(&self, residuals: &[f64], results: &mut [f64]) {
        results.iter_mut().zip(residuals).for_each(|(result, residual)| *result += residual.abs());
    }
}

/// 1 + Σ |w|: how far an error of b goes.
struct WeightSums;

impl Along<f64> for WeightSums {
    fn begin(&self, _: &[f64], results: &mut [f64]) {
        results.fill(1.0);
    }

    fn tap(&self, _: &[f64], weights: &[f64], _: &[f64], results: &mut [f64]) {
        results.iter_mut().zip(weights).for_each(|(result, weight)| *result += weight.abs());
    }

    fn end(&self, _: &[f64], _: &mut [f64]) {}
}

/// Does `along` for each row. Taps outside of the frame or of the recording are left out.
fn along_rows<R: Real>(
    step: &BlendStep,
    Inputs { weights, logs, estimate }: Inputs<'_, R>,
    output: TensorViewMut<'_, R>,
    scratch: &ScratchPool<R>,
    along: &impl Along<R>,
) {
    let tone = Tone::new();
    let [_, by, bx] = step.block;
    let width = output.shape.x;
    let [first_t, first_y] = step.origin;
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
                for (i, &[dt, dy, dx]) in step.taps.iter().enumerate() {
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
                gather(step.taps.len(), &mut scratch.gathered);
                along.end(&scratch.gathered, results);
            }
        });
    });
}

/// `N` values. To copy so few of them as a slice of any length would take several times as long.
fn few<R: Real, const N: usize>(values: &[R]) -> [R; N] {
    values.try_into().expect("blocks are N pixels wide")
}

//! How far a kernel's result may lie from the exact one: bounds that are derived, not guessed (design §7).
//!
//! A bound holds for one step on given inputs, at any executor that stores weights and the output with the unit
//! round-offs of [`RoundOffs`], computes in f32, and is as accurate as WGSL promises: exp to 3 + 2|x| ULP, log to
//! 2⁻²¹ on [0.5, 2] and to 3 ULP elsewhere, division to 2.5 ULP, sums in any order, fused or not.

use std::f64::consts::LN_2;
use std::sync::Arc;

use super::blend::{Along, Blend, Inputs};
use super::calibration::{CalibrationTables, inverse_response};
use super::twin::pack;
use super::view::{ScratchPool, TensorView, TensorViewMut};
use super::{Simd, box_estimate, evaluate, features};
use crate::Result;
use crate::network::{
    Activation, Channel, ConvolutionStep, Feature, Inspect, Kernel, Layer, MU, PlannedTensor, Precision,
    Step, Tensor,
};
use crate::sensor::Calibration;

/// Unit round-off of tensors that are stored as f32.
pub const F32: f64 = 1.0 / (1u32 << 24) as f64;

/// Unit round-off of tensors that are stored as f16.
pub const F16: f64 = 1.0 / (1u32 << 11) as f64;

/// Unit round-offs of what is stored of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoundOffs {
    /// Of weights. At f16, those to a channel share a power of two, so that all have full precision but those less than
    /// 2⁻²⁸ of the largest.
    pub weights: f64,
    /// Of the output.
    pub output: f64,
}

impl RoundOffs {
    /// Everything is f32.
    pub const FULL: Self = Self { weights: F32, output: F32 };

    /// What an executor of this precision stores of a step that writes to `tensor`.
    pub fn of(tensor: &PlannedTensor, precision: Precision) -> Self {
        let reduced = match precision {
            Precision::F32 => F32,
            Precision::F16 => F16,
        };
        Self { weights: reduced, output: if tensor.full_precision { F32 } else { reduced } }
    }
}

/// The c of design §7. It covers second-order terms, and one more rounding to the storage precision, such as
/// that of products in f16.
const SLACK: f64 = 2.0;

/// Unit round-off of the arithmetic.
const U: f64 = F32;
/// One ULP of a number in f32 is at most this part of it.
const ULP: f64 = 2.0 * U;
/// Error of a quotient, as a part of it: 2.5 ULP, and one rounding of a constant.
const QUOTIENT: f64 = 2.5 * ULP + U;
/// Error of log close to 1.
const LOG_NEAR_ONE: f64 = 8.0 * U;

/// Bounds each value's error of one kernel call.
///
/// `inputs` are the tensors as the step read them, and `output` is what [`evaluate`](super::evaluate) makes
/// of them at f64.
pub fn bound(
    kernel: &Kernel,
    inputs: &[Tensor<f64>],
    output: &Tensor<f64>,
    calibration: &Calibration,
    schedule: i64,
    round_offs: RoundOffs,
) -> Tensor<f64> {
    let view = |i: usize| TensorView::dense(&inputs[i]);
    let tables = CalibrationTables { calibration, schedule };
    let scratch = &ScratchPool::default();
    let mut error = Tensor::filled(output.shape, 0.0);
    match kernel {
        Kernel::BoxEstimate => {
            let errors = |t: usize, y: usize, line: &mut [f64]| {
                let values = line.iter_mut().zip(view(0).line(t, y)).zip(tables.exposures(t, y));
                for ((error, &measured), exposure) in values {
                    *error = irradiance_error(calibration, measured, exposure);
                }
            };
            box_estimate::box_filter(view(0), TensorViewMut::dense(&mut error), scratch, errors);
            // WeightSums are powers of two: 8 additions of positive numbers and a quotient.
            add(&mut error, output, |mean| (8.0 * U + QUOTIENT) * mean);
        }
        Kernel::Features { channels, block, .. } => {
            let given = inputs.len() > 2;
            let errors = |channel: Channel, t: usize, y: usize, line: &mut [f64]| {
                let values = view(0).line(t, y).iter().zip(tables.exposures(t, y));
                for (x, (error, (&measured, exposure))) in line.iter_mut().zip(values).enumerate() {
                    *error = match channel.feature {
                        Feature::Measurement | Feature::Saturated => 0.0,
                        Feature::LogIrradiance if given => 0.0,
                        Feature::LogIrradiance => log_irradiance_error(calibration, measured, exposure),
                        Feature::LogEstimate => tone_error(view(1).line(t, y)[x], 0.0),
                        Feature::LogExposure => log_error(exposure as f64) / LN_2,
                    };
                }
            };
            features::fold(channels, *block, TensorViewMut::dense(&mut error), scratch, errors);
        }
        Kernel::LogIrradiance => {
            for t in 0..output.shape.t {
                for y in 0..output.shape.y {
                    let first = (t * output.shape.y + y) * output.shape.x;
                    let values = view(0).line(t, y).iter().zip(tables.exposures(t, y));
                    for (error, (&measured, exposure)) in error.data[first..].iter_mut().zip(values) {
                        *error = log_irradiance_error(calibration, measured, exposure);
                    }
                }
            }
        }
        Kernel::Convolution(step) => {
            error = convolution_error(step, inputs, output, round_offs.weights);
        }
        Kernel::InverseResponse { exposures } => {
            let n = exposures.len();
            for (errors, values) in error.data.chunks_exact_mut(2 * n).zip(view(0).pixels()) {
                for ((error, &value), &exposure) in errors[n..].iter_mut().zip(values).zip(exposures) {
                    *error = irradiance_error(calibration, value, exposure);
                }
            }
        }
        Kernel::Fuse => {
            for ((error, weights), (rendered, result)) in
                error.data.iter_mut().zip(view(0).pixels()).zip(view(1).pixels().zip(&output.data))
            {
                let n = weights.len();
                let products: f64 = weights.iter().zip(&rendered[n..]).map(|(w, p)| (w * p).abs()).sum();
                let magnitude: f64 = weights.iter().map(|w| w.abs()).sum();
                let weight = weights.iter().sum::<f64>().abs();
                let sums = n as f64 * U * (products + magnitude * result.abs());
                *error = sums / weight + QUOTIENT * result.abs();
            }
        }
        Kernel::Blend { block, taps, origin } => {
            let blend = Blend { block: *block, taps, origin: *origin };
            let inputs = Inputs { weights: view(0), logs: view(1), estimate: view(2) };
            let mut magnitudes = error.clone();
            blend.along_rows(inputs, TensorViewMut::dense(&mut magnitudes), scratch, &Magnitudes);
            let mut weights = error.clone();
            blend.along_rows(inputs, TensorViewMut::dense(&mut weights), scratch, &WeightSums);
            let sums = magnitudes.data.iter().zip(&weights.data);
            let values = inputs.estimate.pixels().flatten().zip(&output.data);
            for ((error, (magnitude, weights)), (&estimate, &result)) in
                error.data.iter_mut().zip(sums).zip(values)
            {
                let rounding = (taps.len() + 3) as f64 * U * magnitude;
                *error = inverse_tone_error(result, rounding + weights * tone_error(estimate, 0.0));
            }
        }
    }
    let least = smallest_normal(round_offs.output);
    add(&mut error, output, |value| round_offs.output * value.abs().max(least));
    error.map(|error| SLACK * error)
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

/// The largest error as a fraction of its bound; infinite where a result is not a number.
pub fn largest_fraction(actual: &Tensor<f32>, exact: &Tensor<f64>, bound: &Tensor<f64>) -> f64 {
    let values = actual.data.iter().zip(&exact.data).zip(&bound.data);
    let fractions = values.map(|((&actual, exact), bound)| {
        let error = (actual as f64 - exact).abs();
        if error.is_nan() {
            f64::INFINITY
        } else if error == 0.0 {
            0.0
        } else {
            error / bound
        }
    });
    fractions.fold(0.0, f64::max)
}

/// How far one step of a plan went from the exact result.
#[derive(Clone, Debug, PartialEq)]
pub struct StepError {
    /// Name of the step.
    pub step: String,
    /// Name of its kernel.
    pub kernel: &'static str,
    /// Largest error as a fraction of its bound.
    pub fraction: f64,
    /// Largest magnitude of what it computed: how far from overflow it is.
    pub magnitude: f32,
}

/// Runs a window and compares the output of each step with the f64 twin's on the step's own inputs, as the executor
/// read them, stored at `precision`. The first step with a fraction above 1 is where the executor parts from its twin.
pub fn step_errors(
    executor: &mut dyn Inspect,
    calibration: &Calibration,
    measurement: &[f32],
    schedule: i64,
    precision: Precision,
) -> Result<Vec<StepError>> {
    let mut errors = Vec::new();
    let tensors = executor.plan().tensors.clone();
    let mut visit = |step: &Step, inputs: &[Tensor], output: &Tensor| {
        let inputs: Vec<Tensor<f64>> = inputs.iter().map(|input| input.map(|&v| f64::from(v))).collect();
        let schedule = step.schedule(schedule);
        let exact = evaluate(&step.kernel, &inputs, output.shape, calibration, schedule);
        let round_offs = RoundOffs::of(&tensors[step.output.tensor.0], precision);
        let bound = bound(&step.kernel, &inputs, &exact, calibration, schedule, round_offs);
        let fraction = largest_fraction(output, &exact, &bound);
        let magnitude = output.data.iter().map(|v| v.abs()).fold(0.0, f32::max);
        errors.push(StepError { step: step.name.clone(), kernel: step.kernel.name(), fraction, magnitude });
    };
    executor.trace(measurement, schedule, &mut visit)?;
    Ok(errors)
}

/// Adds `f` of each value to its error.
fn add(error: &mut Tensor<f64>, output: &Tensor<f64>, f: impl Fn(f64) -> f64) {
    for (error, &value) in error.data.iter_mut().zip(&output.data) {
        *error += f(value);
    }
}

/// The smallest number with full precision in the format with unit round-off `storage`; below, the spacing of
/// numbers is that of this number.
fn smallest_normal(storage: f64) -> f64 {
    if storage > F32 { 2f64.powi(-14) } else { f32::MIN_POSITIVE as f64 }
}

/// Error of a convolution and its epilogue, with weights of unit round-off `storage`.
fn convolution_error(
    step: &ConvolutionStep,
    inputs: &[Tensor<f64>],
    output: &Tensor<f64>,
    storage: f64,
) -> Tensor<f64> {
    // |W| ∗ |x| + |bias|. WeightSums that storage may round as if they were larger count as that.
    let relative = if storage > F32 { 2f32.powi(-28) } else { 0.0 };
    let largest = step.largest_weights();
    let least: Vec<f32> = largest.into_iter().map(|w| (relative * w).max(f32::MIN_POSITIVE)).collect();
    let magnitude = |(index, weight): (usize, &f32)| {
        let [_, out, _] = step.place_of(index);
        if *weight == 0.0 { 0.0 } else { weight.abs().max(least[out]) }
    };
    let absolute = ConvolutionStep {
        activation: Activation::None,
        layer: Arc::new(Layer {
            weight: step.layer.weight.iter().enumerate().map(magnitude).collect(),
            bias: step.layer.bias.iter().map(|b| b.abs()).collect(),
            norm: None,
        }),
        ..*step
    };
    let packed = pack::<f64>(&absolute, Simd::widest());
    let mut error = Tensor::filled(output.shape, 0.0);
    let magnitudes = inputs[0].map(|x| x.abs());
    packed.run(
        TensorView::dense(&magnitudes),
        None,
        TensorViewMut::dense(&mut error),
        &ScratchPool::default(),
    );
    let products = packed.products() as f64;
    let norm = step.layer.norm.as_ref();
    for (index, error) in error.data.iter_mut().enumerate() {
        let channel = index % step.out_channels;
        let magnitude = *error;
        let sum = (2.0 * storage + products * U) * magnitude;
        // The error, and the largest magnitude that the value can have.
        let (mut bound, mut value) = match step.activation {
            Activation::None => (sum, magnitude),
            Activation::LeakyRelu(slope) => {
                let steepest = (slope.abs() as f64).max(1.0);
                (steepest * sum + U * steepest * magnitude, steepest * magnitude)
            }
            // With s the result, the error of exp adds at most s(1 − s)(3 + 2|v|) ULP, which is below 1.25
            // ULP; 1 + e half, and the quotient 2.5 ULP.
            Activation::Sigmoid => (0.25 * sum + 5.0 * ULP, 1.0),
            // The error of exp adds at most e^−|v| (3 + 2|v|) ≤ 3 ULP, 1 + e half; then log, and two sums.
            Activation::Softplus(floor) => {
                let value = magnitude + LN_2 + floor.abs() as f64;
                (sum + 3.5 * ULP + LOG_NEAR_ONE + 2.0 * U * value, value)
            }
        };
        if let Some((scale, shift)) = norm {
            let (scale, shift) = (scale[channel].abs() as f64, shift[channel].abs() as f64);
            value = value * scale + shift;
            bound = bound * scale + 2.0 * U * value;
        }
        if let Some(added) = inputs.get(1) {
            value += added.data[index].abs();
            bound += U * value;
        }
        *error = bound;
    }
    error
}

/// Error of R⁻¹(y)/e: the position in the table is off by a rounding, which its slope turns into an error.
fn irradiance_error(calibration: &Calibration, y: f64, exposure: f32) -> f64 {
    let table = &calibration.inverse_response;
    let intervals = table.len() - 1;
    let position = y.clamp(0.0, 1.0) * intervals as f64;
    let index = (position as usize).min(intervals - 1);
    // A rounded position can lie in the next interval.
    let near = &table[index.saturating_sub(1)..table.len().min(index + 3)];
    let slope = near.windows(2).map(|pair| (pair[1] - pair[0]).abs() as f64).fold(0.0, f64::max);
    let value = near.iter().map(|v| v.abs() as f64).fold(0.0, f64::max);
    (U * position * slope + 3.0 * U * value + QUOTIENT * value) / exposure as f64
}

/// Error of l(R⁻¹(y)/e).
fn log_irradiance_error(calibration: &Calibration, y: f64, exposure: f32) -> f64 {
    let irradiance = inverse_response(&calibration.inverse_response, y) / exposure as f64;
    tone_error(irradiance, irradiance_error(calibration, y, exposure))
}

/// Error of ln x by itself.
fn log_error(x: f64) -> f64 {
    if (0.49..2.01).contains(&x) { LOG_NEAR_ONE } else { 3.0 * ULP * x.ln().abs() }
}

/// Error of l(p) = ln(1 + µp)/ln(1 + µ) where p is off by `error`.
fn tone_error(p: f64, error: f64) -> f64 {
    let sum = 1.0 + MU * p;
    let log = (MU * error + U * (MU * p + sum)) / sum + log_error(sum);
    (log + QUOTIENT * sum.ln()) / MU.ln_1p()
}

/// Error of p = l⁻¹(v) = (exp(v ln(1 + µ)) − 1)/µ where v is off by `error`.
fn inverse_tone_error(p: f64, error: f64) -> f64 {
    let power = 1.0 + MU * p;
    let exponent = power.ln();
    let relative = MU.ln_1p() * error + 2.0 * U * exponent + (3.0 + 2.0 * exponent) * ULP + U;
    power * relative / MU + QUOTIENT * p
}

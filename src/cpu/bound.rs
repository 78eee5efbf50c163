//! How far a kernel's result may lie from the exact one: bounds that are derived, not guessed (design §7).
//!
//! A bound holds for one step on given inputs, at any executor that stores weights and the output with the unit
//! round-offs of [`RoundOffs`], computes in f32, and is as accurate as WGSL promises (`rounding.rs`). Each twin bounds the
//! error of its own arithmetic.

use super::call::{arithmetic_error, evaluate};
use super::rounding::{F16, F32};
use crate::Result;
use crate::network::{Inspect, Kernel, PlannedTensor, Precision, Step, Tensor};
use crate::sensor::Calibration;

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
    let mut error = arithmetic_error(kernel, inputs, output, calibration, schedule, round_offs.weights);
    let least = smallest_normal(round_offs.output);
    for (error, value) in error.data.iter_mut().zip(&output.data) {
        *error += round_offs.output * value.abs().max(least);
    }
    error.map(|error| SLACK * error)
}

/// The smallest number with full precision in the format with unit round-off `storage`; below, the spacing of
/// numbers is that of this number.
fn smallest_normal(storage: f64) -> f64 {
    if storage > F32 { 2f64.powi(-14) } else { f32::MIN_POSITIVE as f64 }
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

//! The twin of `conv3d` and `conv_transpose3d`: what stands in [`conv3d`] and [`conv_transpose3d`], by direction.

use std::f64::consts::LN_2;
use std::sync::Arc;

use super::convolution::Packed;
use super::real::Real;
use super::rounding::{F32, LOG_NEAR_ONE, U, ULP};
use super::simd::Simd;
use super::twin::{Operands, Twin};
use super::view::{TensorView, TensorViewMut};
use super::{conv_transpose3d, conv3d};
use crate::network::{Activation, ConvolutionStep, Direction, Layer, Tensor};

/// The packed weights of a convolution.
pub fn pack<R: Real>(step: &ConvolutionStep, simd: Simd) -> Packed<R> {
    match step.direction {
        Direction::Forward => conv3d::pack(step, simd),
        Direction::Transposed => conv_transpose3d::pack(step, simd),
    }
}

impl Twin for Arc<ConvolutionStep> {
    fn run<R: Real>(&self, operands: &Operands<'_, R>, output: TensorViewMut<'_, R>) {
        let packed = operands.packed.expect("convolutions are packed");
        packed.run(operands.input(0), operands.inputs[1], output, operands.scratch);
    }

    fn bound(&self, operands: &Operands<'_, f64>, output: &Tensor<f64>, weights: f64) -> Tensor<f64> {
        error(self, operands, output, weights)
    }
}

/// Error of a convolution and its epilogue, with weights of unit round-off `storage`.
fn error(
    step: &ConvolutionStep,
    operands: &Operands<'_, f64>,
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
    let input = operands.input(0);
    let magnitudes =
        Tensor { shape: input.shape, data: input.pixels().flatten().map(|x: &f64| x.abs()).collect() };
    packed.run(TensorView::dense(&magnitudes), None, TensorViewMut::dense(&mut error), operands.scratch);
    let products = packed.products() as f64;
    let norm = step.layer.norm.as_ref();
    let mut added = operands.inputs[1].map(|added| added.pixels().flatten());
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
        if let Some(added) = added.as_mut().and_then(Iterator::next) {
            value += added.abs();
            bound += U * value;
        }
        *error = bound;
    }
    error
}

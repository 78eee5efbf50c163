//! `conv3d`: convolution with zero padding and a stride, then the epilogue.

use super::Real;
use super::convolution::{Axis, Packed, Phase};
use super::simd::Simd;
use crate::network::ConvolutionStep;

/// Packs the weights. Result o sums over the inputs o·stride − padding + tap.
pub fn pack<R: Real>(step: &ConvolutionStep, simd: Simd) -> Packed<R> {
    let axes = std::array::from_fn(|i| Axis {
        stride: step.stride[i],
        phases: vec![Phase { origin: -(step.padding[i] as isize), taps: step.kernel[i] }],
    });
    Packed::new(step, axes, simd, |o, i, _, tap| step.layer.weight[step.index_of(i, o, tap)])
}

//! `conv_transpose3d`: transposed convolution, then the epilogue.
//!
//! Input i adds to the results o = i·stride − padding + k. So the results of one phase, o mod stride, take
//! every stride-th k only, and are a convolution with stride 1 of their own.

use super::Real;
use super::convolution::{Axis, Packed, Phase};
use super::simd::Simd;
use crate::network::ConvolutionStep;

/// Packs the weights.
pub fn pack<R: Real>(step: &ConvolutionStep, simd: Simd) -> Packed<R> {
    // Position k of the kernel that result o of the first few takes first; the others are stride apart.
    let first = |axis: usize, o: usize| (o + step.padding[axis]) % step.stride[axis];
    let axes = std::array::from_fn(|axis| {
        let stride = step.stride[axis];
        let phase = |o: usize| {
            let taps = (step.kernel[axis] - first(axis, o)).div_ceil(stride);
            let last_input = (o + step.padding[axis]) / stride;
            Phase { origin: last_input as isize - (taps as isize - 1), taps }
        };
        Axis { stride: 1, phases: (0..stride).map(phase).collect() }
    });
    // Neighbouring inputs meet the kernel from its end.
    let position = |axis: usize, phase: usize, tap: usize| {
        let first = first(axis, phase);
        let taps = (step.kernel[axis] - first).div_ceil(step.stride[axis]);
        first + step.stride[axis] * (taps - 1 - tap)
    };
    Packed::new(step, axes, simd, |o, i, phase, tap| {
        let tap = std::array::from_fn(|axis| position(axis, phase[axis], tap[axis]));
        step.layer.weight[step.index_of(i, o, tap)]
    })
}

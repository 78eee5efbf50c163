//! Weights in the layout of the shaders.

use crate::network::ConvolutionStep;

/// Extents of a layer's packed weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Packing {
    /// Rows per tap, one an input channel. From four channels on, they are padded to a multiple of four, since four
    /// are read at once.
    pub rows: usize,
    /// Vectors of four output channels per row, padded to a multiple of what one invocation computes.
    pub vectors: usize,
}

/// Weights [tap][row][4 · vectors], with zeros for the padding.
pub(super) fn pack(step: &ConvolutionStep, transposed: bool, packing: Packing) -> Vec<f32> {
    let taps: usize = step.kernel.iter().product();
    let (inputs, outputs) = (step.in_channels, step.out_channels);
    let row = 4 * packing.vectors;
    let mut packed = vec![0.0; taps * packing.rows * row];
    for (index, &weight) in step.layer.weight.iter().enumerate() {
        let (channel, tap) = (index / taps, index % taps);
        // [out, in, tap], or [in, out, tap] for a transposed convolution.
        let (i, o) = if transposed {
            (channel / outputs, channel % outputs)
        } else {
            (channel % inputs, channel / inputs)
        };
        packed[(tap * packing.rows + i) * row + o] = weight;
    }
    packed
}

/// Bias, scale and shift, each of 4 · `vectors` values, with zeros for the padding.
pub(super) fn pack_terms(step: &ConvolutionStep, packing: Packing) -> Vec<f32> {
    let row = 4 * packing.vectors;
    let norm = step.layer.norm.as_ref().map(|(scale, shift)| [scale, shift]);
    let mut terms = vec![0.0; 3 * row];
    for (index, values) in std::iter::once(&step.layer.bias).chain(norm.into_iter().flatten()).enumerate() {
        terms[index * row..][..values.len()].copy_from_slice(values);
    }
    terms
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::network::{Activation, Layer};

    #[test]
    fn weights_are_transposed_and_padded() {
        let step = |weight: Vec<f32>| ConvolutionStep {
            kernel: [1, 1, 2],
            stride: [1; 3],
            padding: [0; 3],
            in_channels: 2,
            out_channels: 3,
            activation: Activation::None,
            layer: Arc::new(Layer { weight, bias: vec![1.0, 2.0, 3.0], norm: None }),
        };
        let packing = Packing { rows: 2, vectors: 1 };
        // Weight from in channel i to out channel o at tap k is 100 o + 10 i + k.
        let forward = (0..12).map(|n| (100 * (n / 4) + 10 * (n / 2 % 2) + n % 2) as f32).collect();
        let transposed = (0..12).map(|n| (100 * (n / 2 % 3) + 10 * (n / 6) + n % 2) as f32).collect();
        let expected: Vec<f32> =
            [0, 100, 200, 0, 10, 110, 210, 0, 1, 101, 201, 0, 11, 111, 211, 0].map(|v| v as f32).to_vec();
        assert_eq!(pack(&step(forward), false, packing), expected);
        assert_eq!(pack(&step(transposed), true, packing), expected);
        let terms = pack_terms(&step(vec![0.0; 12]), packing);
        assert_eq!(terms, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
}

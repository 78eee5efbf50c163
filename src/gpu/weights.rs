//! Weights in the layout of the shaders.

use half::f16;

use super::storage::Format;
use crate::network::ConvolutionStep;

/// Layout of a layer's weights: [tap][four input channels][load][group][lane] of four output channels. Row n of a
/// group, n = load · lanes + lane, goes from input channel n % 4 to vector group + (n / 4) · groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Packing {
    /// Groups of output channels.
    pub groups: usize,
    /// Vectors of four output channels of a group.
    pub vectors: usize,
    /// Invocations of a team.
    pub lanes: usize,
}

impl Packing {
    /// Loads of each invocation for four input channels.
    fn loads(self) -> usize {
        (4 * self.vectors).div_ceil(self.lanes)
    }

    /// Vectors of four output channels, padded to whole groups.
    pub fn out_vectors(self) -> usize {
        self.groups * self.vectors
    }

    /// Vectors of weights of one tap.
    pub fn tap(self, in_channels: usize) -> usize {
        in_channels.div_ceil(4) * self.loads() * self.groups * self.lanes
    }
}

/// Weights in that layout, with zeros for the padding.
pub(super) fn pack(step: &ConvolutionStep, transposed: bool, packing: Packing) -> Vec<f32> {
    let taps: usize = step.kernel.iter().product();
    let (inputs, outputs) = (step.in_channels, step.out_channels);
    let Packing { groups, lanes, .. } = packing;
    let tap_vectors = packing.tap(inputs);
    let mut packed = vec![0.0; 4 * taps * tap_vectors];
    for (index, &weight) in step.layer.weight.iter().enumerate() {
        let (channel, tap) = (index / taps, index % taps);
        // [out, in, tap], or [in, out, tap] for a transposed convolution.
        let (i, o) = if transposed {
            (channel / outputs, channel % outputs)
        } else {
            (channel % inputs, channel / inputs)
        };
        let (group, row) = (o / 4 % groups, o / 4 / groups * 4 + i % 4);
        let load = i / 4 * packing.loads() + row / lanes;
        let vector = tap * tap_vectors + (load * groups + group) * lanes + row % lanes;
        packed[4 * vector + o % 4] = weight;
    }
    packed
}

/// Bias, scale and shift, each padded with zeros to whole groups.
pub(super) fn pack_terms(step: &ConvolutionStep, packing: Packing) -> Vec<f32> {
    let row = 4 * packing.out_vectors();
    let norm = step.layer.norm.as_ref().map(|(scale, shift)| [scale, shift]);
    let mut terms = vec![0.0; 3 * row];
    for (index, values) in std::iter::once(&step.layer.bias).chain(norm.into_iter().flatten()).enumerate() {
        terms[index * row..][..values.len()].copy_from_slice(values);
    }
    terms
}

/// Values as they are stored.
pub(super) fn stored(values: &[f32], format: Format) -> Vec<u8> {
    match format {
        Format::F32 => bytemuck::cast_slice(values).to_vec(),
        Format::F16 => values.iter().flat_map(|&value| f16::from_f32(value).to_ne_bytes()).collect(),
    }
}

/// Stored bytes as values.
pub(super) fn loaded(bytes: &[u8], format: Format) -> Vec<f32> {
    match format {
        Format::F32 => bytemuck::pod_collect_to_vec(bytes),
        Format::F16 => {
            bytes.chunks_exact(2).map(|pair| f16::from_ne_bytes([pair[0], pair[1]]).to_f32()).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::network::{Activation, Layer};

    fn step(in_channels: usize, out_channels: usize, weight: Vec<f32>) -> ConvolutionStep {
        let bias = (1..=out_channels).map(|o| o as f32).collect();
        ConvolutionStep {
            kernel: [1, 1, 2],
            stride: [1; 3],
            padding: [0; 3],
            in_channels,
            out_channels,
            activation: Activation::None,
            layer: Arc::new(Layer { weight, bias, norm: None }),
        }
    }

    #[test]
    fn weights_are_transposed_and_padded() {
        let packing = Packing { groups: 1, vectors: 1, lanes: 1 };
        // Weight from in channel i to out channel o at tap k is 100 o + 10 i + k.
        let forward = (0..12).map(|n| (100 * (n / 4) + 10 * (n / 2 % 2) + n % 2) as f32).collect();
        let transposed = (0..12).map(|n| (100 * (n / 2 % 3) + 10 * (n / 6) + n % 2) as f32).collect();
        let tap = |k: i32| [0, 100, 200, -k, 10, 110, 210, -k].map(|v| (v + k) as f32).into_iter();
        let padding = || std::iter::repeat_n(0.0, 8);
        let expected: Vec<f32> = tap(0).chain(padding()).chain(tap(1)).chain(padding()).collect();
        assert_eq!(pack(&step(2, 3, forward), false, packing), expected);
        assert_eq!(pack(&step(2, 3, transposed), true, packing), expected);
        let terms = pack_terms(&step(2, 3, vec![0.0; 12]), packing);
        assert_eq!(terms, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }

    /// Every weight is where a lane of its group loads it, by the formula in the shader.
    #[test]
    fn weights_are_where_lanes_load_them() {
        let (inputs, outputs) = (7, 22);
        let weight: Vec<f32> = (0..2 * inputs * outputs).map(|n| (n + 1) as f32).collect();
        let step = step(inputs, outputs, weight.clone());
        for (groups, vectors, lanes) in [(3, 2, 1), (2, 3, 8), (1, 6, 32), (6, 1, 8)] {
            let packing = Packing { groups, vectors, lanes };
            let loads = (4 * vectors).div_ceil(lanes);
            let packed = pack(&step, false, packing);
            for (index, &weight) in weight.iter().enumerate() {
                let (o, i, tap) = (index / (2 * inputs), index / 2 % inputs, index % 2);
                let (group, j) = (o / 4 % groups, o / 4 / groups);
                let row = 4 * j + i % 4;
                let load = ((tap * inputs.div_ceil(4) + i / 4) * loads + row / lanes) * groups + group;
                assert_eq!(packed[(load * lanes + row % lanes) * 4 + o % 4], weight, "{packing:?}");
            }
            assert_eq!(packed.iter().filter(|&&w| w != 0.0).count(), weight.len());
        }
    }

    #[test]
    fn halves_come_back_rounded() {
        let values = [0.0, 1.0, -65504.0, 1.0 / 3.0, 6.1e-5];
        assert_eq!(loaded(&stored(&values, Format::F32), Format::F32), values);
        for (rounded, value) in loaded(&stored(&values, Format::F16), Format::F16).into_iter().zip(values) {
            assert!((rounded - value).abs() <= value.abs() / 2048.0, "{rounded} for {value}");
        }
    }
}

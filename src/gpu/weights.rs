//! Weights in the layout of the shaders.

use half::f16;

use super::storage::TensorFormat;
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

/// Exponent of the largest weight to a channel in its unit, at f16: those 2²⁸ times smaller still have all digits.
const LARGEST_EXPONENT: i32 = 14;

/// The power of two in which the weights to each output channel are stored, so that `format` can hold them: the largest
/// of them is about 2¹⁴ at f16. The epilogue multiplies by it.
pub(super) fn weight_units(step: &ConvolutionStep, format: TensorFormat) -> Vec<f32> {
    match format {
        TensorFormat::F32 => vec![1.0; step.out_channels],
        TensorFormat::F16 => step.largest_weights().into_iter().map(unit_of).collect(),
    }
}

/// The power of two in which `largest` is about 2¹⁴, and 1 for 0.
pub(super) fn unit_of(largest: f32) -> f32 {
    if largest == 0.0 {
        return 1.0;
    }
    let exponent = largest.log2().floor() as i32 - LARGEST_EXPONENT;
    2f32.powi(exponent.max(f32::MIN_EXP - 1))
}

/// Weights in that layout, each in the unit of its output channel, with zeros for the padding.
pub(super) fn pack(step: &ConvolutionStep, packing: Packing, units: &[f32]) -> Vec<f32> {
    let taps: usize = step.kernel.iter().product();
    let Packing { groups, lanes, .. } = packing;
    let tap_vectors = packing.tap(step.in_channels);
    let mut packed = vec![0.0; 4 * taps * tap_vectors];
    for (index, &weight) in step.layer.weight.iter().enumerate() {
        let [i, o, tap] = step.place_of(index);
        let (group, row) = (o / 4 % groups, o / 4 / groups * 4 + i % 4);
        let load = i / 4 * packing.loads() + row / lanes;
        let vector = tap * tap_vectors + (load * groups + group) * lanes + row % lanes;
        packed[4 * vector + o % 4] = weight / units[o];
    }
    packed
}

/// What the epilogue of a convolution wants to know of each output channel: rows of values that are padded to whole
/// groups.
#[derive(Clone, Debug)]
pub(super) struct Terms {
    /// Units of weights, bias, scale, shift, and parts of the output's unit that 1 is.
    values: Vec<f32>,
    /// Values of a row.
    row: usize,
}

impl Terms {
    pub fn new(step: &ConvolutionStep, packing: Packing, units: &[f32]) -> Self {
        let row = 4 * packing.out_vectors();
        let norm = step.layer.norm.as_ref().map(|(scale, shift)| [&scale[..], shift]);
        let mut values = vec![0.0; 4 * row];
        let rows = [units, &step.layer.bias].into_iter().chain(norm.into_iter().flatten());
        for (index, terms) in rows.enumerate() {
            values[index * row..][..terms.len()].copy_from_slice(terms);
        }
        values.resize(5 * row, 1.0);
        Self { values, row }
    }

    /// The rows, where the input is stored in units of `input` and the output in units of `output`.
    pub fn in_units(&self, input: f32, output: f32) -> Vec<f32> {
        let mut values = self.values.clone();
        values[..self.row].iter_mut().for_each(|unit| *unit *= input);
        values[4 * self.row..].iter_mut().for_each(|part| *part /= output);
        values
    }
}

/// Values as they are stored.
pub(super) fn stored(values: &[f32], format: TensorFormat) -> Vec<u8> {
    match format {
        TensorFormat::F32 => bytemuck::cast_slice(values).to_vec(),
        TensorFormat::F16 => values.iter().flat_map(|&value| f16::from_f32(value).to_ne_bytes()).collect(),
    }
}

/// Stored bytes as values.
pub(super) fn loaded(bytes: &[u8], format: TensorFormat) -> Vec<f32> {
    match format {
        TensorFormat::F32 => bytemuck::pod_collect_to_vec(bytes),
        TensorFormat::F16 => {
            bytes.chunks_exact(2).map(|pair| f16::from_ne_bytes([pair[0], pair[1]]).to_f32()).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::network::{Activation, Direction, Layer};

    fn step(in_channels: usize, out_channels: usize, weight: Vec<f32>) -> ConvolutionStep {
        let bias = (1..=out_channels).map(|o| o as f32).collect();
        ConvolutionStep {
            direction: Direction::Forward,
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
        let units = [1.0; 3];
        assert_eq!(pack(&step(2, 3, forward), packing, &units), expected);
        let transposed = ConvolutionStep { direction: Direction::Transposed, ..step(2, 3, transposed) };
        assert_eq!(pack(&transposed, packing, &units), expected);
        let terms = Terms::new(&step(2, 3, vec![0.0; 12]), packing, &[8.0, 4.0, 0.5]);
        let rows = [[16.0, 8.0, 1.0, 0.0], [1.0, 2.0, 3.0, 0.0], [0.0; 4], [0.0; 4], [0.25; 4]];
        assert_eq!(terms.in_units(2.0, 4.0), rows.concat());
    }

    /// Weights of any magnitude come back as exact as f16 is, however far apart those of two channels are.
    #[test]
    fn weights_of_any_magnitude_are_stored() {
        let packing = Packing { groups: 1, vectors: 1, lanes: 1 };
        let largest = [3e38, 7e4, 1.0, 6e-8, 1.2e-38];
        for [a, b] in largest.map(|a| largest.map(|b| [a, b])).concat() {
            // To two channels, from two channels, one tap of two: [out, in, tap].
            let weight = vec![a, -a / 3.0, a / 777.0, 0.0, -b, b / 3.0, b / 777.0, 0.0];
            let step = step(2, 2, weight.clone());
            let units = weight_units(&step, TensorFormat::F16);
            let packed = loaded(&stored(&pack(&step, packing, &units), TensorFormat::F16), TensorFormat::F16);
            for (index, weight) in weight.into_iter().enumerate() {
                let [i, o, tap] = step.place_of(index);
                let back = f64::from(packed[16 * tap + 4 * i + o]) * f64::from(units[o]);
                let error = (back - f64::from(weight)).abs();
                assert!(error <= f64::from(weight.abs()) / 2048.0, "{back:e} for {weight:e}");
            }
        }
        assert_eq!(weight_units(&step(1, 1, vec![0.0; 2]), TensorFormat::F16), [1.0]);
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
            let packed = pack(&step, packing, &[1.0; 22]);
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
        assert_eq!(loaded(&stored(&values, TensorFormat::F32), TensorFormat::F32), values);
        for (rounded, value) in
            loaded(&stored(&values, TensorFormat::F16), TensorFormat::F16).into_iter().zip(values)
        {
            assert!((rounded - value).abs() <= value.abs() / 2048.0, "{rounded} for {value}");
        }
    }
}

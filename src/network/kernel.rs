//! Parameters that several operations and the kernels share.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// A parameter of a step, as a shader may want it.
#[derive(Clone, Debug, PartialEq)]
pub enum Parameter {
    /// A number.
    Integer(usize),
    /// A number along each of t, y and x.
    Axes([usize; 3]),
    /// Several numbers.
    Integers(Vec<i32>),
    /// Several numbers.
    Floats(Vec<f32>),
}

/// A channel of a [`FeaturesStep`](super::FeaturesStep).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channel {
    /// What is computed from the pixel.
    pub feature: Feature,
    /// How many frames later the pixel is, if it is log irradiance from the third input, which is 0 outside.
    pub offset: i32,
}

/// A convolution with all that its kernel needs.
#[derive(Clone, Debug)]
pub struct ConvolutionStep {
    /// Which way it goes.
    pub direction: Direction,
    /// Taps along t, y, x.
    pub kernel: [usize; 3],
    /// Steps along t, y, x.
    pub stride: [usize; 3],
    /// Zero padding in front along t, y, x.
    pub padding: [usize; 3],
    /// Input channels.
    pub in_channels: usize,
    /// Output channels.
    pub out_channels: usize,
    /// Applied to sum and bias.
    pub activation: Activation,
    /// Weights, bias, scale and shift.
    pub layer: Arc<Layer>,
}

impl ConvolutionStep {
    /// Whether both compute the same with the same weights.
    pub fn is_same(&self, other: &Self) -> bool {
        // Models share layers, whose many weights need no comparing then.
        let weights = Arc::ptr_eq(&self.layer, &other.layer) || self.layer == other.layer;
        let shape = |step: &Self| {
            let Self { direction, kernel, stride, padding, in_channels, out_channels, .. } = *step;
            (direction, [kernel, stride, padding], [in_channels, out_channels], step.activation)
        };
        weights && shape(self) == shape(other)
    }

    /// Input channel, output channel and tap of weight `index`: [out, in, tap], or [in, out, tap] where it is transposed.
    pub fn place_of(&self, index: usize) -> [usize; 3] {
        let taps: usize = self.kernel.iter().product();
        let (channel, tap) = (index / taps, index % taps);
        match self.direction {
            Direction::Forward => [channel % self.in_channels, channel / self.in_channels, tap],
            Direction::Transposed => [channel / self.out_channels, channel % self.out_channels, tap],
        }
    }

    /// Number of the weight from input channel `i` to output channel `o` at tap t, y, x: what [`Self::place_of`] undoes.
    pub fn index_of(&self, i: usize, o: usize, [t, y, x]: [usize; 3]) -> usize {
        let [kt, ky, kx] = self.kernel;
        let channels = match self.direction {
            Direction::Forward => o * self.in_channels + i,
            Direction::Transposed => i * self.out_channels + o,
        };
        ((channels * kt + t) * ky + y) * kx + x
    }

    /// Largest magnitude of the weights to each output channel.
    pub fn largest_weights(&self) -> Vec<f32> {
        let mut largest = vec![0.0f32; self.out_channels];
        for (index, weight) in self.layer.weight.iter().enumerate() {
            let [_, out, _] = self.place_of(index);
            largest[out] = largest[out].max(weight.abs());
        }
        largest
    }
}

/// A channel that is computed from a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// y.
    Measurement,
    /// l(R⁻¹(y)/e).
    LogIrradiance,
    /// l of the estimate.
    LogEstimate,
    /// 1 where y is saturated.
    Saturated,
    /// log2 e.
    LogExposure,
}

/// Parameters of a convolution and its epilogue.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Convolution {
    /// Output channels.
    pub out_channels: usize,
    /// Taps along t, y, x.
    pub kernel: [usize; 3],
    /// Steps along t, y, x.
    pub stride: [usize; 3],
    /// Applied to the sum and bias.
    pub activation: Activation,
    /// Whether a per-channel scale and shift follows the activation.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub norm: bool,
    /// Node that is added last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub add: Option<String>,
}

impl Convolution {
    /// Number of taps.
    pub fn taps(&self) -> usize {
        self.kernel.iter().product()
    }
}

/// Which way a convolution goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Result o is the sum over inputs o·stride − padding + tap.
    Forward,
    /// Input i adds to results i·stride − padding + tap.
    Transposed,
}

/// Activation functions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// v.
    None,
    /// v, or slope·v below zero.
    LeakyRelu(f32),
    /// 1/(1 + e⁻ᵛ).
    Sigmoid,
    /// ln(1 + eᵛ) plus a floor.
    Softplus(f32),
}

/// Tensors of one convolution, as in the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layer {
    /// `conv3d`: [out, in, kt, ky, kx]; `conv_transpose3d`: [in, out, kt, ky, kx].
    pub weight: Vec<f32>,
    /// One value an output channel.
    pub bias: Vec<f32>,
    /// Scale and shift, one value an output channel each, where the node has `norm`.
    pub norm: Option<(Vec<f32>, Vec<f32>)>,
}

/// Frames, rows and columns whose pixels are folded into channels (space to depth).
pub type Fold = [usize; 3];

/// An offset in frames, rows and columns.
pub type Tap = [i32; 3];

//! Convolutions and transposed convolutions with zero padding, then the epilogue: activation, norm, a node that is added.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::operation::{Kind, MAX_CHANNELS, Operation, Parts, exactly};
use super::relation::{Relation, Scale};
use crate::network::kernel::{Activation, Convolution, ConvolutionStep, Direction, Kernel};
use crate::network::tensor::Shape;

/// A convolution: result o is the sum over inputs o·stride − padding + tap, with padding (kernel − 1)/2.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Conv3d(pub Convolution);

/// A transposed convolution: input i adds to results i·stride − padding + tap, with padding (kernel − stride)/2.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ConvTranspose3d(pub Convolution);

impl Convolution {
    /// Checks what both directions want, and that `fits` holds for each kernel extent and stride.
    fn check(&self, fits: impl Fn(usize, usize) -> bool) -> Result<(), String> {
        let Self { kernel, stride, out_channels, .. } = self;
        if *out_channels == 0 || *out_channels > MAX_CHANNELS {
            return Err(format!("{out_channels} output channels"));
        }
        for (&k, &s) in kernel.iter().zip(stride) {
            if k == 0 || k > 15 || s == 0 || s > 4 || !fits(k, s) {
                return Err(format!("kernel {kernel:?} with stride {stride:?}"));
            }
        }
        if let Activation::LeakyRelu(number) | Activation::Softplus(number) = self.activation
            && !number.is_finite()
        {
            return Err(format!("an activation with {number}"));
        }
        Ok(())
    }

    /// The step for some results, with zero `padding` in front of the inputs that it sees.
    fn step(&self, direction: Direction, padding: [isize; 3], parts: &Parts<'_>) -> Kernel {
        Kernel::Convolution(Arc::new(ConvolutionStep {
            direction,
            kernel: self.kernel,
            stride: self.stride,
            padding: padding.map(isize::unsigned_abs),
            in_channels: parts.channels,
            out_channels: self.out_channels,
            activation: self.activation,
            layer: parts.layer.map(Arc::clone).expect("a model has a layer for every convolution"),
        }))
    }
}

impl Operation for Conv3d {
    fn wants(&self, _input: usize) -> Kind {
        Kind::Channels
    }

    fn gives(&self) -> Kind {
        Kind::Channels
    }

    fn shape(&self, inputs: &[Shape], _measurement: Shape) -> Result<Shape, String> {
        let [input] = exactly(inputs)?;
        let Self(conv) = self;
        conv.check(|kernel, _| kernel % 2 == 1)?;
        let extent = input.extent();
        Ok(Shape::new(std::array::from_fn(|i| extent[i].div_ceil(conv.stride[i])), conv.out_channels))
    }

    fn relation(&self, input: usize) -> [Relation; 3] {
        let Self(Convolution { kernel, stride, .. }) = self;
        let window = |i: usize| {
            let others = kernel[i].saturating_sub(1);
            Relation { scale: Scale::Down(stride[i]), before: others / 2, after: others - others / 2 }
        };
        // The second one is added.
        if input == 0 { std::array::from_fn(window) } else { [Relation::SAME; 3] }
    }

    fn sees_camera(&self) -> bool {
        false
    }

    fn convolution(&self) -> Option<(&Convolution, Direction)> {
        Some((&self.0, Direction::Forward))
    }

    fn kernel(&self, parts: &Parts<'_>) -> Option<Kernel> {
        let [t, y] = parts.origins[0];
        let [before_t, before_y, before_x] = self.relation(0).map(|axis| axis.before as isize);
        Some(self.0.step(Direction::Forward, [before_t - t, before_y - y, before_x], parts))
    }
}

impl Operation for ConvTranspose3d {
    fn wants(&self, _input: usize) -> Kind {
        Kind::Channels
    }

    fn gives(&self) -> Kind {
        Kind::Channels
    }

    fn shape(&self, inputs: &[Shape], _measurement: Shape) -> Result<Shape, String> {
        let [input] = exactly(inputs)?;
        let Self(conv) = self;
        conv.check(|kernel, stride| kernel >= stride && (kernel - stride).is_multiple_of(2))?;
        let extent = input.extent();
        Ok(Shape::new(std::array::from_fn(|i| extent[i].saturating_mul(conv.stride[i])), conv.out_channels))
    }

    fn relation(&self, input: usize) -> [Relation; 3] {
        let Self(Convolution { kernel, stride, .. }) = self;
        let window = |i: usize| {
            let padding = kernel[i].saturating_sub(stride[i]) / 2;
            let before = kernel[i].saturating_sub(1 + padding);
            Relation { scale: Scale::Up(stride[i]), before, after: padding }
        };
        // The second one is added.
        if input == 0 { std::array::from_fn(window) } else { [Relation::SAME; 3] }
    }

    fn sees_camera(&self) -> bool {
        false
    }

    fn convolution(&self) -> Option<(&Convolution, Direction)> {
        Some((&self.0, Direction::Transposed))
    }

    fn kernel(&self, parts: &Parts<'_>) -> Option<Kernel> {
        let [t, y] = parts.origins[0];
        let [after_t, after_y, after_x] = self.relation(0).map(|axis| axis.after as isize);
        Some(self.0.step(Direction::Transposed, [after_t + t, after_y + y, after_x], parts))
    }
}

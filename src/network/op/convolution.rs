//! Convolutions and transposed convolutions with zero padding, then the epilogue: activation, norm, a node that is added.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::operation::{Computed, Computes, Kind, MAX_CHANNELS, Operation, Parts, exactly};
use super::relation::{Relation, Scale};
use crate::network::kernel::{Activation, Convolution, ConvolutionStep, Direction, Parameter};
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
    fn step(&self, direction: Direction, padding: [isize; 3], parts: &Parts<'_>) -> Arc<ConvolutionStep> {
        Arc::new(ConvolutionStep {
            direction,
            kernel: self.kernel,
            stride: self.stride,
            padding: padding.map(isize::unsigned_abs),
            in_channels: parts.channels,
            out_channels: self.out_channels,
            activation: self.activation,
            layer: parts.layer.map(Arc::clone).expect("a model has a layer for every convolution"),
        })
    }
}

/// What an operation says of itself that is a convolution in one direction or the other.
trait Directed {
    const DIRECTION: Direction;

    fn convolution(&self) -> &Convolution;

    /// Whether a kernel of this extent fits this stride.
    fn fits(kernel: usize, stride: usize) -> bool;

    /// Results along an axis of so many inputs.
    fn results(inputs: usize, stride: usize) -> usize;

    /// What a result depends on along an axis.
    fn window(kernel: usize, stride: usize) -> Relation;

    /// Zeros in front of the inputs, where the results begin at `origin` in what a step sees of those.
    fn padding(window: Relation, origin: isize) -> isize;
}

impl Directed for Conv3d {
    const DIRECTION: Direction = Direction::Forward;

    fn convolution(&self) -> &Convolution {
        &self.0
    }

    fn fits(kernel: usize, _stride: usize) -> bool {
        kernel % 2 == 1
    }

    fn results(inputs: usize, stride: usize) -> usize {
        inputs.div_ceil(stride)
    }

    fn window(kernel: usize, stride: usize) -> Relation {
        let others = kernel.saturating_sub(1);
        Relation { scale: Scale::Down(stride), before: others / 2, after: others - others / 2 }
    }

    fn padding(window: Relation, origin: isize) -> isize {
        window.before as isize - origin
    }
}

impl Directed for ConvTranspose3d {
    const DIRECTION: Direction = Direction::Transposed;

    fn convolution(&self) -> &Convolution {
        &self.0
    }

    fn fits(kernel: usize, stride: usize) -> bool {
        kernel >= stride && (kernel - stride).is_multiple_of(2)
    }

    fn results(inputs: usize, stride: usize) -> usize {
        inputs.saturating_mul(stride)
    }

    fn window(kernel: usize, stride: usize) -> Relation {
        let padding = kernel.saturating_sub(stride) / 2;
        let before = kernel.saturating_sub(1 + padding);
        Relation { scale: Scale::Up(stride), before, after: padding }
    }

    fn padding(window: Relation, origin: isize) -> isize {
        window.after as isize + origin
    }
}

impl<D: Directed> Operation for D {
    fn wants(&self, _input: usize) -> Kind {
        Kind::Channels
    }

    fn gives(&self) -> Kind {
        Kind::Channels
    }

    fn shape(&self, inputs: &[Shape], _measurement: Shape) -> Result<Shape, String> {
        let [input] = exactly(inputs)?;
        let conv = Directed::convolution(self);
        conv.check(D::fits)?;
        let extent = input.extent();
        let results = std::array::from_fn(|i| D::results(extent[i], conv.stride[i]));
        Ok(Shape::new(results, conv.out_channels))
    }

    fn relation(&self, input: usize) -> [Relation; 3] {
        let Convolution { kernel, stride, .. } = Directed::convolution(self);
        // The second one is added.
        if input == 0 {
            std::array::from_fn(|i| D::window(kernel[i], stride[i]))
        } else {
            [Relation::SAME; 3]
        }
    }

    fn sees_camera(&self) -> bool {
        false
    }

    fn convolution(&self) -> Option<(&Convolution, Direction)> {
        Some((Directed::convolution(self), D::DIRECTION))
    }
}

impl<D: Directed> Computed for D {
    type Step = Arc<ConvolutionStep>;

    fn step(&self, parts: &Parts<'_>) -> Arc<ConvolutionStep> {
        let [t, y] = parts.origins[0];
        let (windows, origins) = (self.relation(0), [t, y, 0]);
        let padding = std::array::from_fn(|i| D::padding(windows[i], origins[i]));
        Directed::convolution(self).step(D::DIRECTION, padding, parts)
    }
}

impl Computes for Arc<ConvolutionStep> {
    fn parameters(&self) -> Vec<(&'static str, Parameter)> {
        vec![
            ("kernel", Parameter::Axes(self.kernel)),
            ("stride", Parameter::Axes(self.stride)),
            ("padding", Parameter::Axes(self.padding)),
        ]
    }

    fn convolution(&self) -> Option<&Self> {
        Some(self)
    }
}

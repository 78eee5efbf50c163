//! What a graph and a plan know of an operation.

use std::sync::Arc;

use super::relation::Relation;
use crate::network::kernel::{Convolution, ConvolutionStep, Direction, Layer, Parameter};
use crate::network::tensor::Shape;

/// Bounds on what a file may declare, far above any useful net: they keep a hostile file from asking for absurd amounts of
/// memory or time.
pub const MAX_CHANNELS: usize = 8192;
pub const MAX_EXTENT: usize = 64;
pub const MAX_FRAMES: usize = 256;

/// What a tensor holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One value a pixel, stored densely: what operations on pixels read.
    Scalar,
    /// Feature channels, stored as vectors of four: what convolutions read.
    Channels,
}

/// All that a graph and a plan know of an operation: the rest follows from it.
///
/// Inputs are numbered as a node names them; what a convolution adds comes behind them. Parameters may be anything until
/// [`Operation::shape`] has accepted them.
pub trait Operation {
    /// What input number `input` has to hold.
    fn wants(&self, input: usize) -> Kind;

    /// What the result holds.
    fn gives(&self) -> Kind;

    /// Shape of the result for inputs of these shapes, in a window of this one; or what is wrong with them.
    fn shape(&self, inputs: &[Shape], measurement: Shape) -> Result<Shape, String>;

    /// What a result depends on of an input along t, y and x.
    fn relation(&self, input: usize) -> [Relation; 3];

    /// Whether an input is read at all.
    fn reads(&self, _input: usize) -> bool {
        true
    }

    /// Whether results depend on the camera's tables, so that their frame and row in the recording matter.
    fn sees_camera(&self) -> bool;

    /// The convolution and its direction, if it is one.
    fn convolution(&self) -> Option<(&Convolution, Direction)> {
        None
    }
}

/// An operation that a kernel computes, in steps of a plan.
pub trait Computed: Operation {
    /// What a step computes.
    type Step: Computes;

    /// The step for some of the results.
    fn step(&self, parts: &Parts<'_>) -> Self::Step;
}

/// What a step of a plan computes, wherever its tensors lie.
pub trait Computes {
    /// Its parameters by the names that shaders have for them.
    fn parameters(&self) -> Vec<(&'static str, Parameter)>;

    /// The convolution, if it is one.
    fn convolution(&self) -> Option<&Arc<ConvolutionStep>> {
        None
    }
}

/// The inputs of some results, as their kernel sees them.
pub struct Parts<'a> {
    /// Where, along t and y, the results begin in each input ([`Relation::origin`]).
    pub origins: &'a [[isize; 2]],
    /// Channels of the first input.
    pub channels: usize,
    /// Weights of the node, if it has some.
    pub layer: Option<&'a Arc<Layer>>,
}

/// The shapes of as many inputs as there have to be.
pub fn exactly<const N: usize>(inputs: &[Shape]) -> Result<[Shape; N], String> {
    inputs.try_into().map_err(|_| format!("wants {N} inputs, has {}", inputs.len()))
}

/// How far offsets reach to either side, 0 among them.
pub fn around(offsets: impl Iterator<Item = i32>) -> (usize, usize) {
    let far = |(before, after): (i32, i32), offset: i32| (before.min(offset), after.max(offset));
    let (before, after) = offsets.fold((0, 0), far);
    (before.unsigned_abs() as usize, after.unsigned_abs() as usize)
}

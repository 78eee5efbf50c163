//! What a kernel is on a CPU: the twin of its shader.

use super::calibration::CalibrationTables;
use super::convolution::Packed;
use super::real::Real;
use super::view::{ScratchPool, TensorView, TensorViewMut};
use crate::network::Tensor;

/// Inputs of a kernel at most.
pub const MAX_INPUTS: usize = 3;

/// What a kernel is given besides its parameters and its output.
#[derive(Clone, Copy)]
pub struct Operands<'a, R> {
    /// The inputs of the step, in its order.
    pub inputs: [Option<TensorView<'a, R>>; MAX_INPUTS],
    /// The camera's tables at the schedule time of the output's first frame.
    pub tables: CalibrationTables<'a>,
    /// Weights of a convolution.
    pub packed: Option<&'a Packed<R>>,
    /// Memory for what is needed in between.
    pub scratch: &'a ScratchPool<R>,
}

impl<'a, R: Real> Operands<'a, R> {
    /// An input that every step of the kernel has.
    pub fn input(&self, i: usize) -> TensorView<'a, R> {
        self.inputs[i].expect("a plan gives every kernel its inputs")
    }
}

/// A kernel on a CPU, in f32 or f64.
pub trait Twin {
    /// Computes the output.
    fn run<R: Real>(&self, operands: &Operands<'_, R>, output: TensorViewMut<'_, R>);

    /// Bounds the error of each value of `output`, which [`run`](Self::run) has made of the operands at f64, before it is
    /// stored: of what computes in f32 (`rounding.rs`) with weights whose unit round-off is `weights`.
    fn bound(&self, operands: &Operands<'_, f64>, output: &Tensor<f64>, weights: f64) -> Tensor<f64>;
}

//! Calls of kernels, whichever they are.

use super::calibration::CalibrationTables;
use super::convolution::Packed;
use super::convolution_twin::pack;
use super::real::Real;
use super::simd::Simd;
use super::twin::{Operands, Twin};
use super::view::{ScratchPool, TensorView, TensorViewMut};
use crate::network::{Kernel, Shape, Tensor, for_each_operation};
use crate::sensor::Calibration;

/// Runs one kernel on dense tensors, which must have the shapes that the kernel wants.
///
/// `inputs` are those of a step, in its order, and `schedule` is the schedule time of the output's first
/// frame, [`Step::schedule`](crate::network::Step::schedule).
pub fn evaluate<R: Real>(
    kernel: &Kernel,
    inputs: &[Tensor<R>],
    output_shape: Shape,
    calibration: &Calibration,
    schedule: i64,
) -> Tensor<R> {
    let mut output = Tensor::filled(output_shape, R::ZERO);
    let packed = kernel.convolution().map(|step| pack(step, Simd::widest()));
    let scratch = &ScratchPool::default();
    let call = KernelCall { kernel, packed: packed.as_ref(), calibration, schedule, scratch };
    call.run(|i| inputs.get(i).map(TensorView::dense), TensorViewMut::dense(&mut output));
    output
}

/// Bounds the error of each value before it is stored, as [`Twin::bound`] says; `inputs` and `output` are those of
/// [`evaluate`].
pub fn arithmetic_error(
    kernel: &Kernel,
    inputs: &[Tensor<f64>],
    output: &Tensor<f64>,
    calibration: &Calibration,
    schedule: i64,
    weights: f64,
) -> Tensor<f64> {
    let scratch = &ScratchPool::default();
    let call = KernelCall { kernel, packed: None, calibration, schedule, scratch };
    call.bound(|i| inputs.get(i).map(TensorView::dense), output, weights)
}

/// All that a kernel call needs besides its tensors.
pub struct KernelCall<'a, R> {
    pub kernel: &'a Kernel,
    pub packed: Option<&'a Packed<R>>,
    pub calibration: &'a Calibration,
    pub schedule: i64,
    pub scratch: &'a ScratchPool<R>,
}

macro_rules! define {
    (computed: { $($name:ident: $Op:ident,)* } placed: $placed:tt) => {
        impl<R: Real> KernelCall<'_, R> {
            /// Runs the kernel on the step's inputs, which `input` gives by number.
            pub fn run<'t>(
                &'t self,
                input: impl Fn(usize) -> Option<TensorView<'t, R>>,
                output: TensorViewMut<'_, R>,
            ) {
                let operands = self.operands(input);
                match self.kernel {
                    $(Kernel::$Op(step) => step.run(&operands, output),)*
                }
            }
        }

        impl KernelCall<'_, f64> {
            /// Bounds the error of its results ([`Twin::bound`]).
            fn bound<'t>(
                &'t self,
                input: impl Fn(usize) -> Option<TensorView<'t, f64>>,
                output: &Tensor<f64>,
                weights: f64,
            ) -> Tensor<f64> {
                let operands = self.operands(input);
                match self.kernel {
                    $(Kernel::$Op(step) => step.bound(&operands, output, weights),)*
                }
            }
        }
    };
}
for_each_operation!(define);

impl<R: Real> KernelCall<'_, R> {
    fn operands<'t>(&'t self, input: impl Fn(usize) -> Option<TensorView<'t, R>>) -> Operands<'t, R> {
        let tables = CalibrationTables { calibration: self.calibration, schedule: self.schedule };
        Operands { inputs: std::array::from_fn(input), tables, packed: self.packed, scratch: self.scratch }
    }
}

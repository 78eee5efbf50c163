//! Which twin computes a kernel.

use super::blend::{Blend, Inputs};
use super::calibration::CalibrationTables;
use super::convolution::Packed;
use super::real::Real;
use super::simd::Simd;
use super::view::{ScratchPool, TensorView, TensorViewMut};
use super::{box_estimate, conv_transpose3d, conv3d, features, fuse, inverse_response, log_irradiance};
use crate::network::{ConvolutionStep, Direction, Kernel, Shape, Tensor};
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
    let call = KernelCall {
        kernel,
        packed: packed.as_ref(),
        calibration,
        schedule,
        scratch: &ScratchPool::default(),
    };
    call.run(|i| inputs.get(i).map(TensorView::dense), TensorViewMut::dense(&mut output));
    output
}

/// The packed weights of a convolution.
pub(super) fn pack<R: Real>(step: &ConvolutionStep, simd: Simd) -> Packed<R> {
    match step.direction {
        Direction::Forward => conv3d::pack(step, simd),
        Direction::Transposed => conv_transpose3d::pack(step, simd),
    }
}

/// All that a kernel call needs besides its tensors.
pub(super) struct KernelCall<'a, R> {
    pub kernel: &'a Kernel,
    pub packed: Option<&'a Packed<R>>,
    pub calibration: &'a Calibration,
    pub schedule: i64,
    pub scratch: &'a ScratchPool<R>,
}

impl<R: Real> KernelCall<'_, R> {
    /// Runs the kernel on the step's inputs, which `input` gives by number.
    pub(super) fn run<'t>(
        &self,
        input: impl Fn(usize) -> Option<TensorView<'t, R>>,
        output: TensorViewMut<'_, R>,
    ) {
        let Self { kernel, packed, calibration, schedule, scratch } = *self;
        let tables = CalibrationTables { calibration, schedule };
        let wanted = |i: usize| input(i).expect("a plan gives every kernel its inputs");
        match kernel {
            Kernel::BoxEstimate => box_estimate::run(wanted(0), output, tables, scratch),
            Kernel::LogIrradiance => log_irradiance::run(wanted(0), output, tables),
            Kernel::Features { channels, block, lead } => {
                let features = features::Features { channels, block: *block, lead: *lead };
                features.run([wanted(0), wanted(1)], input(2), output, tables, scratch);
            }
            Kernel::Convolution(_) => {
                let packed = packed.expect("convolutions are packed");
                packed.run(wanted(0), input(1), output, scratch);
            }
            Kernel::InverseResponse { exposures } => {
                inverse_response::run(exposures, wanted(0), output, calibration);
            }
            Kernel::Fuse => fuse::run(wanted(0), wanted(1), output),
            Kernel::Blend { block, taps, origin } => {
                let inputs = Inputs { weights: wanted(0), logs: wanted(1), estimate: wanted(2) };
                Blend { block: *block, taps, origin: *origin }.run(inputs, output, scratch);
            }
        }
    }
}

//! The CPU executor: one twin for each kernel, generic over f32 and f64.
//!
//! At f64 it is the oracle that other executors are compared with ([`evaluate`], [`bound`]), at f32 the
//! fallback for machines without a GPU. Kernels are the files named like the shaders; [`CpuExecutor`] runs a
//! plan with them.

mod blend;
pub mod bound;
mod box_estimate;
mod camera;
mod conv3d;
mod conv_transpose3d;
mod convolution;
mod elementary;
mod executor;
mod features;
mod fuse;
mod gemm;
mod inverse_response;
mod log_irradiance;
pub mod probe;
mod real;
mod simd;
mod view;

pub(crate) use camera::{Tone, inverse_response};
pub use executor::{CpuExecutor, Shared};
pub use gemm::peak;
pub use real::Real;
pub use simd::Simd;

use crate::network::{ConvolutionStep, Direction, Kernel, Shape, Tensor};
use crate::sensor::Calibration;
use blend::{Blend, Inputs};
use camera::Camera;
use convolution::Packed;
use view::{ScratchPool, TensorView, TensorViewMut};

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
    let call =
        Call { kernel, packed: packed.as_ref(), calibration, schedule, scratch: &ScratchPool::default() };
    call.run(|i| inputs.get(i).map(TensorView::dense), TensorViewMut::dense(&mut output));
    output
}

/// The packed weights of a convolution.
fn pack<R: Real>(step: &ConvolutionStep, simd: Simd) -> Packed<R> {
    match step.direction {
        Direction::Forward => conv3d::pack(step, simd),
        Direction::Transposed => conv_transpose3d::pack(step, simd),
    }
}

/// All that a kernel call needs besides its tensors.
struct Call<'a, R> {
    kernel: &'a Kernel,
    packed: Option<&'a Packed<R>>,
    calibration: &'a Calibration,
    schedule: i64,
    scratch: &'a ScratchPool<R>,
}

impl<R: Real> Call<'_, R> {
    /// Runs the kernel on the step's inputs, which `input` gives by number.
    fn run<'t>(&self, input: impl Fn(usize) -> Option<TensorView<'t, R>>, output: TensorViewMut<'_, R>) {
        let Self { kernel, packed, calibration, schedule, scratch } = *self;
        let camera = Camera { calibration, schedule };
        let wanted = |i: usize| input(i).expect("a plan gives every kernel its inputs");
        match kernel {
            Kernel::BoxEstimate => box_estimate::run(wanted(0), output, camera, scratch),
            Kernel::LogIrradiance => log_irradiance::run(wanted(0), output, camera),
            Kernel::Features { channels, block, lead } => {
                let features = features::Features { channels, block: *block, lead: *lead };
                features.run([wanted(0), wanted(1)], input(2), output, camera, scratch);
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

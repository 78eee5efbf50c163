//! The CPU executor: one twin for each kernel, generic over f32 and f64.
//!
//! At f64 it is the oracle that other executors are compared with ([`evaluate`], [`bound`]), at f32 the
//! fallback for machines without a GPU. Kernels are the files named like the shaders; [`CpuExecutor`] runs a
//! plan with them.

mod blend;
pub mod bound;
mod box_estimate;
mod calibration;
mod call;
mod conv3d;
mod conv_transpose3d;
mod convolution;
mod convolution_twin;
mod elementary;
mod executor;
mod features;
mod fuse;
mod gemm;
mod inverse_response;
mod log_irradiance;
pub mod probe;
mod real;
mod rounding;
mod simd;
mod twin;
mod view;

pub(crate) use calibration::{Tone, inverse_response};
pub use call::evaluate;
pub use executor::{CpuExecutor, Shared};
pub use gemm::peak;
pub use real::Real;
pub use simd::Simd;

//! The GPU executor: hand-written WGSL on `wgpu`.
//!
//! [`adapters`] lists what there is, [`Gpu::open`] opens one of them, and [`GpuExecutor`] runs a plan on it. The
//! shaders are in `shaders/`, one file per kernel with the name of its CPU twin; [`shader`] makes of them what is
//! compiled.

mod adapter;
mod device;
mod dispatch;
mod error;
mod executor;
mod pipelines;
mod probe;
mod results;
pub mod shader;
mod storage;
mod tune;
mod variant;
mod weights;

pub use adapter::{Adapter, AdapterChoice, adapters};
pub use device::Gpu;
pub use error::GpuError;
pub use executor::{Edit, ExecutorOptions, GpuExecutor};
pub use results::{DeviceFrame, Results};
pub use storage::{TensorFormat, TensorFormats};
pub use variant::Variant;

//! Where a net runs: a GPU, or the CPU executor.

use super::tiles::Limits;
use crate::cpu::CpuExecutor;
use crate::gpu::{AdapterChoice, Gpu, GpuExecutor};
use crate::network::{Executor, Plan};
use crate::sensor::Calibration;
use crate::{Error, Result};

/// What the user asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Request {
    /// A real GPU if there is one, else the CPU executor.
    #[default]
    Auto,
    /// A GPU, software Vulkan included.
    Gpu,
    /// The CPU executor.
    Cpu,
}

/// How numbers are stored on the way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 32 bits.
    #[default]
    F32,
}

/// Where a net runs.
#[derive(Clone)]
pub enum Backend {
    /// On a GPU.
    Gpu(Gpu),
    /// On all cores.
    Cpu,
}

/// What the CPU executor may use for its buffers.
const CPU_BYTES: u64 = 2 << 30;

impl Backend {
    /// The backend that a request gets; `adapter` is a part of an adapter's name.
    pub fn choose(request: Request, adapter: Option<&str>) -> Result<Self> {
        let choice =
            AdapterChoice { substring: adapter.map(str::to_owned), allow_software: request == Request::Gpu };
        match request {
            Request::Cpu if adapter.is_some() => {
                Err(Error::Usage("--adapter names a GPU, but --executor cpu was asked for".into()))
            }
            Request::Cpu => Ok(Self::Cpu),
            // A named adapter must be there; without a name, the absence of a GPU is what `auto` is for.
            Request::Auto if adapter.is_none() => match Gpu::open(&choice) {
                Ok(gpu) => Ok(Self::Gpu(gpu)),
                Err(error) => {
                    tracing::info!("no GPU is used: {error}");
                    Ok(Self::Cpu)
                }
            },
            Request::Auto | Request::Gpu => Ok(Self::Gpu(Gpu::open(&choice)?)),
        }
    }

    /// An executor of `plan`.
    pub fn executor(&self, plan: Plan, calibration: &Calibration) -> Result<Box<dyn Executor>> {
        Ok(match self {
            Self::Gpu(gpu) => Box::new(GpuExecutor::new(gpu, plan, calibration)?),
            Self::Cpu => Box::new(CpuExecutor::<f32>::new(plan, calibration.clone())),
        })
    }

    /// What limits a tile here.
    pub fn limits(&self, side: Option<usize>) -> Limits {
        match self {
            Self::Gpu(gpu) => {
                Limits { buffer: gpu.largest_binding(), total: 4 * gpu.largest_binding(), side }
            }
            Self::Cpu => Limits { buffer: CPU_BYTES, total: CPU_BYTES, side },
        }
    }

    /// Name of the executor: `gpu` or `cpu`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Gpu(_) => "gpu",
            Self::Cpu => "cpu",
        }
    }

    /// Name of the adapter, if there is one.
    pub fn adapter(&self) -> Option<String> {
        match self {
            Self::Gpu(gpu) => Some(gpu.adapter().name.clone()),
            Self::Cpu => None,
        }
    }
}

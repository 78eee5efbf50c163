//! Where a net runs: a GPU, or the CPU executor.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::tiles::Limits;
use crate::cpu::{CpuExecutor, Shared, Simd};
use crate::fingerprint::{Fingerprint, Fingerprinted};
use crate::gpu::{AdapterChoice, ExecutorOptions, Gpu, GpuExecutor};
use crate::network::{Inspect, Plan, Precision};
use crate::sensor::Calibration;
use crate::system::{cache_folder, memory};
use crate::{Error, Result};

/// Where a net is to run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum ExecutorChoice {
    /// A real GPU if there is one, else the CPU
    #[default]
    Auto,
    /// A GPU, software Vulkan included
    Gpu,
    /// The CPU
    Cpu,
}

/// Where a net runs.
#[derive(Clone)]
pub enum Backend {
    /// On a GPU, with feature channels and weights stored at a precision.
    Gpu(Gpu, Precision),
    /// On all cores, at f32.
    Cpu,
}

/// What the CPU executor may use for its buffers at most, and where nobody knows how much memory there is. It takes no
/// more than a quarter of all memory: more makes windows of large frames longer, and saves little.
const CPU_BYTES: u64 = 8 << 30;
const CPU_BYTES_UNKNOWN: u64 = 2 << 30;

/// Bytes that steps leave for the next ones on the CPU, as long as that is a frame: they should stay in the second-level
/// cache (docs/performance.md).
const CPU_PIECE_BYTES: usize = 2 << 20;

/// What the CPU executor may use for its buffers here.
fn cpu_bytes() -> u64 {
    static BYTES: LazyLock<u64> =
        LazyLock::new(|| memory().map_or(CPU_BYTES_UNKNOWN, |bytes| (bytes / 4).min(CPU_BYTES)));
    *BYTES
}

impl Backend {
    /// The backend that a choice gets; `adapter` is a part of an adapter's name. The CPU executor knows f32 alone.
    pub fn choose(executor: ExecutorChoice, adapter: Option<&str>, precision: Precision) -> Result<Self> {
        let choice = AdapterChoice {
            substring: adapter.map(str::to_owned),
            allow_software: executor == ExecutorChoice::Gpu,
        };
        match executor {
            ExecutorChoice::Cpu if adapter.is_some() => {
                Err(Error::Usage("--adapter names a GPU, but --executor cpu was asked for".into()))
            }
            ExecutorChoice::Cpu if precision != Precision::F32 => {
                Err(Error::Usage(format!("the CPU executor has no {}, only f32", precision.name())))
            }
            ExecutorChoice::Cpu => Ok(Self::Cpu),
            // A named adapter must be there; without a name, the absence of a GPU is what `auto` is for.
            ExecutorChoice::Auto if adapter.is_none() => match Gpu::open(&choice) {
                Ok(gpu) => Ok(Self::Gpu(gpu, precision)),
                Err(error) if precision != Precision::F32 => Err(Error::Usage(format!(
                    "{} needs a GPU (--executor gpu takes software Vulkan too): {error}",
                    precision.name()
                ))),
                Err(error) => {
                    tracing::info!("no GPU is used: {error}");
                    Ok(Self::Cpu)
                }
            },
            ExecutorChoice::Auto | ExecutorChoice::Gpu => Ok(Self::Gpu(Gpu::open(&choice)?, precision)),
        }
    }

    /// An executor of `plan`. If it is to be `tuned`, a GPU takes a few seconds, once, to measure how its larger layers
    /// are computed best.
    pub fn executor(&self, plan: Plan, calibration: &Calibration, tuned: bool) -> Result<Box<dyn Inspect>> {
        self.executor_sharing(plan, calibration, tuned, &Shared::default())
    }

    /// The same for one of many sizes of window of a net: what CPU executors of them have in common is `shared`.
    pub(super) fn executor_sharing(
        &self,
        plan: Plan,
        calibration: &Calibration,
        tuned: bool,
        shared: &Shared<f32>,
    ) -> Result<Box<dyn Inspect>> {
        Ok(match self {
            Self::Gpu(gpu, precision) => {
                let folder = cache_folder().filter(|_| tuned);
                let options = ExecutorOptions {
                    precision: *precision,
                    tuned_in: folder.as_deref(),
                    ..ExecutorOptions::default()
                };
                Box::new(GpuExecutor::with_options(gpu, plan, calibration, &options)?)
            }
            Self::Cpu => Box::new(CpuExecutor::sharing(plan, calibration.clone(), shared)),
        })
    }

    /// The same place at another precision; `None` where there is no such executor.
    pub fn at(&self, precision: Precision) -> Option<Self> {
        match self {
            Self::Gpu(gpu, _) => Some(Self::Gpu(gpu.clone(), precision)),
            Self::Cpu => (precision == Precision::F32).then_some(Self::Cpu),
        }
    }

    /// What limits a tile here.
    pub fn limits(&self, side: Option<usize>) -> Limits {
        match self {
            Self::Gpu(gpu, _) => {
                // Pieces are for a processor's cache, and each would be a dispatch of its own.
                Limits { buffer: gpu.largest_binding(), total: 4 * gpu.largest_binding(), piece: None, side }
            }
            Self::Cpu => {
                Limits { buffer: cpu_bytes(), total: cpu_bytes(), piece: Some(CPU_PIECE_BYTES), side }
            }
        }
    }

    /// Name of the executor: `gpu` or `cpu`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Gpu(..) => "gpu",
            Self::Cpu => "cpu",
        }
    }

    /// Name of the adapter, if there is one.
    pub fn adapter(&self) -> Option<String> {
        match self {
            Self::Gpu(gpu, _) => Some(gpu.adapter().name.clone()),
            Self::Cpu => None,
        }
    }

    /// How feature channels and weights are stored.
    pub fn precision(&self) -> Precision {
        match self {
            Self::Gpu(_, precision) => *precision,
            Self::Cpu => Precision::F32,
        }
    }
}

impl Fingerprinted for Backend {
    fn mark(&self, fingerprint: &mut Fingerprint) -> Result<()> {
        fingerprint.note("executor", self.name())?;
        fingerprint.note("precision", self.precision().name())?;
        // Some of what runs beside a GPU is computed on the CPU too.
        fingerprint.note("simd", Simd::widest().name())?;
        let adapter = match self {
            Self::Gpu(gpu, _) => Some(gpu.adapter()),
            Self::Cpu => None,
        };
        fingerprint.note("adapter", adapter.map(|adapter| &adapter.name))?;
        fingerprint.note("driver", adapter.map(|adapter| &adapter.driver))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn f16_is_never_replaced_silently() {
        let refusal = Backend::choose(ExecutorChoice::Cpu, None, Precision::F16).err().unwrap().to_string();
        assert!(refusal.contains("f16") && !refusal.contains('\n'), "{refusal}");
        // Without a real GPU, `auto` would take the CPU executor.
        match Backend::choose(ExecutorChoice::Auto, None, Precision::F16) {
            Ok(backend) => assert_eq!(backend.precision(), Precision::F16),
            Err(error) => assert!(error.to_string().contains("f16 needs a GPU"), "{error}"),
        }
    }
}

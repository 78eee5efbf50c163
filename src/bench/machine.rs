//! The machine that figures are measured on.

use serde::Serialize;

use super::Peak;
use crate::cpu::probe;
use crate::gpu::GpuError;
use crate::synth::Backend;
use crate::system;

/// What a reader of the figures must know of the machine. What the system does not tell is none.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Machine {
    /// Version of this program.
    pub version: &'static str,
    /// Operating system.
    pub os: &'static str,
    /// Instruction set.
    pub arch: &'static str,
    /// Name of the processor.
    pub cpu: Option<String>,
    /// Threads that the CPU executor uses.
    pub cpu_threads: usize,
    /// Bytes of memory.
    pub memory_bytes: Option<u64>,
    /// Measured peaks of everything that was used.
    pub peaks: Vec<ProcessorPeak>,
}

/// What one processor can do at most, measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProcessorPeak {
    /// `gpu` or `cpu`.
    pub executor: &'static str,
    /// Name of the adapter.
    pub adapter: Option<String>,
    /// Operations at f32 in 10⁹ per second.
    pub gflop_per_s: f64,
    /// Copied bytes in 10⁹ per second, those read and those written together.
    pub copy_gbyte_per_s: f64,
}

impl Machine {
    /// This machine, before any peak was measured.
    pub fn here() -> Self {
        let line = |path: &str, key: &str| {
            let text = std::fs::read_to_string(path).ok()?;
            let line = text.lines().find_map(|line| line.strip_prefix(key))?;
            Some(line.trim_start_matches([':', ' ', '\t']).trim().to_owned())
        };
        Self {
            version: system::version(),
            os: std::env::consts::OS,
            arch: std::env::consts::ARCH,
            cpu: line("/proc/cpuinfo", "model name"),
            cpu_threads: rayon::current_num_threads(),
            memory_bytes: system::memory(),
            peaks: Vec::new(),
        }
    }
}

impl Peak {
    /// Measures what a backend's hardware can do, in a second or two.
    pub fn measure(backend: &Backend) -> Result<Self, GpuError> {
        Ok(match backend {
            Backend::Gpu(gpu, _) => {
                Self { flop_rate: gpu.measure_flop_rate()?, copy_rate: gpu.measure_copy_rate()? }
            }
            Backend::Cpu => {
                Self { flop_rate: probe::measure_flop_rate(), copy_rate: probe::measure_copy_rate() }
            }
        })
    }
}

/// Starts a new measurement of the largest memory of this process; false where the system has none (Linux has one).
pub(super) fn reset_peak_memory() -> bool {
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// Largest memory of this process in bytes since [`reset_peak_memory`], shared pages included.
pub(super) fn peak_memory() -> Option<u64> {
    system::status("VmHWM:")
}

/// Processor time of this process in seconds, all threads together (Linux): fields 14 and 15 of /proc/self/stat, in
/// hundredths of a second.
pub(super) fn processor_time() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let ticks = stat.rsplit_once(')')?.1.split_whitespace().skip(11).take(2);
    ticks.map(|field| field.parse::<f64>().ok()).sum::<Option<f64>>().map(|ticks| ticks / 100.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn memory_that_is_used_shows_and_is_forgotten() {
        // Much more than all tests beside this one in the same process.
        const SIZE: usize = 1 << 30;
        assert!(reset_peak_memory());
        let before = peak_memory().unwrap();
        drop(std::hint::black_box(vec![1_u8; SIZE]));
        assert!(peak_memory().unwrap() > before + SIZE as u64 / 2);
        assert!(reset_peak_memory());
        assert!(peak_memory().unwrap() < before + SIZE as u64 / 2);
        assert!(processor_time().unwrap() > 0.0 && Machine::here().memory_bytes.unwrap() > 0);
    }
}

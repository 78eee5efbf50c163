//! Which GPUs there are, and which one to take.

use std::fmt;

use serde::Serialize;
use wgpu::{Backends, DeviceType, Features};

use super::GpuError;

/// What an adapter is and can do.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Adapter {
    /// Name of the device.
    pub name: String,
    /// "vulkan", "metal" or "dx12".
    pub backend: String,
    /// "discrete", "integrated", "virtual", "software" or "other".
    pub device_type: &'static str,
    /// Name and version of the driver.
    pub driver: String,
    /// Bytes of the largest buffer.
    pub max_buffer_bytes: u64,
    /// Bytes of a buffer that a shader can see at once.
    pub max_binding_bytes: u64,
    /// Bytes of memory that a workgroup shares.
    pub max_workgroup_memory_bytes: u32,
    /// Invocations of a workgroup.
    pub max_workgroup_invocations: u32,
    /// Smallest and largest number of invocations that run in step.
    pub subgroup_sizes: [u32; 2],
    /// Whether shaders can compute in f16.
    pub shader_f16: bool,
    /// Whether the time of single steps can be taken.
    pub timestamps: bool,
    /// Whether shaders can exchange values within a subgroup.
    pub subgroups: bool,
}

impl Adapter {
    fn of(adapter: &wgpu::Adapter) -> Self {
        let (info, limits, features) = (adapter.get_info(), adapter.limits(), adapter.features());
        Self {
            name: info.name,
            backend: info.backend.to_string(),
            device_type: match info.device_type {
                DeviceType::DiscreteGpu => "discrete",
                DeviceType::IntegratedGpu => "integrated",
                DeviceType::VirtualGpu => "virtual",
                DeviceType::Cpu => "software",
                DeviceType::Other => "other",
            },
            driver: [info.driver, info.driver_info].join(" ").trim().to_owned(),
            max_buffer_bytes: limits.max_buffer_size,
            max_binding_bytes: limits.max_storage_buffer_binding_size,
            max_workgroup_memory_bytes: limits.max_compute_workgroup_storage_size,
            max_workgroup_invocations: limits.max_compute_invocations_per_workgroup,
            subgroup_sizes: [info.subgroup_min_size, info.subgroup_max_size],
            shader_f16: features.contains(Features::SHADER_F16),
            timestamps: features.contains(Features::TIMESTAMP_QUERY),
            subgroups: features.contains(Features::SUBGROUP),
        }
    }

    /// Whether it is a driver that computes on the CPU.
    pub fn is_software(&self) -> bool {
        self.device_type == "software"
    }

    /// How much it is to be preferred; smaller is better.
    fn rank(&self) -> usize {
        let order = ["discrete", "integrated", "virtual", "other", "software"];
        order.iter().position(|&kind| kind == self.device_type).unwrap_or(order.len())
    }

    fn matches(&self, substring: &str) -> bool {
        let text = format!("{} {} {} {}", self.backend, self.device_type, self.name, self.driver);
        text.to_lowercase().contains(&substring.to_lowercase())
    }
}

impl fmt::Display for Adapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const MIB: u64 = 1 << 20;
        let Self { name, backend, device_type, driver, subgroup_sizes: [smallest, largest], .. } = self;
        write!(f, "{backend}: {name} ({device_type}, {driver})")?;
        write!(
            f,
            "; buffers to {} MiB, bindings to {} MiB",
            self.max_buffer_bytes / MIB,
            self.max_binding_bytes / MIB
        )?;
        write!(f, "; subgroups of {smallest}")?;
        if smallest != largest {
            write!(f, " to {largest}")?;
        }
        let features = [
            (self.shader_f16, "f16"),
            (self.timestamps, "timestamps"),
            (self.subgroups, "subgroup operations"),
        ];
        for (_, feature) in features.iter().filter(|(there, _)| *there) {
            write!(f, ", {feature}")?;
        }
        Ok(())
    }
}

/// Which adapter is wanted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AdapterChoice {
    /// A part of its name, driver, backend or type, in any case.
    pub substring: Option<String>,
    /// Whether software Vulkan may be taken where there is no real GPU, or none that matches. Naming it allows it
    /// too.
    pub allow_software: bool,
}

impl AdapterChoice {
    /// The number of the adapter to take: the best real GPU that matches, or software where that is allowed.
    fn pick(&self, adapters: &[Adapter]) -> Result<usize, GpuError> {
        let allow_software = self.allow_software || self.substring.is_some();
        let matches = |adapter: &Adapter| self.substring.as_ref().is_none_or(|s| adapter.matches(s));
        let candidates = adapters.iter().enumerate().filter(|(_, adapter)| matches(adapter));
        let allowed = candidates.filter(|(_, adapter)| allow_software || !adapter.is_software());
        if let Some((index, _)) = allowed.min_by_key(|(_, adapter)| adapter.rank()) {
            return Ok(index);
        }
        let problem = match (&self.substring, adapters) {
            (_, []) => "no GPU adapter; install a Vulkan driver for your GPU or the software driver \
                        (Debian and Ubuntu: mesa-vulkan-drivers), or use the CPU executor"
                .to_owned(),
            (Some(substring), _) => {
                let names: Vec<_> = adapters.iter().map(|a| format!("{} ({})", a.name, a.backend)).collect();
                format!("no GPU adapter matches '{substring}'; there are {}", names.join(", "))
            }
            (None, [software, ..]) => format!(
                "no GPU adapter but software Vulkan ({}), which is used only when asked for by name; or use \
                 the CPU executor",
                software.name
            ),
        };
        Err(GpuError::NoAdapter(problem))
    }

    /// Finds the adapter, with the instance that it belongs to.
    pub(super) fn find(&self) -> Result<(wgpu::Instance, wgpu::Adapter, Adapter), GpuError> {
        let (instance, mut found) = enumerate();
        let mut adapters: Vec<Adapter> = found.iter().map(Adapter::of).collect();
        let index = self.pick(&adapters)?;
        Ok((instance, found.swap_remove(index), adapters.swap_remove(index)))
    }
}

/// All adapters of all backends.
pub fn adapters() -> Vec<Adapter> {
    enumerate().1.iter().map(Adapter::of).collect()
}

fn enumerate() -> (wgpu::Instance, Vec<wgpu::Adapter>) {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle().with_env();
    // A driver that over-commits memory aborts the process where memory ends; wgpu reports an error before.
    descriptor.memory_budget_thresholds.for_resource_creation = Some(MEMORY_PERCENT);
    let instance = wgpu::Instance::new(descriptor);
    let adapters = pollster::block_on(instance.enumerate_adapters(Backends::PRIMARY));
    (instance, adapters)
}

/// Share of the memory budget that buffers may take up.
const MEMORY_PERCENT: u8 = 95;

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(name: &str, device_type: &'static str) -> Adapter {
        Adapter {
            name: name.into(),
            backend: "vulkan".into(),
            device_type,
            driver: "driver 1".into(),
            max_buffer_bytes: 1 << 30,
            max_binding_bytes: 1 << 27,
            max_workgroup_memory_bytes: 1 << 15,
            max_workgroup_invocations: 1024,
            subgroup_sizes: [32, 32],
            shader_f16: true,
            timestamps: true,
            subgroups: true,
        }
    }

    fn pick(choice: (Option<&str>, bool), adapters: &[Adapter]) -> Result<usize, String> {
        let choice = AdapterChoice { substring: choice.0.map(str::to_owned), allow_software: choice.1 };
        choice.pick(adapters).map_err(|error| error.to_string())
    }

    #[test]
    fn a_real_gpu_comes_first() {
        let adapters =
            [adapter("llvmpipe", "software"), adapter("Small", "integrated"), adapter("Large", "discrete")];
        assert_eq!(pick((None, false), &adapters), Ok(2));
        assert_eq!(pick((None, true), &adapters), Ok(2));
        assert_eq!(pick((Some("SMALL"), false), &adapters), Ok(1));
        assert_eq!(pick((Some("vulkan"), false), &adapters), Ok(2));
    }

    #[test]
    fn software_is_taken_only_when_asked_for() {
        let adapters = [adapter("llvmpipe", "software")];
        let refusal = pick((None, false), &adapters).unwrap_err();
        assert!(refusal.contains("llvmpipe") && refusal.contains("asked for"), "{refusal}");
        assert_eq!(pick((Some("LLVM"), false), &adapters), Ok(0));
        assert_eq!(pick((None, true), &adapters), Ok(0));
    }

    #[test]
    fn refusals_say_what_can_be_done() {
        let none = pick((None, true), &[]).unwrap_err();
        assert!(none.contains("mesa-vulkan-drivers") && none.contains("CPU executor"), "{none}");
        let other = pick((Some("radeon"), true), &[adapter("llvmpipe", "software")]).unwrap_err();
        assert!(other.contains("'radeon'") && other.contains("llvmpipe"), "{other}");
    }
}

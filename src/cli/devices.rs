//! `pix2hdr devices`: what adapters there are.

use crate::Result;
use crate::gpu;
use clap::Args;
use serde_json::json;

use super::terminal;

/// Lists the GPU adapters and what they can do
#[derive(Args)]
pub struct Devices {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Devices {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        let adapters = gpu::adapters();
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let report = json!({ "cpu_threads": threads, "adapters": adapters });
        terminal::result(self.json, &report, || {
            let mut text = format!("cpu: {threads} threads");
            for a in &adapters {
                let can = [("f16", a.shader_f16), ("timestamps", a.timestamps), ("subgroups", a.subgroups)];
                let can: Vec<&str> = can.iter().filter(|(_, has)| *has).map(|(name, _)| *name).collect();
                text += &format!(
                    "\n{}: {} ({}; {})\n    buffers up to {} MiB; {}",
                    a.backend,
                    a.name,
                    a.device_type,
                    a.driver,
                    a.max_binding_bytes >> 20,
                    can.join(", ")
                );
            }
            if adapters.is_empty() {
                text +=
                    "\nno GPU adapter: install its Vulkan driver, or mesa-vulkan-drivers for software Vulkan";
            }
            text
        })
    }
}

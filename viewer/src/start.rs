//! How the viewer is started.

use std::path::PathBuf;

use crate::preferences::Preferences;
use crate::source::{Opening, SourceName};
use pix2hdr::gpu::Gpu;
use pix2hdr::synth::Settings;
use pix2hdr::synth::{self, Backend};
use pix2hdr::{Error, Result};

/// Which wgpu device draws the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WindowDevice {
    /// A real GPU that synthesises draws as well. Where software stands for a GPU, the window has a device of its own:
    /// in one queue every pass would wait for windows of synthesis.
    #[default]
    Auto,
    /// The one that synthesises, of whatever kind.
    Shared,
    /// One of its own.
    Own,
}

/// How the viewer is started.
#[derive(Clone, Debug)]
pub struct Start {
    /// What is shown first.
    pub source: SourceName,
    /// How sources are opened.
    pub opening: Opening,
    /// The engine's settings.
    pub settings: Settings,
    /// Where files are written.
    pub out: PathBuf,
    /// Where preferences are kept, if anywhere.
    pub preferences: Option<PathBuf>,
    /// Frames per second, in place of the remembered rate.
    pub rate: Option<f64>,
    /// End after so many seconds.
    pub seconds: Option<f64>,
    /// What draws the window.
    pub device: WindowDevice,
}

impl Start {
    /// What is remembered from last time.
    pub(crate) fn preferences(&self) -> Preferences {
        self.preferences.as_ref().map_or_else(Preferences::default, |path| Preferences::read(path))
    }

    /// The GPU that synthesises and draws the window, if one is to do both.
    pub(crate) fn shared_gpu(&self, settings: &Settings) -> Result<Option<Gpu>> {
        if self.device == WindowDevice::Own
            || settings.executor == synth::ExecutorChoice::Cpu && self.device == WindowDevice::Auto
        {
            return Ok(None);
        }
        match (Backend::choose(settings.executor, settings.adapter.as_deref(), settings.precision), self.device) {
            (Ok(Backend::Gpu(gpu, _)), device)
                if device == WindowDevice::Shared || !gpu.adapter().is_software() =>
            {
                Ok(Some(gpu.shared()))
            }
            (Ok(Backend::Cpu), WindowDevice::Shared) => Err(Error::Usage(
                "no GPU synthesises, so none can be shared with the window; --executor gpu takes software Vulkan too"
                    .into(),
            )),
            (Err(error), WindowDevice::Shared) => Err(error),
            // What is wrong with the choice is said in the window.
            _ => Ok(None),
        }
    }
}

//! The table of shaders: all files, and what the kernels among them read and write.

/// What a binding behind the output of a kernel holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resource {
    /// Packed weights of the step.
    Weights,
    /// Units, bias, scale and shift of the step (`weights::Terms`).
    Terms,
    /// The largest magnitude that did not fit the step's output, as the bits of an f32.
    Overflow,
    /// Exposures of the step's channels.
    RenderedExposures,
}
use Resource::{Overflow, RenderedExposures, Terms, Weights};

/// A kernel's shader. Group 0 is what all of them share (`common/calibration.wgsl`); the bindings of group 1 are the
/// geometry, the inputs, the output, and the resources, in this order.
#[derive(Debug)]
pub struct KernelShader {
    /// Name of the kernel and of the CPU twin; the file is `NAME.wgsl`.
    pub name: &'static str,
    /// Names of the inputs. Those at the end may be missing from a step; the first stands in for them.
    pub inputs: &'static [&'static str],
    /// Bindings behind the output.
    pub resources: &'static [Resource],
}

/// All kernels.
#[rustfmt::skip]
static KERNELS: [KernelShader; 8] = [
    KernelShader { name: "box_estimate", inputs: &["measurement"], resources: &[] },
    KernelShader { name: "log_irradiance", inputs: &["measurement"], resources: &[] },
    KernelShader { name: "features", inputs: &["measurement", "estimate", "logs"], resources: &[] },
    KernelShader { name: "conv3d", inputs: &["input", "added"], resources: &[Weights, Terms, Overflow] },
    KernelShader { name: "conv_transpose3d", inputs: &["input", "added"], resources: &[Weights, Terms, Overflow] },
    KernelShader { name: "inverse_response", inputs: &["input"], resources: &[RenderedExposures] },
    KernelShader { name: "fuse", inputs: &["weights", "rendered"], resources: &[] },
    KernelShader { name: "blend", inputs: &["weights", "logs", "estimate"], resources: &[] },
];

impl KernelShader {
    /// The file.
    pub fn source(&self) -> ShaderFile {
        file(&format!("{}.wgsl", self.name))
    }
}

/// The shader of a kernel.
pub fn kernel(name: &str) -> &'static KernelShader {
    let shader = KERNELS.iter().find(|shader| shader.name == name);
    shader.unwrap_or_else(|| panic!("kernel {name} has no line in the table of shaders"))
}

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(ShaderFile {
            path: concat!("shaders/", $name),
            text: include_str!(concat!("../../../shaders/", $name)),
        }),*]
    };
}

/// A file.
#[derive(Clone, Copy, Debug)]
pub struct ShaderFile {
    /// Path within the repository.
    pub path: &'static str,
    /// What stands in it.
    pub text: &'static str,
}

/// All files of this package.
pub static FILES: &[ShaderFile] = files![
    "blend.wgsl",
    "box_estimate.wgsl",
    "common/activation.wgsl",
    "common/calibration.wgsl",
    "common/convolution.wgsl",
    "common/dispatch.wgsl",
    "common/stored_f16.wgsl",
    "common/stored_f16_wide.wgsl",
    "common/stored_f32.wgsl",
    "common/stored_f32_wide.wgsl",
    "common/tone.wgsl",
    "conv3d.wgsl",
    "conv_transpose3d.wgsl",
    "features.wgsl",
    "fuse.wgsl",
    "inverse_response.wgsl",
    "log_irradiance.wgsl",
    "probe_copy.wgsl",
    "probe_fma.wgsl",
];

/// A file by its path within `shaders/`.
pub fn file(path: &str) -> ShaderFile {
    let file = FILES.iter().find(|file| file.path.strip_prefix("shaders/") == Some(path));
    *file.unwrap_or_else(|| panic!("shaders/{path} is not in the table of shaders"))
}

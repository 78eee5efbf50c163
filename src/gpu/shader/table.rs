//! The table of shaders: all files.

use crate::network::for_each_operation;

/// A file.
#[derive(Clone, Copy, Debug)]
pub struct ShaderFile {
    /// Path within the repository.
    pub path: &'static str,
    /// What stands in it.
    pub text: &'static str,
}

macro_rules! file {
    ($name:expr) => {
        ShaderFile {
            path: concat!("shaders/", $name, ".wgsl"),
            text: include_str!(concat!("../../../shaders/", $name, ".wgsl")),
        }
    };
}

macro_rules! kernels {
    (computed: { $($name:ident: $Op:ident,)* } placed: $placed:tt) => {
        &[$(file!(stringify!($name))),*]
    };
}

/// A file for each kernel.
static KERNELS: &[ShaderFile] = for_each_operation!(kernels);

/// All others of this package.
static OTHERS: &[ShaderFile] = &[
    file!("common/activation"),
    file!("common/calibration"),
    file!("common/convolution"),
    file!("common/dispatch"),
    file!("common/pixelwise"),
    file!("common/stored_f16"),
    file!("common/stored_f16_wide"),
    file!("common/stored_f32"),
    file!("common/stored_f32_wide"),
    file!("common/tone"),
    file!("probe_copy"),
    file!("probe_fma"),
];

/// All files of this package.
pub fn files() -> impl Iterator<Item = ShaderFile> {
    KERNELS.iter().chain(OTHERS).copied()
}

/// A file by its path within `shaders/`.
pub fn file(path: &str) -> ShaderFile {
    let file = files().find(|file| file.path.strip_prefix("shaders/") == Some(path));
    file.unwrap_or_else(|| panic!("shaders/{path} is not in the table of shaders"))
}

//! What can go wrong with a GPU.

/// What can go wrong with a GPU.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter fits the request. The text says what can be done.
    #[error("{0}")]
    NoAdapter(String),
    /// The driver refused to open an adapter.
    #[error("cannot open {adapter}: {problem}")]
    Open {
        /// The adapter's name.
        adapter: String,
        /// What the driver says.
        problem: String,
    },
    /// There is not enough memory.
    #[error("out of GPU memory: {bytes} bytes for {what}; smaller tiles or windows need less")]
    OutOfMemory {
        /// What the memory is for.
        what: String,
        /// How much was asked for.
        bytes: u64,
    },
    /// A buffer is larger than the adapter allows.
    #[error("{what} needs {bytes} bytes, the adapter allows {limit}; smaller tiles need less")]
    TooLarge {
        /// What the buffer is for.
        what: String,
        /// How much was asked for.
        bytes: u64,
        /// How much is allowed.
        limit: u64,
    },
    /// A shader was refused.
    #[error("shader of '{step}': {problem}")]
    Shader {
        /// The step of the plan.
        step: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A number is too large for the precision that was asked for.
    #[error("f16 cannot hold {value} of '{step}'; use --precision f32")]
    Overflow {
        /// The step of the plan.
        step: String,
        /// The number.
        value: String,
    },
    /// The device is gone: driver reset, unplugged, or hung.
    #[error("the GPU was lost: {0}")]
    Lost(String),
    /// Any other failure that the driver or `wgpu` reports.
    #[error("the GPU failed: {0}")]
    Failed(String),
}

impl crate::error::ModuleError for GpuError {}

impl GpuError {
    /// Whether the device is gone.
    pub fn is_lost(&self) -> bool {
        matches!(self, Self::Lost(_))
    }
}

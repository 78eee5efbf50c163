//! The GPU executor: hand-written WGSL on `wgpu`.

/// What can go wrong with a GPU.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter fits the request.
    #[error("{0}")]
    NoAdapter(String),
}

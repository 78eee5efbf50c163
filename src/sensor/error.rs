//! What can be wrong with a pattern, a response or a capture.

use crate::error::ModuleError;

/// What can be wrong with a pattern, a response or a capture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SensorError {
    /// The pattern cannot be used.
    #[error("pattern: {0}")]
    Pattern(String),
    /// The response cannot be used.
    #[error("response: {0}")]
    Response(String),
    /// The capture cannot be used.
    #[error("capture: {0}")]
    Capture(String),
}

impl ModuleError for SensorError {}

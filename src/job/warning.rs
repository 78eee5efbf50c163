//! What a user should know, though the job can be done.

use std::path::PathBuf;

/// What a user should know, though the job can be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Warning {
    /// The net was trained for another response.
    #[error("{0}")]
    Response(String),
    /// Another process could write the same result.
    #[error("{}: cannot be locked ({error}); let nobody else write it", path.display())]
    Unlocked {
        /// The note of the result.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
}

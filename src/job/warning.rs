//! What a user should know, though the job can be done.

use std::path::PathBuf;

use crate::Result;
use crate::math::spread;
use crate::sensor::{CaptureFile, check_exposure_ratio, check_levels};

/// Frames of a recording that are looked at: static parts stay static.
const LOOKS: usize = 16;

/// What a user should know, though the job can be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Warning {
    /// Black and white level seem to be wrong.
    #[error("{0}")]
    Levels(String),
    /// Pixel values do not scale with exposure.
    #[error("{0}")]
    Exposure(String),
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

/// What a look at some frames of a recording makes one doubt: levels, and how values scale with exposure.
pub fn warnings(file: &mut CaptureFile) -> Result<Vec<Warning>> {
    let excerpt = file.excerpt(&spread(file.frames, LOOKS).collect::<Vec<_>>())?;
    let exposure = check_exposure_ratio(&excerpt).and_then(|check| check.warning());
    let levels = check_levels(&excerpt).map(Warning::Levels);
    Ok(levels.into_iter().chain(exposure.map(Warning::Exposure)).collect())
}

//! How videos are written.

use crate::{At, Error, Result};
use std::fs;
use std::path::Path;

use crate::fingerprint::{Fingerprint, Fingerprinted};

/// How a video is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Writing {
    /// Half instead of single precision; values above 65504 become 65504.
    pub half: bool,
    /// Whether what is there already is replaced: a file, or a folder of pictures.
    pub overwrite: bool,
    /// Duration of a frame, noted in EXR files.
    pub frame_period_ms: Option<f64>,
    /// What p = 1 stands for, noted in EXR files.
    pub anchor: Option<f32>,
}

impl Default for Writing {
    fn default() -> Self {
        Self { half: true, overwrite: false, frame_period_ms: None, anchor: None }
    }
}

impl Writing {
    /// The part of it that concerns each picture.
    pub(super) fn plane(self) -> PlaneWriting {
        let Self { half, frame_period_ms, anchor, .. } = self;
        PlaneWriting { half, frame_period_ms, anchor }
    }
}

impl Fingerprinted for Writing {
    /// All but whether something is replaced.
    fn mark(&self, fingerprint: &mut Fingerprint) -> Result<()> {
        fingerprint.note("half", self.half)?;
        fingerprint.note("frame_period_ms", self.frame_period_ms)?;
        fingerprint.note("anchor", self.anchor)
    }
}

/// Refuses a file that is there, unless it may be replaced. A link is there whatever it leads to.
pub fn check_free(path: &Path, overwrite: bool) -> Result<()> {
    if fs::symlink_metadata(path).is_ok() && !overwrite {
        let problem = "is already there; --overwrite replaces it, or name another place";
        return Err(Error::Usage(problem.into())).at(path);
    }
    Ok(())
}

/// How a plane is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneWriting {
    /// Half instead of single precision; values above 65504 become 65504.
    pub half: bool,
    /// Duration of a frame, as the standard attribute `framesPerSecond`.
    pub frame_period_ms: Option<f64>,
    /// What p = 1 stands for, as the attribute `anchor`.
    pub anchor: Option<f32>,
}

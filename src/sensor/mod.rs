//! The camera: patterns of exposures, response, noise, and the captures that they make.

mod calibration;
mod capture;
mod defects;
mod fit_response;
mod importer;
mod pattern;
mod readouts;
mod recording;
mod response;
mod sampler;
mod symmetry;

use std::fs::File;
use std::io::Read;
use std::path::Path;

pub use calibration::Calibration;
pub use capture::{Capture, CaptureInfo, PatternSource, ResponseSource, Timing};
pub use defects::Defects;
pub use fit_response::{ResponseFit, fit_response};
pub use importer::{RatioCheck, check_exposure_ratio, check_levels, hold_to_covering};
pub use pattern::{Pattern, Readout, Schedule, Shutter};
pub use readouts::Readouts;
pub use recording::{CaptureFile, FrameSource, Recording};
pub use response::{Form, Response};
pub use sampler::{Noise, Sampler};
pub use symmetry::Symmetry;

/// Most bytes of a text file that is read: a bound on what a hostile one can make us allocate.
const MAX_TEXT: u64 = 16 << 20;

/// The whole of a text file.
fn read_text(path: &Path) -> std::io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(MAX_TEXT + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MAX_TEXT {
        let problem = format!("more than the {MAX_TEXT} bytes that a text file may have");
        return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, problem));
    }
    Ok(text)
}

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

impl crate::error::ModuleError for SensorError {}

//! The camera: patterns of exposures, response, noise, and the captures that they make.

mod calibration;
mod capture;
mod fit_response;
mod importer;
mod pattern;
mod recording;
mod response;
mod sampler;

pub use calibration::Calibration;
pub use capture::{Capture, CaptureInfo, PatternSource, ResponseSource, Timing};
pub use fit_response::{ResponseFit, fit_response};
pub use importer::{RatioCheck, check_exposure_ratio, hold_to_covering};
pub use pattern::{Cell, Pattern, Readout, Shutter};
pub use recording::{CaptureFile, FrameSource, Recording};
pub use response::{Form, Response};
pub use sampler::{Noise, Sampler};

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

//! The camera: patterns of exposures, response, noise, and the captures that they make.

mod calibration;
mod camera_model;
mod capture;
mod capture_file;
mod covering;
mod defects;
mod description;
mod error;
mod fit_response;
mod importer;
mod pattern;
mod readouts;
mod recording;
mod response;
mod sampler;
mod symmetry;
mod text;

pub use calibration::Calibration;
pub use camera_model::CameraModel;
pub use capture::Capture;
pub use capture_file::CaptureFile;
pub use covering::hold_to_covering;
pub use defects::Defects;
pub use description::{CaptureInfo, PatternSpec, ResponseSpec, Timing};
pub use error::SensorError;
pub use fit_response::{ResponseFit, fit_response};
pub use importer::{Imported, Importing, RatioCheck, check_exposure_ratio, check_levels, import};
pub use pattern::{Pattern, Readout, Schedule, Shutter};
pub use readouts::Readouts;
pub use recording::{Recording, Source};
pub use response::{Form, Response};
pub use sampler::{Noise, Sampler};
pub use symmetry::Symmetry;

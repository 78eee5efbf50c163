//! Recordings frame by frame: what a file, a capture in memory or a live camera delivers.

use std::path::Path;

use super::defects::Defects;
use super::{Calibration, CaptureInfo, Pattern, Response, SensorError};
use crate::Result;
use crate::frame::{Extent, Frame};

/// What is known of a recording before its frames. [`Recording::new`] makes it, which checks that it fits together.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Recording {
    /// What the file says about it.
    pub info: CaptureInfo,
    /// When each pixel of a frame integrates.
    pub pattern: Pattern,
    /// From exposure to pixel value; saturates at the pattern's shortest exposure.
    pub response: Response,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Pixels and read-outs without a value, which are filled.
    pub defects: Option<Defects>,
}

/// Where frames come from, one after the other.
pub trait Source: Send {
    /// What is known of the recording.
    fn recording(&self) -> &Recording;

    /// How many frames there are in all; nothing where nobody knows, as of a live camera.
    fn frames(&self) -> Option<usize>;

    /// The next frame, at schedule times that follow each other; nothing behind the last one. Its values are pixel values
    /// y in [0, 1], each of the exposure that covers the frame ([`Timing::Covering`]).
    fn next(&mut self) -> Result<Option<Frame>>;
}

impl Recording {
    /// Interprets `info` for frames of [rows, columns]; a response in a CSV file is looked for in `folder`.
    pub fn new(mut info: CaptureInfo, [height, width]: [usize; 2], folder: Option<&Path>) -> Result<Self> {
        let pattern = info.shown_pattern()?;
        let response = Response::new(info.response.form(folder)?, pattern.shortest_exposure() as f64)?;
        let fail = |problem: String| Err(SensorError::Capture(problem).into());
        if height < pattern.rows() || width < pattern.cols() {
            return fail(format!(
                "{height}×{width} pixels are fewer than the {}×{} of the pattern's tile",
                pattern.rows(),
                pattern.cols()
            ));
        }
        let CaptureInfo { bit_depth, black_level, white_level, frame_period_ms, .. } = info;
        if !(1..=16).contains(&bit_depth) {
            return fail(format!("a bit depth of {bit_depth}"));
        }
        // Less than a count apart, levels say nothing; too far apart, every pixel is black.
        if !(1.0..=1e9).contains(&(white_level - black_level)) {
            return fail(format!("black level {black_level} is not below white level {white_level}"));
        }
        let CaptureInfo { full_well_e, read_noise_e, anchor, .. } = info;
        for (key, value, least) in [
            ("full_well_e", full_well_e, f64::MIN_POSITIVE),
            ("read_noise_e", read_noise_e, 0.0),
            ("anchor", anchor, f64::from(f32::MIN_POSITIVE)),
        ] {
            if value.is_some_and(|value| !(least..=f64::from(f32::MAX)).contains(&value)) {
                return fail(format!("{key} of {}", value.unwrap_or_default()));
            }
        }
        if !(frame_period_ms.is_finite() && frame_period_ms > 0.0) {
            return fail(format!("a frame period of {frame_period_ms} ms"));
        }
        if info.schedule_start.unsigned_abs() > 1 << 40 {
            return fail(format!("a schedule start of {}", info.schedule_start));
        }
        let defects = info.defects(&pattern, [height, width])?;
        Ok(Self { info, pattern, response, height, width, defects })
    }

    /// Rows and columns.
    pub fn extent(&self) -> Extent {
        Extent { height: self.height, width: self.width }
    }

    /// Tables for the kernels.
    pub fn calibration(&self) -> Calibration {
        Calibration::placed(&self.pattern, self.info.placement(), &self.response)
    }

    /// When each pixel of the sensor integrates: what a net was made for.
    pub fn sensor_pattern(&self) -> Pattern {
        self.info.placement().on_sensor(&self.pattern)
    }
}

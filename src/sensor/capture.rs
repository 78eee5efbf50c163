//! Captures: the read-outs of one recording with what is needed to interpret them (design §8).

use std::path::{Path, PathBuf};

use super::{Calibration, CaptureInfo, Orientation, Pattern, Recording, Response, ResponseSpec, SensorError};
use crate::Result;
use crate::video::npy::write_counts;
use crate::video::{Counts, Video, atomic};

/// Name of the array that is written into a capture folder. One of another format that holds counts is read too.
pub(super) const ARRAY: &str = "capture.npy";

/// The file that describes an array of counts.
pub(super) fn described_in(array: &Path) -> PathBuf {
    array.with_extension("json")
}

/// A recording, ready to be interpreted. [`Capture::new`] makes it, which checks that it fits together.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Capture {
    /// What the file says about it.
    pub info: CaptureInfo,
    /// When each pixel of a frame integrates.
    pub pattern: Pattern,
    /// From exposure to pixel value; saturates at the pattern's shortest exposure.
    pub response: Response,
    /// Number of frames.
    pub frames: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Counts, [t, y, x].
    pub counts: Counts,
}

impl Capture {
    /// A capture of extents [t, y, x]; a response in a CSV file is looked for in `folder`.
    pub fn new(info: CaptureInfo, extent: [usize; 3], counts: Counts, folder: Option<&Path>) -> Result<Self> {
        let [frames, height, width] = extent;
        let Recording { info, pattern, response, .. } = Recording::new(info, [height, width], folder)?;
        if counts.is_empty() || counts.len() != frames * height * width {
            let problem = format!("{} values for {frames}×{height}×{width}", counts.len());
            return Err(SensorError::Capture(problem).into());
        }
        Ok(Self { info, pattern, response, frames, height, width, counts })
    }

    /// What is known of it besides its frames.
    pub fn recording(&self) -> Recording {
        let extent = [self.height, self.width];
        Recording {
            defects: self.info.defects(&self.pattern, extent).expect("they were checked when it was made"),
            info: self.info.clone(),
            pattern: self.pattern.clone(),
            response: self.response.clone(),
            height: self.height,
            width: self.width,
        }
    }

    /// What of the same recording a camera shows that is turned and delivers a rectangle of [rows, columns] from `at` on.
    /// Frames have to be the sensor's, and to end with its pattern's tile.
    pub fn shown(&self, orientation: Orientation, at: [usize; 2], size: [usize; 2]) -> Result<Self> {
        let turned = Orientation::turned([self.height, self.width], orientation.transposes());
        let (len, whole) = (size[0] * size[1], self.height * self.width);
        let places = (0..self.frames * len).map(|i| {
            let [row, col] = [at[0] + i % len / size[1], at[1] + i % size[1]];
            let [y, x] = orientation.sensor_place(turned, [row, col]);
            i / len * whole + y * self.width + x
        });
        let counts = self.counts.gather(places);
        let info = CaptureInfo { tile_origin: at, orientation, ..self.info.clone() };
        Self::new(info, [self.frames, size[0], size[1]], counts, None)
    }

    /// Writes `capture.npy` and `capture.json` into `folder`. Returns their paths.
    pub fn write(&self, folder: impl AsRef<Path>) -> Result<[PathBuf; 2]> {
        let [array, json] = Self::files(folder);
        write_counts(&array, &[self.frames, self.height, self.width], &self.counts)?;
        self.write_description(&json)?;
        Ok([array, json])
    }

    /// Writes the file that describes the counts.
    pub(super) fn write_description(&self, json: &Path) -> Result<()> {
        // A response from a file travels inside, so that the capture is complete.
        let info =
            CaptureInfo { response: ResponseSpec::Form(self.response.form().clone()), ..self.info.clone() };
        let mut text =
            serde_json::to_string_pretty(&info).map_err(|e| SensorError::Capture(e.to_string()))?;
        text.push('\n');
        atomic::write_bytes(json, text.as_bytes())
    }

    /// What [`Capture::write`] writes into a folder: counts and description.
    pub fn files(folder: impl AsRef<Path>) -> [PathBuf; 2] {
        let array = folder.as_ref().join(ARRAY);
        let json = described_in(&array);
        [array, json]
    }

    /// Tables for the kernels.
    pub fn calibration(&self) -> Calibration {
        Calibration::placed(&self.pattern, self.info.placement(), &self.response)
    }

    /// Pixel values y in [0, 1] of frame `t`, [y, x], as they stand in the capture: its defects too.
    pub fn pixel_values(&self, t: usize, values: &mut [f32]) {
        let len = self.height * self.width;
        self.info.pixel_values(&self.counts.range(t * len..(t + 1) * len), None, values, None);
    }

    /// Pixel values y in [0, 1] of all frames, as they stand in the capture.
    pub fn measurement(&self) -> Video {
        let mut video = Video::black(self.frames, self.height, self.width);
        for t in 0..self.frames {
            self.pixel_values(t, video.frame_mut(t));
        }
        video
    }
}

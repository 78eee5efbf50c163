//! Captures: the read-outs of one recording with what is needed to interpret them (design §8).

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::defects::Defects;
use super::pattern::PatternTile;
use super::{Calibration, CaptureFile, Form, Pattern, Recording, Response, SensorError};
use crate::Result;
use crate::video::npy::{Counts, read_counts, write_counts};
use crate::video::{Video, atomic};

/// Name of the array in a capture folder.
pub(super) const ARRAY: &str = "capture.npy";

/// What each frame of a capture holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Timing {
    /// The value of the exposure that covers the frame.
    Covering,
    /// The last finished read-out, as a live camera delivers it.
    Hold,
}

/// `capture.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureInfo {
    /// When each pixel integrates.
    pub pattern: PatternSource,
    /// What each frame holds.
    #[serde(default = "covering")]
    pub timing: Timing,
    /// Schedule time of the first frame.
    #[serde(default)]
    pub schedule_start: i64,
    /// Bits that carry information.
    pub bit_depth: u32,
    /// Count at y = 0.
    #[serde(default)]
    pub black_level: f64,
    /// Count at y = 1.
    pub white_level: f64,
    /// Duration of a frame in milliseconds.
    #[serde(default = "one")]
    pub frame_period_ms: f64,
    /// Response curve.
    #[serde(default = "linear")]
    pub response: ResponseSource,
    /// Electrons at y = 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub full_well_e: Option<f64>,
    /// Read noise in electrons rms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_e: Option<f64>,
    /// What p = 1 stands for, in the source's units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<f64>,
    /// Dead and hot pixels as (row, column): their counts are not used.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dead_pixels: Vec<[usize; 2]>,
    /// Count that stands for a read-out that is missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing_count: Option<u16>,
}

impl CaptureInfo {
    /// Its defects in frames of [rows, columns], if it has any.
    pub(super) fn defects(
        &self,
        pattern: &Pattern,
        extent: [usize; 2],
    ) -> Result<Option<Defects>, SensorError> {
        if self.dead_pixels.is_empty() && self.missing_count.is_none() {
            return Ok(None);
        }
        Defects::new(pattern, extent, &self.dead_pixels, self.missing_count).map(Some)
    }

    /// Pixel values y in [0, 1] of a frame's counts, with its defects filled; `before` are those of the frame before.
    pub(super) fn pixel_values(
        &self,
        counts: &Counts,
        defects: Option<&Defects>,
        values: &mut [f32],
        before: Option<&[f32]>,
    ) {
        match counts {
            Counts::U8(counts) => self.scaled(counts, values),
            Counts::U16(counts) => self.scaled(counts, values),
        }
        match (defects, counts) {
            (Some(defects), Counts::U8(counts)) => defects.fill(counts, values, before),
            (Some(defects), Counts::U16(counts)) => defects.fill(counts, values, before),
            (None, _) => {}
        }
    }

    fn scaled<C: Copy + Into<f64>>(&self, counts: &[C], values: &mut [f32]) {
        let black = self.black_level;
        let scale = 1.0 / (self.white_level - black);
        for (value, &count) in values.iter_mut().zip(counts) {
            *value = ((count.into() - black) * scale).clamp(0.0, 1.0) as f32;
        }
    }
}

fn covering() -> Timing {
    Timing::Covering
}
fn one() -> f64 {
    1.0
}
fn linear() -> ResponseSource {
    ResponseSource::Form(Form::Linear)
}

/// A pattern by name or as a tile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PatternSource {
    /// Built-in name.
    Name(String),
    /// The tile itself.
    Tile(PatternTile),
}

impl PatternSource {
    /// The shortest way to name `pattern`.
    pub fn of(pattern: &Pattern) -> Self {
        match Pattern::built_in(pattern.name()) {
            Ok(built_in) if built_in == *pattern => Self::Name(pattern.name().to_owned()),
            _ => Self::Tile(PatternTile::from(pattern)),
        }
    }

    pub(super) fn pattern(&self) -> Result<Pattern, SensorError> {
        match self {
            Self::Name(name) => Pattern::built_in(name),
            Self::Tile(tile) => tile.pattern("custom"),
        }
    }
}

/// A response by name with parameters, or as a CSV file beside the capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ResponseSource {
    /// `"linear"`, `{"gamma": 2.2}`, `{"soft-knee": 0.6}` or `{"table": [[0, 0], …, [1, 1]]}`.
    Form(Form),
    /// Name of a CSV file in the same folder.
    Csv(String),
}

impl ResponseSource {
    pub(super) fn form(&self, folder: Option<&Path>) -> Result<Form> {
        match self {
            Self::Form(form) => Ok(form.clone()),
            Self::Csv(name) => {
                let is_csv = name.to_ascii_lowercase().ends_with(".csv");
                let plain = Path::new(name).file_name().is_some_and(|file| file == name.as_str());
                match folder {
                    Some(folder) if is_csv && plain => Response::read_form(folder.join(name)),
                    _ => Err(SensorError::Response(format!(
                        "'{name}' is neither a built-in response (linear, gamma, soft-knee) nor a .csv file beside \
                         the capture"
                    ))
                    .into()),
                }
            }
        }
    }
}

/// A recording, ready to be interpreted.
#[derive(Clone, Debug)]
pub struct Capture {
    /// What the file says about it.
    pub info: CaptureInfo,
    /// When each pixel integrates.
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

    /// Reads a whole capture into memory (see [`CaptureFile::open`]).
    pub fn read(path: impl AsRef<Path>, overrides: &Map<String, Value>) -> Result<Self> {
        let file = CaptureFile::open(path, overrides)?;
        let (_, counts) = read_counts(&file.array)?;
        let Recording { info, pattern, response, height, width, .. } = file.recording;
        Ok(Self { info, pattern, response, frames: file.frames, height, width, counts })
    }

    /// Writes `capture.npy` and `capture.json` into `folder`. Returns their paths.
    pub fn write(&self, folder: impl AsRef<Path>) -> Result<[PathBuf; 2]> {
        let [array, json] = Self::files(folder);
        // A response from a file travels inside, so that the capture is complete.
        let info =
            CaptureInfo { response: ResponseSource::Form(self.response.form().clone()), ..self.info.clone() };
        let mut text =
            serde_json::to_string_pretty(&info).map_err(|e| SensorError::Capture(e.to_string()))?;
        text.push('\n');
        write_counts(&array, &[self.frames, self.height, self.width], &self.counts)?;
        atomic::write_bytes(&json, text.as_bytes())?;
        Ok([array, json])
    }

    /// What [`Capture::write`] writes into a folder: counts and description.
    pub fn files(folder: impl AsRef<Path>) -> [PathBuf; 2] {
        let array = folder.as_ref().join(ARRAY);
        let json = array.with_extension("json");
        [array, json]
    }

    /// Tables for the kernels.
    pub fn calibration(&self) -> Calibration {
        Calibration::new(&self.pattern, &self.response)
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

//! Captures: the read-outs of one recording with what is needed to interpret them (design §8).

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::pattern::Tile;
use super::{Calibration, Form, Pattern, Response, SensorError};
use crate::video::npy::{Counts, read_counts, write_counts};
use crate::video::{Video, atomic};
use crate::{At, Result};

/// Name of the array in a capture folder.
const ARRAY: &str = "capture.npy";

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
    Tile(Tile),
}

impl PatternSource {
    /// The shortest way to name `pattern`.
    pub fn of(pattern: &Pattern) -> Self {
        match Pattern::built_in(&pattern.name) {
            Ok(built_in) if built_in == *pattern => Self::Name(pattern.name.clone()),
            _ => Self::Tile(Tile::from(pattern)),
        }
    }

    fn pattern(&self) -> Result<Pattern, SensorError> {
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
    fn form(&self, folder: Option<&Path>) -> Result<Form> {
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
        let pattern = info.pattern.pattern()?;
        let response = Response::new(info.response.form(folder)?, pattern.shortest_exposure() as f64)?;
        let fail = |problem: String| Err(SensorError::Capture(problem).into());
        if counts.is_empty() || counts.len() != frames * height * width {
            return fail(format!("{} values for {frames}×{height}×{width}", counts.len()));
        }
        if height < pattern.rows || width < pattern.cols {
            return fail(format!(
                "{height}×{width} pixels are fewer than the {}×{} of the pattern's tile",
                pattern.rows, pattern.cols
            ));
        }
        let CaptureInfo { bit_depth, black_level, white_level, frame_period_ms, .. } = info;
        if !(1..=16).contains(&bit_depth) {
            return fail(format!("a bit depth of {bit_depth}"));
        }
        if !(black_level.is_finite() && white_level.is_finite() && black_level < white_level) {
            return fail(format!("black level {black_level} is not below white level {white_level}"));
        }
        if !(frame_period_ms.is_finite() && frame_period_ms > 0.0) {
            return fail(format!("a frame period of {frame_period_ms} ms"));
        }
        if info.schedule_start.unsigned_abs() > 1 << 40 {
            return fail(format!("a schedule start of {}", info.schedule_start));
        }
        Ok(Self { info, pattern, response, frames, height, width, counts })
    }

    /// Reads a capture: a `.npy` file with its `.json` beside it, or a folder that holds `capture.npy`.
    ///
    /// `overrides` replace keys of the JSON file; with enough of them no JSON file is needed.
    pub fn read(path: impl AsRef<Path>, overrides: &Map<String, Value>) -> Result<Self> {
        let path = path.as_ref();
        let array = if path.is_dir() { path.join(ARRAY) } else { path.to_owned() };
        let (extent, counts) = read_counts(&array)?;
        let json = array.with_extension("json");
        let mut keys = match std::fs::read_to_string(&json) {
            Ok(text) => serde_json::from_str::<Map<String, Value>>(&text)
                .map_err(|e| SensorError::Capture(e.to_string()))
                .at(&json)?,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound && overrides.contains_key("pattern") => {
                Map::new()
            }
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                let problem = "missing; it says how to read the capture (or name a pattern with --pattern)";
                return Err(crate::Error::from(SensorError::Capture(problem.into())).at(&json));
            }
            Err(e) => return Err(e).at(&json),
        };
        keys.extend(overrides.clone());
        // A bare array says nothing of its depth but its type.
        let depth = if matches!(counts, Counts::U8(_)) { 8 } else { 16 };
        let depth = keys.entry("bit_depth").or_insert(depth.into()).as_u64().unwrap_or(depth).clamp(1, 16);
        keys.entry("white_level").or_insert(((1u64 << depth) - 1).into());
        let info: CaptureInfo = serde_json::from_value(Value::Object(keys))
            .map_err(|e| SensorError::Capture(e.to_string()))
            .at(&json)?;
        Self::new(info, extent, counts, array.parent()).at(&array)
    }

    /// Writes `capture.npy` and `capture.json` into `folder`. Returns their paths.
    pub fn write(&self, folder: impl AsRef<Path>) -> Result<[PathBuf; 2]> {
        let folder = folder.as_ref();
        let (array, json) = (folder.join(ARRAY), folder.join(ARRAY).with_extension("json"));
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

    /// Tables for the kernels.
    pub fn calibration(&self) -> Calibration {
        Calibration::new(&self.pattern, &self.response)
    }

    /// Pixel values y in [0, 1] of frame `t`, [y, x].
    pub fn pixel_values(&self, t: usize, values: &mut [f32]) {
        let len = self.height * self.width;
        let black = self.info.black_level;
        let scale = 1.0 / (self.info.white_level - black);
        let value = |count: f64| ((count - black) * scale).clamp(0.0, 1.0) as f32;
        match &self.counts {
            Counts::U8(counts) => {
                values.iter_mut().zip(&counts[t * len..][..len]).for_each(|(v, &c)| *v = value(f64::from(c)));
            }
            Counts::U16(counts) => {
                values.iter_mut().zip(&counts[t * len..][..len]).for_each(|(v, &c)| *v = value(f64::from(c)));
            }
        }
    }

    /// Pixel values y in [0, 1] of all frames.
    pub fn measurement(&self) -> Video {
        let mut video = Video::black(self.frames, self.height, self.width);
        for t in 0..self.frames {
            self.pixel_values(t, video.frame_mut(t));
        }
        video
    }
}

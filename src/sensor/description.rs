//! What `capture.json` says (design §8).

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::defects::Defects;
use super::pattern::PatternTile;
use super::{Form, FrameNumbers, Orientation, Pattern, Placement, Response, SensorError};
use crate::Result;
use crate::video::Counts;

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
    pub pattern: PatternSpec,
    /// What each frame holds.
    #[serde(default = "covering")]
    pub timing: Timing,
    /// Schedule time of the first frame.
    #[serde(default)]
    pub schedule_start: i64,
    /// Row and column of the pattern's tile, as frames show it, at which their first pixel lies: what a crop begins with.
    #[serde(default, skip_serializing_if = "is_default")]
    pub tile_origin: [usize; 2],
    /// How frames were turned against the sensor.
    #[serde(default, skip_serializing_if = "is_default")]
    pub orientation: Orientation,
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
    pub response: ResponseSpec,
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
    /// Numbers of the frames, where some are missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_numbers: Option<FrameNumbers>,
    /// When frames were recorded, in milliseconds, where some are missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_stamps_ms: Option<FrameNumbers>,
}

impl CaptureInfo {
    /// How frames lie on the sensor.
    pub fn placement(&self) -> Placement {
        Placement { tile_origin: self.tile_origin, orientation: self.orientation }
    }

    /// The pattern as frames show it. One that a built-in pattern shows in some placement becomes that one in it, so that
    /// nets for it fit.
    pub(super) fn shown_pattern(&mut self) -> Result<Pattern, SensorError> {
        let pattern = self.pattern.pattern()?;
        if self.placement() != Placement::WHOLE {
            return Ok(self.placement().shown(&pattern));
        }
        if let Some((known, Placement { tile_origin, orientation })) = Placement::of_built_in(&pattern) {
            (self.tile_origin, self.orientation) = (tile_origin, orientation);
            self.pattern = PatternSpec::of(&known);
            return Ok(pattern.named(known.name()));
        }
        Ok(pattern)
    }

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

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}
fn covering() -> Timing {
    Timing::Covering
}
fn one() -> f64 {
    1.0
}
fn linear() -> ResponseSpec {
    ResponseSpec::Form(Form::Linear)
}

/// A pattern by name or as a tile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PatternSpec {
    /// Built-in name.
    Name(String),
    /// The tile itself.
    Tile(PatternTile),
}

impl PatternSpec {
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
pub enum ResponseSpec {
    /// `"linear"`, `{"gamma": 2.2}`, `{"soft-knee": 0.6}` or `{"table": [[0, 0], …, [1, 1]]}`.
    Form(Form),
    /// Name of a CSV file in the same folder.
    Csv(String),
}

impl ResponseSpec {
    pub(super) fn form(&self, folder: Option<&Path>) -> Result<Form> {
        match self {
            Self::Form(form) => Ok(form.clone()),
            Self::Csv(name) => {
                let plain = Path::new(name).file_name().is_some_and(|file| file == name.as_str());
                match folder {
                    Some(folder) if Response::is_measured(name) && plain => Response::read_form(folder.join(name)),
                    _ => Err(SensorError::Response(format!(
                        "\"{name}\" is neither \"linear\" nor a .csv file beside the capture; others are written \
                         {{\"gamma\": 2.2}}, {{\"soft-knee\": 0.6}}"
                    ))
                    .into()),
                }
            }
        }
    }
}

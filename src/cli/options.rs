//! Options that several commands share.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::network;
use crate::sensor::{
    CameraModel, Defects, Form, FrameNumbers, Orientation, Pattern, PatternSpec, Placement, Response,
    Sampler, Timing,
};
use crate::synth::{self, ExecutorChoice, Settings};
use crate::{Error, Result};
use clap::{Args, ValueEnum};
use serde::Serialize;
use serde_json::{Map, Value};

/// Which net runs, and how.
#[derive(Args, Clone, Debug)]
pub struct SettingsArgs {
    /// Weights file, or name of a built-in preset
    #[arg(long, default_value = "fast", value_name = "FILE|PRESET")]
    pub weights: String,
    #[command(flatten)]
    run: RunArgs,
}

/// How nets run.
#[derive(Args, Clone, Debug)]
pub struct RunArgs {
    /// Where the net runs
    #[arg(long, value_enum, default_value_t)]
    pub executor: ExecutorChoice,
    /// Part of the name of the GPU adapter to use
    #[arg(long, value_name = "SUBSTRING")]
    pub adapter: Option<String>,
    /// How numbers are stored
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
    /// What may be left out
    #[arg(long, value_enum, default_value_t)]
    pub skip: Skip,
    /// With --skip bounded: largest change of the tone curve l = ln(1 + 5000 p)/ln(5001) that may go unseen, unless
    /// noise hides a larger one. 0.002 is 1.7% of the irradiance, and costs less than 0.1 dB
    #[arg(long, default_value_t = synth::Skip::ALLOWED_ERROR, value_parser = allowed_error, value_name = "L")]
    pub allowed_error: f64,
    /// Longest side of a tile in pixels [default: as large as memory allows]
    #[arg(long, value_name = "PIXELS")]
    pub tile: Option<usize>,
    /// Result frames of a window, for nets that give the same for any number [default: the net's own, fewer where
    /// memory is short]; rounded up to what the net and, with --skip, the pattern need
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u16).range(1..=512))]
    pub hop: Option<u16>,
    /// Mean of what the net makes of so many views of the recording in which the pattern looks the same, such as upside
    /// down and backwards in time: as many times the work, for 0.2 to 0.3 dB with 8. The mpve patterns have 8
    #[arg(long, default_value_t = 1, value_name = "VIEWS", value_parser = clap::value_parser!(u8).range(1..=64))]
    pub ensemble: u8,
    /// Results get better where a scene rests: each pixel's own read-outs since it last changed are averaged, and fused with
    /// what the net says. The capture has to state its noise (full_well_e, read_noise_e)
    #[arg(long)]
    pub accumulate: bool,
}

/// Rows and columns of frames, `SIDE` of each where nothing is said.
#[derive(Args, Clone, Copy, Debug)]
pub struct SizeArgs<const SIDE: usize> {
    /// Width and height of a frame in pixels, or one number for both
    #[arg(long, default_value_t = FrameSize { width: SIDE, height: SIDE }, value_name = "WxH")]
    size: FrameSize,
    /// As it was said before.
    #[arg(long, hide = true, value_parser = at_least_one)]
    height: Option<usize>,
    /// As it was said before.
    #[arg(long, hide = true, value_parser = at_least_one)]
    width: Option<usize>,
}

impl<const SIDE: usize> SizeArgs<SIDE> {
    /// Rows and columns.
    pub fn extent(&self) -> [usize; 2] {
        let Self { size, height, width } = self;
        [height.unwrap_or(size.height), width.unwrap_or(size.width)]
    }
}

/// Width and height of a frame, as they are written: `WxH`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameSize {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl fmt::Display for FrameSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl FromStr for FrameSize {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (width, height) = text.split_once('x').unwrap_or((text, text));
        match (at_least_one(width), at_least_one(height)) {
            (Ok(width), Ok(height)) => Ok(Self { width, height }),
            _ => Err("expected width and height, such as 128x96, or one number for both".into()),
        }
    }
}

/// Parses a count of something that must not be empty.
pub fn at_least_one(text: &str) -> std::result::Result<usize, String> {
    match text.parse() {
        Ok(0) | Err(_) => Err("a whole number from 1".into()),
        Ok(n) if n > 1 << 24 => Err("at most 16777216".into()),
        Ok(n) => Ok(n),
    }
}

/// Parses a change of l.
pub fn allowed_error(text: &str) -> std::result::Result<f64, String> {
    match text.parse() {
        Ok(error) if (0.0..=1.0).contains(&error) => Ok(error),
        _ => Err("expected a number from 0 to 1".into()),
    }
}

/// How numbers are stored.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum Precision {
    /// 32 bits
    #[default]
    F32,
    /// 16 bits for feature channels and weights, on a GPU only; sums, logarithms and the result stay f32
    F16,
}

/// What may be left out.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum Skip {
    /// Nothing: everything is computed
    #[default]
    Off,
    /// What gives the same bits, because all that it depends on repeats
    Exact,
    /// What differs from the last computed by no more than noise, or the allowed error
    Bounded,
}

impl Skip {
    /// The library's name for it; `bounded` allows an error.
    pub fn within(self, allowed_error: f64) -> synth::Skip {
        match self {
            Self::Off => synth::Skip::Off,
            Self::Exact => synth::Skip::Exact,
            Self::Bounded => synth::Skip::Bounded(allowed_error),
        }
    }
}

impl Precision {
    /// The library's name for it.
    pub fn storage(self) -> network::Precision {
        match self {
            Self::F32 => network::Precision::F32,
            Self::F16 => network::Precision::F16,
        }
    }
}

impl SettingsArgs {
    /// The file that is read where the weights are not built in.
    pub fn sources(&self) -> [PathBuf; 1] {
        [PathBuf::from(&self.weights)]
    }

    /// What was chosen.
    pub fn settings(&self) -> Settings {
        self.run.settings(self.weights.clone())
    }
}

impl RunArgs {
    /// What was chosen, for these weights.
    pub fn settings(&self, weights: String) -> Settings {
        Settings {
            weights,
            executor: self.executor,
            adapter: self.adapter.clone(),
            precision: self.precision.storage(),
            skip: self.skip.within(self.allowed_error),
            tile: self.tile,
            hop: self.hop.map(usize::from),
            ensemble: usize::from(self.ensemble),
            accumulate: self.accumulate,
        }
    }
}

/// The simulated camera.
#[derive(Args, Clone, Debug)]
pub struct CameraArgs {
    /// Sampling pattern: a built-in name or a JSON file [default: mpve-1-4]
    #[arg(long, value_name = "NAME|FILE")]
    pub pattern: Option<String>,
    /// Camera: default (9000 electrons), pe-cmos (200 electrons, as the paper's), or a JSON file. The options below
    /// replace what it says
    #[arg(long, default_value = "default", value_name = "NAME|FILE")]
    pub camera: String,
    /// Response: linear, gamma:2.2, soft-knee:0.6, or a CSV file [default: linear]
    #[arg(long, value_parser = parse_response, value_name = "CURVE")]
    pub response: Option<ResponseOption>,
    /// Electrons at y = 1; 0 for no noise at all [default: 9000]
    #[arg(long, value_name = "E")]
    pub full_well: Option<f64>,
    /// Read noise in electrons rms [default: 2.67]
    #[arg(long, value_name = "E")]
    pub read_noise: Option<f64>,
    /// Count at y = 0: above 0, read noise is not cut off there [default: 0; pe-cmos: 48]
    #[arg(long, alias = "pedestal", value_name = "COUNT")]
    pub black_level: Option<u16>,
    /// Bits per pixel value [default: 10]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub bit_depth: Option<u32>,
    /// Duration of a frame in milliseconds [default: 1]
    #[arg(long, alias = "frame-period", value_name = "MS")]
    pub frame_period_ms: Option<f64>,
    /// What each frame holds; a live camera holds [default: covering]
    #[arg(long, value_enum)]
    pub timing: Option<TimingOption>,
    /// As it was called before: `--timing hold`.
    #[arg(long, hide = true, conflicts_with = "timing")]
    pub hold: bool,
    /// Schedule time of the first frame [default: 0]
    #[arg(long, allow_hyphen_values = true, value_name = "FRAME")]
    pub schedule_start: Option<i64>,
    /// How frames lie on the sensor.
    #[command(flatten)]
    pub placement: PlacementArgs,
    /// Seed of every random draw
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// How frames lie on the sensor.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct PlacementArgs {
    /// Row and column of the pattern's tile, as frames show it, at which their first pixel lies: what a crop begins with
    /// [default: 0,0]
    #[arg(long, value_parser = parse_place, value_name = "ROW,COLUMN")]
    pub tile_origin: Option<[usize; 2]>,
    /// How frames were turned against the sensor [default: normal]
    #[arg(long, value_enum)]
    pub orientation: Option<Orientation>,
}

/// Parses a row and a column.
fn parse_place(text: &str) -> std::result::Result<[usize; 2], String> {
    let number = |text: &str| text.trim().parse().map_err(|_| "expected ROW,COLUMN, such as 1,3".to_owned());
    let (row, column) = text.split_once(',').unwrap_or((text, ""));
    Ok([number(row)?, number(column)?])
}

/// A response that was named on the command line.
#[derive(Clone, Debug)]
pub enum ResponseOption {
    /// A built-in form.
    Form(Form),
    /// A table in a file.
    Csv(PathBuf),
}

/// Parses a response: `linear`, `gamma:G`, `soft-knee:K` or a .csv file.
pub fn parse_response(text: &str) -> std::result::Result<ResponseOption, String> {
    let number = |value: &str| value.parse().map_err(|_| format!("'{value}' is not a number"));
    let form = match text.split_once(':') {
        _ if Response::is_measured(text) => return Ok(ResponseOption::Csv(text.into())),
        None if text == "linear" => Form::Linear,
        Some(("gamma", gamma)) => Form::Gamma(number(gamma)?),
        Some(("soft-knee", knee)) => Form::SoftKnee(number(knee)?),
        _ => return Err("expected linear, gamma:G, soft-knee:K or a .csv file".into()),
    };
    Response::new(form.clone(), 1.0).map_err(|e| e.to_string())?;
    Ok(ResponseOption::Form(form))
}

impl ResponseOption {
    /// The file that it is read from.
    fn file(&self) -> Option<PathBuf> {
        match self {
            Self::Csv(path) => Some(path.clone()),
            Self::Form(_) => None,
        }
    }

    /// The curve.
    pub fn form(&self) -> Result<Form> {
        match self {
            Self::Form(form) => Ok(form.clone()),
            Self::Csv(path) => Response::read_form(path),
        }
    }
}

impl CameraArgs {
    /// The camera simulator.
    pub fn sampler(&self) -> Result<Sampler> {
        let mut camera = CameraModel::load(&self.camera)?;
        if let Some(response) = &self.response {
            camera.response = response.form()?;
        }
        let (full_well, read_noise) = (self.full_well.unwrap_or(0.0), self.read_noise.unwrap_or(0.0));
        if !(full_well >= 0.0 && read_noise >= 0.0 && read_noise.is_finite()) {
            return Err(Error::Usage("--full-well and --read-noise must not be negative".into()));
        }
        match self.full_well {
            Some(0.0) => camera.full_well_e = None,
            given => camera.full_well_e = given.or(camera.full_well_e),
        }
        camera.read_noise_e = self.read_noise.unwrap_or(camera.read_noise_e);
        camera.black_level = self.black_level.unwrap_or(camera.black_level);
        camera.bit_depth = self.bit_depth.unwrap_or(camera.bit_depth);
        camera.frame_period_ms = self.frame_period_ms.unwrap_or(camera.frame_period_ms);
        let mut sampler = camera.sampler(Pattern::load(self.pattern.as_deref().unwrap_or("mpve-1-4"))?)?;
        sampler.timing = self.timing().map_or(Timing::Covering, TimingOption::timing);
        sampler.schedule_start = self.schedule_start.unwrap_or(sampler.schedule_start);
        sampler.placement = Placement {
            tile_origin: self.placement.tile_origin.unwrap_or_default(),
            orientation: self.placement.orientation.unwrap_or_default(),
        };
        sampler.seed = self.seed;
        Ok(sampler)
    }

    /// Files that are read where these options name some.
    pub fn sources(&self) -> Vec<PathBuf> {
        let response = self.response.iter().filter_map(ResponseOption::file);
        let named = self.pattern.iter().chain([&self.camera]).map(PathBuf::from);
        named.chain(response).collect()
    }

    /// What was said of its timing.
    fn timing(&self) -> Option<TimingOption> {
        self.timing.or(self.hold.then_some(TimingOption::Hold))
    }

    /// What was said of the camera as keys of `capture.json`, in place of those that a capture has.
    pub fn keys(&self) -> Result<Map<String, Value>> {
        let Self {
            pattern,
            response,
            schedule_start,
            bit_depth,
            black_level,
            frame_period_ms,
            placement,
            ..
        } = self;
        let given = CaptureArgs {
            pattern: pattern.clone(),
            response: response.clone(),
            timing: self.timing(),
            schedule_start: *schedule_start,
            bit_depth: *bit_depth,
            black_level: black_level.map(f64::from),
            frame_period_ms: *frame_period_ms,
            placement: *placement,
            ..CaptureArgs::default()
        };
        given.keys()
    }
}

/// How a recording is to be read, where its JSON file is missing or wrong.
#[derive(Args, Clone, Debug, Default)]
pub struct CaptureArgs {
    /// Sampling pattern: a built-in name or a JSON file
    #[arg(long, value_name = "NAME|FILE")]
    pub pattern: Option<String>,
    /// What each frame holds
    #[arg(long, value_enum)]
    pub timing: Option<TimingOption>,
    /// Schedule time of the first frame
    #[arg(long, allow_hyphen_values = true, value_name = "FRAME")]
    pub schedule_start: Option<i64>,
    /// How frames lie on the sensor.
    #[command(flatten)]
    pub placement: PlacementArgs,
    /// Bits that carry information
    #[arg(long)]
    pub bit_depth: Option<u32>,
    /// Count at y = 0
    #[arg(long, allow_hyphen_values = true, value_name = "COUNT")]
    pub black_level: Option<f64>,
    /// Count at y = 1
    #[arg(long, value_name = "COUNT")]
    pub white_level: Option<f64>,
    /// Duration of a frame in milliseconds
    #[arg(long, value_name = "MS")]
    pub frame_period_ms: Option<f64>,
    /// Response: linear, gamma:2.2, soft-knee:0.6, or a CSV file
    #[arg(long, value_parser = parse_response, value_name = "CURVE")]
    pub response: Option<ResponseOption>,
    /// Dead and hot pixels, which are filled from their neighbours: a text file with a row and a column a line
    #[arg(long, value_name = "FILE")]
    pub dead_pixels: Option<PathBuf>,
    /// Count that stands for a missing read-out, which is filled from its neighbours
    #[arg(long, value_name = "COUNT")]
    pub missing_count: Option<u16>,
    /// Numbers of the frames of a recording with gaps: a text file with a number a line. What is missing is filled
    #[arg(long, value_name = "FILE", conflicts_with = "time_stamps")]
    pub frame_numbers: Option<PathBuf>,
    /// The same as times in milliseconds
    #[arg(long, value_name = "FILE")]
    pub time_stamps: Option<PathBuf>,
}

/// What each frame of a capture holds.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum TimingOption {
    /// The exposure that covers the frame
    Covering,
    /// The last finished read-out
    Hold,
}

impl TimingOption {
    /// The library's name for it.
    fn timing(self) -> Timing {
        match self {
            Self::Covering => Timing::Covering,
            Self::Hold => Timing::Hold,
        }
    }
}

impl CaptureArgs {
    /// Files that are read where these options name some.
    pub fn sources(&self) -> Vec<PathBuf> {
        let response = self.response.iter().filter_map(ResponseOption::file);
        let read = [&self.dead_pixels, &self.frame_numbers, &self.time_stamps].into_iter().flatten().cloned();
        let named = self.pattern.iter().map(PathBuf::from).chain(read);
        named.chain(response).collect()
    }

    /// The options as keys of `capture.json`.
    pub fn keys(&self) -> Result<Map<String, Value>> {
        let mut keys = Map::new();
        let mut set = |key: &str, value: Option<Value>| {
            if let Some(value) = value {
                keys.insert(key.into(), value);
            }
        };
        if let Some(name) = &self.pattern {
            set("pattern", Some(to_json(&PatternSpec::of(&Pattern::load(name)?))?));
        }
        if let Some(response) = &self.response {
            set("response", Some(to_json(&response.form()?)?));
        }
        set("timing", self.timing.map(|timing| to_json(&timing.timing())).transpose()?);
        set("schedule_start", self.schedule_start.map(Value::from));
        set("tile_origin", self.placement.tile_origin.map(|place| place.to_vec().into()));
        set("orientation", self.placement.orientation.map(|orientation| to_json(&orientation)).transpose()?);
        set("bit_depth", self.bit_depth.map(Value::from));
        set("black_level", self.black_level.map(Value::from));
        set("white_level", self.white_level.map(Value::from));
        set("frame_period_ms", self.frame_period_ms.map(Value::from));
        let pixels = self.dead_pixels.as_ref().map(Defects::read_pixels).transpose()?;
        set("dead_pixels", pixels.map(Value::from));
        set("missing_count", self.missing_count.map(Value::from));
        for (key, path) in [("frame_numbers", &self.frame_numbers), ("time_stamps_ms", &self.time_stamps)] {
            set(key, path.as_ref().map(FrameNumbers::read).transpose()?.map(Value::from));
        }
        Ok(keys)
    }
}

fn to_json(value: &impl Serialize) -> Result<Value> {
    Ok(serde_json::to_value(value)?)
}

/// The name of a file or folder for reports.
pub fn show(path: &Path) -> String {
    path.display().to_string()
}

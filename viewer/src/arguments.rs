//! The command line of `pix2hdr-viewer`, which `pix2hdr view` starts.

use std::path::PathBuf;

use clap::{ArgAction, Parser, ValueEnum};
use pix2hdr::Result;
use pix2hdr::cli::options::{CameraArgs, SettingsArgs, SizeArgs};
use pix2hdr::cli::terminal;
use pix2hdr::network::Model;
use pix2hdr::scene::Speed;
use serde_json::json;

use crate::clock::RATE_RANGE;
use crate::preferences::Preferences;
use crate::source::{Opening, SourceName};
use crate::{Start, WindowDevice};

/// Shows synthesis live in a window: mosaic, box filter, result and truth, playing
///
/// SOURCE is a built-in scene (fan, leds, falling, …) seen by a simulated camera that runs live; a capture (capture.npy
/// with capture.json, or their folder); an HDR video (.npy or a folder of .exr), which the simulated camera samples; or
/// a panorama (.exr or .hdr, twice as wide as high), in which it moves. A live camera runs at --rate frames per second
/// whether or not synthesis keeps up: then the oldest frames are dropped and counted. Files drop nothing. H shows all
/// keys.
#[derive(Parser)]
#[command(version = pix2hdr::system::version(), max_term_width = 100)]
pub struct Arguments {
    /// Built-in scene, capture, video or panorama
    #[arg(default_value = "fan")]
    source: String,
    /// Frames per second at first; 1000 is real speed for frames of 1 ms [default: as last time, or 30]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    rate: Option<f64>,
    #[command(flatten)]
    size: SizeArgs<192>,
    /// How fast a clip of a panorama moves
    #[arg(long, value_enum, default_value_t)]
    speed: SpeedOption,
    /// Ground truth of a capture
    #[arg(long, value_name = "PATH")]
    truth: Option<PathBuf>,
    /// Show a video as it is, instead of sampling it and synthesising
    #[arg(long)]
    plain: bool,
    /// Folder for saved frames and recordings
    #[arg(long, default_value = "out/view", value_name = "FOLDER")]
    out: PathBuf,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    engine: SettingsArgs,
    /// Which wgpu device draws the window
    #[arg(long, value_enum, default_value_t, value_name = "DEVICE")]
    window_device: WindowDeviceOption,
    /// Close after so many seconds, and print how the interface kept up
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<f64>,
    /// With --seconds, print one JSON object
    #[arg(long, requires = "seconds")]
    json: bool,
    /// Says more on standard error; twice, everything
    #[arg(short, long, action = ArgAction::Count)]
    verbose: u8,
}

/// What draws the window.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum WindowDeviceOption {
    /// The GPU that synthesises; one of its own where software or the CPU synthesises
    #[default]
    Auto,
    /// The one that synthesises: results stay on it
    Shared,
    /// One of its own: results come from main memory
    Own,
}

/// How fast a clip of a panorama moves.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum SpeedOption {
    /// Not at all
    Static,
    /// Up to 0.25 px/frame
    #[default]
    Slow,
    /// 0.25 to 1 px/frame
    Medium,
    /// 1 to 2 px/frame
    Fast,
    /// 2 to 4 px/frame
    Extreme,
}

/// Parses frames per second.
fn rate(text: &str) -> std::result::Result<f64, String> {
    let [least, most] = RATE_RANGE;
    match text.parse() {
        Ok(rate) if (least..=most).contains(&rate) => Ok(rate),
        _ => Err(format!("expected a number from {least} to {most}")),
    }
}

impl Arguments {
    /// Opens the viewer, and returns when it is closed.
    pub fn run(&self) -> Result<()> {
        terminal::log(self.verbose);
        let speed = match self.speed {
            SpeedOption::Static => Speed::Static,
            SpeedOption::Slow => Speed::Slow,
            SpeedOption::Medium => Speed::Medium,
            SpeedOption::Fast => Speed::Fast,
            SpeedOption::Extreme => Speed::Extreme,
        };
        // What cannot work is said before a window opens.
        Model::load(&self.engine.weights)?;
        let start = Start {
            source: SourceName::parse(&self.source),
            opening: Opening {
                sampler: self.camera.sampler()?,
                extent: self.size.extent(),
                seed: self.camera.seed,
                speed,
                keys: self.camera.keys()?,
                truth: self.truth.clone(),
                plain: self.plain,
            },
            settings: self.engine.settings(),
            out: self.out.clone(),
            preferences: Preferences::path(),
            rate: self.rate,
            seconds: self.seconds,
            device: match self.window_device {
                WindowDeviceOption::Auto => WindowDevice::Auto,
                WindowDeviceOption::Shared => WindowDevice::Shared,
                WindowDeviceOption::Own => WindowDevice::Own,
            },
        };
        let pace = crate::run(start)?;
        if self.seconds.is_none() {
            return Ok(());
        }
        let json = json!({
            "seconds": pace.seconds,
            "start_ms": { "window": pace.start_ms[0], "picture": pace.start_ms[1] },
            "passes": pace.passes,
            "interval_ms": pace.interval_ms,
            "pass_ms": pace.pass_ms,
            "net_ms": pace.net_ms,
            "results_stay_on_gpu": pace.on_gpu,
            "frames": pace.frames,
            "dropped": pace.dropped,
            "memory_bytes": pace.memory,
            "failure": pace.failure,
        });
        terminal::result(self.json, &json, || {
            let [median, p95, most] = pace.interval_ms;
            format!(
                "{} passes of the interface in {:.0} s: every {median:.0} ms (95%: {p95:.0} ms, most {most:.0} ms); \
                 {} frames delivered, {} dropped",
                pace.passes, pace.seconds, pace.frames, pace.dropped
            )
        })
    }
}

//! `pix2hdr import`: a real recording becomes a capture.

use std::path::PathBuf;

use crate::Result;
use crate::sensor::{Capture, CaptureFile, Detection, Imported, Importing, Recording, Timing, import};
use crate::system::version;
use crate::video::{Outputs, check_folder_name};
use clap::Args;
use serde_json::{Value, json};

use super::options::{CaptureArgs, show};
use super::synth::described;
use super::terminal::{self, counted};

/// Turns a real recording into a capture: layout, black level, timing and schedule
///
/// The array is u8 or u16 [t, y, x] in sensor layout. What a .json beside it does not say is said by options. A
/// recording of the last finished read-outs (--timing hold) is shifted so that each frame holds the exposure that
/// covers it; a live source that needs that waits for the longest exposure.
#[derive(Args)]
#[allow(clippy::struct_excessive_bools)] // Flags of a command line.
pub struct Import {
    /// The recording (.npy, u8 or u16)
    file: PathBuf,
    /// Folder for capture.npy and capture.json
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    #[command(flatten)]
    options: CaptureArgs,
    /// Fit response and black level to the recording: where it is static and smooth, neighbouring pixels of different
    /// exposure see the same light
    #[arg(long)]
    fit_response: bool,
    /// Take tile origin, orientation, schedule start and timing from the recording itself, whose counts change only at
    /// read-outs; what it does not clearly show stays as described
    #[arg(long)]
    detect: bool,
    /// Replace what is there
    #[arg(long)]
    overwrite: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Import {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        check_folder_name(&self.out)?;
        let outputs = Outputs::new(self.overwrite).reading(self.options.sources());
        Capture::files(&self.out).iter().try_for_each(|file| outputs.check(file))?;
        let file = CaptureFile::open(&self.file, &self.options.keys()?)?;
        let Self { fit_response, detect, overwrite, .. } = *self;
        let how = Importing { fit_response, detect, overwrite };
        let Imported { recording, frames, files, fit, detection, findings, exposure } =
            import(file, &self.out, how)?;
        findings.iter().for_each(terminal::warn);
        if exposure.is_none() {
            terminal::warn("too few static, well exposed pixels to check how values scale with exposure");
        }
        let Recording { pattern, info, height, width, .. } = &recording;
        let latency = pattern.longest_readout() as f64 * info.frame_period_ms;
        let report = json!({
            "version": version(), "capture": described(&show(&self.file), info, frames),
            "pattern": pattern.name(), "frames": frames, "height": height, "width": width,
            "detected": detection.as_ref().map(detected_json),
            "exposure_exponent": exposure.map(|check| check.exponent),
            "response_difference": fit.as_ref().map(|fit| fit.difference), "live_latency_ms": latency, "files": files.each_ref().map(|path| show(path)),
        });
        terminal::result(self.json, &report, || {
            let fitted = fit.as_ref().map_or_else(String::new, |fit| {
                let [before, after] = fit.difference.map(|difference| 100.0 * difference);
                let robust = if after > 1.0 { "; `synth --weights robust` takes less of that for texture" } else { "" };
                format!(
                    "\nresponse and black level fitted: what pixels of different exposure say of the same light \
                     differs by {after:.1}% instead of {before:.1}% (median of {} pairs){robust}",
                    fit.pairs
                )
            });
            let exponent = exposure.map_or_else(String::new, |check| {
                format!("\nvalues scale with exposure to the power of {:.3} (1 is right)", check.exponent)
            });
            let detected = detection.as_ref().map_or_else(String::new, detected_text);
            format!(
                "{}: {} of {}×{}, pattern {}{detected}{exponent}\na live source of this pattern lags by its longest \
                 exposure, {latency} ms{fitted}",
                show(&files[0]),
                counted(frames, "frame"),
                width,
                height,
                pattern.name()
            )
        })
    }
}

/// What a recording showed of its schedule, in words.
fn detected_text(detection: &Detection) -> String {
    let schedule = match &detection.schedule {
        Some(found) => {
            let [row, col] = found.placement.tile_origin;
            let orientation = found.placement.orientation.name();
            let gaps = if found.gaps.is_empty() { "no frame" } else { "some frames" };
            format!(
                "tile origin {row},{col}, orientation {orientation}, schedule start {}; {gaps} missing",
                found.schedule_start
            )
        }
        None => "tile origin, orientation and schedule start are not known, and stay as described".into(),
    };
    let timing = match detection.timing {
        Some(Timing::Covering) => "frames hold the exposures that cover them",
        Some(Timing::Hold) => "frames hold the last finished read-outs",
        None => "what frames hold is not known, and stays as described",
    };
    format!("\ndetected: {schedule}\ndetected: {timing}")
}

/// The same as JSON.
fn detected_json(detection: &Detection) -> Value {
    let schedule = detection.schedule.as_ref().map(|found| {
        let gaps: Vec<Value> =
            found.gaps.iter().map(|gap| json!({"frame": gap.frame, "missing": gap.missing})).collect();
        json!({
            "tile_origin": found.placement.tile_origin, "orientation": found.placement.orientation,
            "schedule_start": found.schedule_start, "as_described": found.as_described, "gaps": gaps,
            "leak": found.leak,
        })
    });
    json!({"schedule": schedule, "timing": detection.timing})
}

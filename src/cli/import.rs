//! `pix2hdr import`: a real recording becomes a capture.

use std::path::PathBuf;

use crate::Result;
use crate::sensor::{CaptureFile, Imported, Importing, Recording, import};
use clap::Args;
use serde_json::json;

use super::options::{CaptureArgs, show};
use super::terminal;

/// Turns a real recording into a capture: layout, black level, timing and schedule
///
/// The array is u8 or u16 [t, y, x] in sensor layout. What a .json beside it does not say is said by options. A
/// recording of the last finished read-outs (--timing hold) is shifted so that each frame holds the exposure that
/// covers it; a live source that needs that waits for the longest exposure.
#[derive(Args)]
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
        let file = CaptureFile::open(&self.file, &self.options.keys()?)?;
        let how = Importing { fit_response: self.fit_response, overwrite: self.overwrite };
        let Imported { recording, frames, files, fit, levels, exposure } = import(file, &self.out, how)?;
        let ratio = match exposure {
            Some(check) => check.warning(),
            None => {
                Some("too few static, well exposed pixels to check how values scale with exposure".into())
            }
        };
        for warning in [levels, ratio].into_iter().flatten() {
            terminal::warn(&warning);
        }
        let Recording { pattern, info, height, width, .. } = &recording;
        let latency = pattern.longest_readout() as f64 * info.frame_period_ms;
        let report = json!({
            "pattern": pattern.name(), "frames": frames, "height": height, "width": width,
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
            let exponent = exposure.map_or_else(|| "not known".into(), |c| format!("{:.3}", c.exponent));
            format!(
                "{}: {} frames of {}×{}, pattern {}\nvalues scale with exposure to the power of {exponent} (1 is \
                 right)\na live source of this pattern lags by its longest exposure, {latency} ms{fitted}",
                show(&files[0]),
                frames,
                height,
                width,
                pattern.name()
            )
        })
    }
}

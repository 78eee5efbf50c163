//! `pix2hdr sample`: the camera simulator.

use std::path::PathBuf;

use crate::sensor::Capture;
use crate::system::is_same_file;
use crate::video::{self, check_free};
use crate::{At, Error, Result};
use clap::Args;
use serde_json::json;

use super::options::{CameraArgs, show};
use super::terminal;

/// Simulates the camera: HDR video in, capture out
#[derive(Args)]
pub struct Sample {
    /// Folder of EXR frames or .npy cube: irradiance, p = 1 the 99th percentile
    video: PathBuf,
    /// Folder for capture.npy and capture.json
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    #[command(flatten)]
    camera: CameraArgs,
    /// Scale the video so that its 99th percentile is p = 1, and clip (paper eq. 11)
    #[arg(long)]
    normalise: bool,
    /// Replace what is there
    #[arg(long)]
    overwrite: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Sample {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        for file in Capture::files(&self.out) {
            check_free(&file, self.overwrite)?;
        }
        for file in Capture::files(&self.out) {
            if is_same_file(&file, &self.video) {
                let problem = "is the video itself; name another folder";
                return Err(Error::Usage(problem.into())).at(&file);
            }
        }
        let sampler = self.camera.sampler()?;
        let mut video = video::read(&self.video)?;
        let anchor = self.normalise.then(|| f64::from(video.normalise()));
        let brightest = video.data.iter().copied().fold(0.0, f32::max);
        if brightest > 4.0 {
            terminal::warn(format!(
                "irradiance reaches {brightest:.1}, but p = 1 should be the 99th percentile: use --normalise?"
            ));
        }
        let mut capture = sampler.sample(&video)?;
        capture.info.anchor = anchor;
        let files = capture.write(&self.out)?;
        let report = json!({
            "pattern": sampler.pattern().name(), "frames": capture.frames, "height": capture.height,
            "width": capture.width, "anchor": anchor, "files": files.each_ref().map(|path| show(path)),
        });
        terminal::result(self.json, &report, || {
            format!(
                "{}: {} frames of {}×{}, pattern {}",
                show(&files[0]),
                capture.frames,
                capture.height,
                capture.width,
                sampler.pattern().name()
            )
        })
    }
}

//! `pix2hdr sample`: the camera simulator.

use std::path::PathBuf;

use crate::Result;
use crate::sensor::Capture;
use crate::video::{self, Outputs, check_folder_name};
use clap::Args;
use serde_json::json;

use super::options::{CameraArgs, show};
use super::terminal::{self, counted};

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
        check_folder_name(&self.out)?;
        let outputs = Outputs::new(self.overwrite).reading([&self.video]).reading(self.camera.sources());
        Capture::files(&self.out).iter().try_for_each(|file| outputs.check(file))?;
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
                "{}: {} of {}×{}, pattern {}",
                show(&files[0]),
                counted(capture.frames, "frame"),
                capture.width,
                capture.height,
                sampler.pattern().name()
            )
        })
    }
}

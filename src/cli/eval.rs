//! `pix2hdr eval`: quality measures.

use std::path::PathBuf;

use crate::Result;
use crate::quality::compare;
use crate::video;
use clap::Args;

use super::terminal;

/// Compares a result with the ground truth: PSNR, PSNR-µ, SSIM
#[derive(Args)]
pub struct Eval {
    /// Ground truth: folder of EXR frames or .npy cube
    truth: PathBuf,
    /// Result of the same size
    result: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Eval {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        let measures = compare(&video::read(&self.truth)?, &video::read(&self.result)?)?;
        terminal::result(self.json, &measures, || measures.to_string())
    }
}

//! `pix2hdr eval`: quality measures.

use std::path::PathBuf;

use crate::Result;
use crate::quality::{Evaluation, evaluate, normalise};
use crate::video;
use clap::Args;
use serde::Serialize;

use super::terminal;

/// Compares a result with the ground truth: PSNR, PSNR-µ, SSIM, worst frame and worst patch
///
/// Values are irradiance p, which is clipped to 0…1. Where more than half of the pixels would be clipped, where only
/// clipped pixels differ, or where the truth is below 0.001 throughout, nothing is measured.
#[derive(Args)]
pub struct Eval {
    /// Ground truth: folder of EXR frames or .npy cube
    truth: PathBuf,
    /// Result of the same size
    result: PathBuf,
    /// Divide both videos by the truth's largest value first, for videos that are no irradiance p
    #[arg(long)]
    normalise: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// What is printed.
#[derive(Serialize)]
struct Printed {
    #[serde(flatten)]
    evaluation: Evaluation,
    /// What both videos were divided by.
    normalised_by: Option<f32>,
}

impl Eval {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        let (mut truth, mut result) = (video::read(&self.truth)?, video::read(&self.result)?);
        let normalised_by = self.normalise.then(|| normalise(&mut truth, &mut result)).transpose()?;
        let printed = Printed { evaluation: evaluate(&truth, &result)?, normalised_by };
        terminal::result(self.json, &printed, || {
            let by = normalised_by
                .map_or_else(String::new, |peak| format!("\nboth divided by {peak}, the truth's peak"));
            format!("{}{by}", printed.evaluation)
        })
    }
}

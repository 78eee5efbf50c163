//! `pix2hdr suite`: the quality benchmark.

use std::path::PathBuf;

use crate::Result;
use crate::network::Model;
use crate::quality::{Method, Suite, SuiteReport};
use crate::scene::Panorama;
use crate::sensor::{Calibration, Form, Pattern, Response};
use crate::synth::Synthesizer;
use clap::Args;
use serde_json::json;

use super::options::{RunArgs, SizeArgs, at_least_one};
use super::terminal;

/// Measures quality on the same deterministic clips for every method, from any folder of panoramas
///
/// Per panorama: static, slow, medium, fast and extreme motion; as camera pan, as moving object, and as both; at
/// normal and at low light. The box filter is always among the methods.
#[derive(Args)]
pub struct SuiteCommand {
    /// Folder of equirectangular panoramas (.exr or .hdr)
    #[arg(long, value_name = "FOLDER")]
    panoramas: PathBuf,
    /// Weights files or presets to compare
    #[arg(long, value_delimiter = ',', default_value = "fast", value_name = "FILE|PRESET,…")]
    weights: Vec<String>,
    #[command(flatten)]
    run: RunArgs,
    /// Sampling pattern: a built-in name or a JSON file
    #[arg(long, default_value = "mpve-1-4", value_name = "NAME|FILE")]
    pattern: String,
    /// Frames per clip
    #[arg(long, default_value_t = 32, value_parser = at_least_one)]
    frames: usize,
    #[command(flatten)]
    size: SizeArgs<128>,
    /// Seed of the clips and of the noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl SuiteCommand {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        let pattern = Pattern::load(&self.pattern)?;
        let response = Response::new(Form::Linear, pattern.shortest_exposure() as f64)?;
        let calibration = Calibration::new(&pattern, &response);
        let extent = self.size.extent();
        let panoramas = Panorama::read_folder(&self.panoramas)?;
        let settings: Vec<_> = self.weights.iter().map(|name| self.run.settings(name.clone())).collect();
        let backend = settings[0].backend()?;
        let mut methods = vec![("box".to_owned(), Method::Box)];
        for settings in &settings {
            let (name, calibration) = (&settings.weights, calibration.clone());
            let model = Model::load_for(name, &pattern)?;
            let synthesizer = Synthesizer::new(&model, calibration, extent, &backend, settings)?;
            methods.push((name.clone(), Method::Net(Box::new(synthesizer))));
        }
        let suite = Suite { pattern, frames: self.frames, extent, seed: self.seed };
        let bar = terminal::progress(Suite::clips(panoramas.len()), "clips");
        let report = suite.run(&panoramas, &mut methods, |done| bar.set_position(done as u64))?;
        bar.finish_and_clear();
        let mut json = serde_json::to_value(&report)?;
        json["ran_on"] = json!(backend.adapter().unwrap_or_else(|| backend.name().to_owned()));
        terminal::result(self.json, &json, || {
            format!("{}\nran on {}", table(&report, &methods), json["ran_on"].as_str().unwrap_or_default())
        })
    }
}

/// Methods as columns, classes as rows: PSNR-µ, and its margin over the box filter.
fn table(report: &SuiteReport, methods: &[(String, Method)]) -> String {
    let box_scores = &report.methods["box"];
    let names: Vec<&String> = methods.iter().map(|(name, _)| name).collect();
    let mut text =
        format!("PSNR-µ in dB (margin over the box filter), mean over {} clips\n{:22}", report.clips, "");
    for name in &names {
        text += &format!("{:>24}", name.rsplit('/').next().unwrap_or(name));
    }
    let mut row = |label: &str, value: &dyn Fn(&str) -> (f64, f64)| {
        text += &format!("\n{label:22}");
        for name in &names {
            let (score, reference) = value(name);
            text += &format!("{:>24}", format!("{score:.2} ({:+.2})", score - reference));
        }
    };
    for (class, reference) in &box_scores.classes {
        row(class, &|name| (report.methods[name].classes[class].psnr_mu, reference.psnr_mu));
    }
    row("overall", &|name| (report.methods[name].overall.psnr_mu, box_scores.overall.psnr_mu));
    row("overall PSNR", &|name| (report.methods[name].overall.psnr, box_scores.overall.psnr));
    row("overall SSIM-µ", &|name| {
        let ssim = |name: &str| report.methods[name].overall.ssim_mu.unwrap_or(f64::NAN);
        (ssim(name), ssim("box"))
    });
    text
}

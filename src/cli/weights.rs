//! `pix2hdr weights`: what is in a weights file.

use crate::Result;
use crate::network::{Model, Plan, presets};
use clap::Args;
use serde_json::json;

use super::terminal;

/// Shows what is in a weights file, or lists the built-in presets
#[derive(Args)]
pub struct WeightsArgs {
    /// Weights file or preset; without it, the presets are listed
    weights: Option<String>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl WeightsArgs {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        let Some(name) = &self.weights else {
            let all = presets::all();
            let report = json!({ "presets": all });
            return terminal::result(self.json, &report, || {
                let lines = all.iter().map(ToString::to_string);
                lines.collect::<Vec<_>>().join("\n")
            });
        };
        let model = Model::load(name)?;
        let plan = Plan::lower(&model, 128, 128)?;
        let window = model.graph.window;
        let gflop = plan.flop() / window.hop as f64 / 1e9;
        let steps: Vec<_> = plan
            .steps
            .iter()
            .map(|step| {
                json!({ "name": step.name, "shape": step.output.shape.to_string(),
                        "gflop": step.flop() / window.hop as f64 / 1e9 })
            })
            .collect();
        let report = json!({
            "name": model.graph.name, "pattern": model.graph.pattern, "window": window,
            "response": model.trained.response, "parameters": model.parameters(),
            "gflop_per_128x128_frame": gflop, "reach": model.graph.reach()?,
            "activation_bytes": plan.slot_bytes(4), "steps": steps, "provenance": model.trained.provenance,
        });
        terminal::result(self.json, &report, || {
            format!(
                "{}: pattern {}, response {}\n{} parameters, {gflop:.3} GFLOP per 128×128 frame, window of {} frames \
                 with {} results\ntrained: {}",
                model.graph.name,
                model.graph.pattern,
                model.trained.response,
                model.parameters(),
                window.frames,
                window.hop,
                serde_json::to_string_pretty(&model.trained.provenance).unwrap_or_default(),
            )
        })
    }
}

//! The built-in nets.

use std::fmt;

use serde::Serialize;

use super::error::NetworkError;
use super::graph::Graph;

/// A built-in net.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Preset {
    /// Name on the command line.
    pub name: &'static str,
    /// What it is for.
    pub purpose: &'static str,
    /// Whether trained weights are built in.
    pub trained: bool,
    #[serde(skip)]
    graph: &'static str,
    #[serde(skip)]
    weights: Option<&'static [u8]>,
}

macro_rules! preset {
    ($name:literal, $purpose:literal $(, $weights:literal)?) => {{
        let weights: &[&'static [u8]] = &[$(include_bytes!(concat!("../../weights/", $weights)))?];
        Preset {
            name: $name,
            purpose: $purpose,
            trained: !weights.is_empty(),
            graph: include_str!(concat!("../../weights-format/presets/", $name, ".json")),
            weights: weights.first().copied(),
        }
    }};
}

/// All built-in nets, smallest first.
pub fn all() -> [Preset; 8] {
    [
        preset!("tiny", "the smallest, for machines without a GPU", "tiny.safetensors"),
        preset!("fast", "predicted kernels, made for run time against error", "fast.safetensors"),
        preset!("fast-1-8", "the same for pattern mpve-1-8", "fast-1-8.safetensors"),
        preset!("fast-1-16", "the same for pattern mpve-1-16", "fast-1-16.safetensors"),
        preset!("robust", "fast for recordings whose pixels differ: fewer dots", "robust.safetensors"),
        preset!("large", "fast at twice its width, between fast and paper", "large.safetensors"),
        preset!(
            "paper-narrow",
            "the paper's nets on tiles: large, HDR-net and fusion",
            "paper-narrow.safetensors"
        ),
        preset!("paper", "the paper's LDR-net and HDR-net"),
    ]
}

/// The built-in net of that name.
pub fn by_name(name: &str) -> Result<Preset, NetworkError> {
    all()
        .into_iter()
        .find(|preset| preset.name == name)
        .ok_or_else(|| NetworkError::NoPreset(name.to_owned(), all().map(|preset| preset.name).join(", ")))
}

impl Preset {
    /// The layer graph.
    pub fn graph(&self) -> Result<Graph, NetworkError> {
        Graph::from_json(self.graph)
    }

    /// The trained weights file.
    pub fn weights(&self) -> Result<&'static [u8], NetworkError> {
        self.weights.ok_or_else(|| NetworkError::Untrained(self.name.to_owned()))
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = if self.trained { "trained" } else { "layer graph only, to be trained" };
        write!(f, "{:14} {} ({state})", self.name, self.purpose)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::{Model, Plan};

    #[test]
    fn every_preset_lowers_and_renders_video() {
        for preset in all() {
            let graph = preset.graph().unwrap();
            assert_eq!(graph.name, preset.name);
            graph.check_renders_video().unwrap();
            let [_, y, x] = graph.granularity().unwrap();
            let model = Model::random(graph, 0).unwrap();
            let plan = Plan::lower(&model, 2 * y, 3 * x).unwrap();
            assert!(
                plan.steps.iter().all(|step| step.inputs.iter().all(|input| input.slot != step.output.slot))
            );
            assert_eq!(plan.result.shape.t, model.graph.window.hop);
        }
    }

    #[test]
    fn built_in_weights_fit_their_graph() {
        for preset in all().into_iter().filter(|preset| preset.trained) {
            let model = Model::from_bytes(preset.weights().unwrap()).unwrap();
            assert_eq!(model.graph, preset.graph().unwrap(), "{}", preset.name);
        }
    }
}

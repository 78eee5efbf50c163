//! How fast a plan can be at best: what its arithmetic and its bytes take at the peaks of the hardware.

use std::collections::HashMap;

use serde::Serialize;

use crate::gpu::{TensorFormat, TensorFormats};
use crate::network::{Kernel, Plan, Precision, Step};

/// What an executor's hardware can do at most, as small programs that do nothing else measure it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Operations per second at f32, two for each multiply-add.
    pub flop_rate: f64,
    /// Bytes per second of a copy, those read and those written together.
    pub copy_rate: f64,
}

/// Arithmetic and bytes of a step or a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Work {
    /// Operations of convolutions, two for each multiply-add.
    pub flop: f64,
    /// Bytes of tensors and weights that are read and written, each once per step.
    pub bytes: f64,
}

/// How fast a plan can be, per result frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Floors {
    /// Operations in 10⁹.
    pub gflop_per_frame: f64,
    /// Bytes in 10⁶ that the steps read and write one after the other.
    pub mbyte_per_frame: f64,
    /// Bytes in 10⁶ that even a single step for everything would read and write: measurement, weights and result.
    pub least_mbyte_per_frame: f64,
    /// Time of the arithmetic at the peak.
    pub arithmetic_floor_ms_per_frame: f64,
    /// Time of the steps' bytes at the peak of a copy.
    pub bytes_floor_ms_per_frame: f64,
}

impl Work {
    /// Of one step, whose tensors are stored in `formats`.
    pub fn of_step(step: &Step, formats: &TensorFormats) -> Self {
        let views = step.inputs.iter().chain([&step.output]);
        let tensors: usize = views.map(|view| view.shape.len() * formats.of(view).bytes()).sum();
        let bytes = tensors + weights(&step.kernel) * formats.weights.bytes();
        Self { flop: step.flop(), bytes: bytes as f64 }
    }

    /// Of both together.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self { flop: self.flop + other.flop, bytes: self.bytes + other.bytes }
    }

    /// Of all steps of a plan, one after the other.
    pub fn of_plan(plan: &Plan, precision: Precision) -> Self {
        let formats = TensorFormats::new(plan, precision);
        let steps = plan.usual_steps().iter().map(|step| Self::of_step(step, &formats));
        steps.fold(Self::default(), Self::and)
    }

    /// Of a plan whose steps were all one: no tensor between them is written.
    pub fn of_fused_plan(plan: &Plan, precision: Precision) -> Self {
        // A layer may be computed in several steps.
        let layers: HashMap<&str, usize> =
            plan.usual_steps().iter().map(|step| (step.name.as_str(), weights(&step.kernel))).collect();
        let weights: usize = layers.values().sum();
        let pixels = plan.measurement.shape.len() + plan.result.shape.len();
        let bytes = pixels * TensorFormat::F32.bytes() + weights * TensorFormat::of(precision).bytes();
        Self { flop: plan.flop(), bytes: bytes as f64 }
    }

    /// Operations per byte.
    pub fn intensity(self) -> f64 {
        self.flop / self.bytes
    }
}

impl Peak {
    /// The least time that a piece of work takes, in seconds: its arithmetic or its bytes, whatever takes longer.
    pub fn roofline(&self, work: Work) -> f64 {
        (work.flop / self.flop_rate).max(work.bytes / self.copy_rate)
    }

    /// The floors of several tiles, each a plan that runs so many times for one window.
    pub fn floors<'a>(
        &self,
        tiles: impl IntoIterator<Item = (&'a Plan, usize)>,
        precision: Precision,
    ) -> Floors {
        let (mut work, mut least, mut frames) = (Work::default(), 0.0, 1.0);
        for (plan, count) in tiles {
            let (stepwise, fused) = (Work::of_plan(plan, precision), Work::of_fused_plan(plan, precision));
            work.flop += count as f64 * stepwise.flop;
            work.bytes += count as f64 * stepwise.bytes;
            least += count as f64 * fused.bytes;
            frames = plan.window.hop as f64;
        }
        Floors {
            gflop_per_frame: 1e-9 * work.flop / frames,
            mbyte_per_frame: 1e-6 * work.bytes / frames,
            least_mbyte_per_frame: 1e-6 * least / frames,
            arithmetic_floor_ms_per_frame: 1e3 * work.flop / self.flop_rate / frames,
            bytes_floor_ms_per_frame: 1e3 * work.bytes / self.copy_rate / frames,
        }
    }
}

/// Values of a kernel's weights, bias, scale and shift.
fn weights(kernel: &Kernel) -> usize {
    kernel.convolution().map_or(0, |conv| {
        let norm = conv.layer.norm.as_ref().map_or(0, |(scale, shift)| scale.len() + shift.len());
        conv.layer.weight.len() + conv.layer.bias.len() + norm
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::{Graph, Model};

    /// 2 frames of 4×8 pixels; 3 features; a 1×3×3 convolution to 5 channels, and one to 2, a weight and a residual.
    fn plan() -> Plan {
        let graph = Graph::from_json(
            r#"{"version": 1, "name": "test", "pattern": "any", "window": {"frames": 2, "lead": 0, "hop": 2},
            "nodes": [{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
            {"name": "features", "op": "features", "inputs": ["measurement", "estimate"],
             "channels": ["measurement", "log_estimate", "saturated"], "block": [1, 1, 1]},
            {"name": "layer", "op": "conv3d", "inputs": ["features"], "out_channels": 5, "kernel": [1, 3, 3],
             "stride": [1, 1, 1], "activation": "none"},
            {"name": "logs", "op": "log_irradiance", "inputs": ["measurement"]},
            {"name": "tail", "op": "conv3d", "inputs": ["layer"], "out_channels": 2, "kernel": [1, 1, 1],
             "stride": [1, 1, 1], "activation": "none"},
            {"name": "result", "op": "blend", "inputs": ["tail", "logs", "estimate"], "block": [1, 1, 1],
             "taps": [[0, 0, 0]]}],
            "output": "result"}"#,
        );
        Plan::lower(&Model::random(graph.unwrap(), 1).unwrap(), 4, 8).unwrap()
    }

    #[test]
    fn work_is_counted_by_hand() {
        let plan = plan();
        let pixels = 2 * 4 * 8;
        let index = plan.steps.iter().position(|step| step.name == "layer").unwrap();
        let of_layer = |precision| Work::of_step(&plan.steps[index], &TensorFormats::new(&plan, precision));
        let layer = of_layer(Precision::F32);
        assert_eq!(layer.flop, (2 * pixels * 9 * 3 * 5) as f64);
        assert_eq!(layer.bytes, (4 * (pixels * (3 + 5) + 9 * 3 * 5 + 5)) as f64);
        assert_eq!(layer.intensity(), layer.flop / layer.bytes);
        // Features stay f32.
        assert_eq!(
            of_layer(Precision::F16).bytes,
            (4 * pixels * 3 + 2 * (pixels * 5 + 9 * 3 * 5 + 5)) as f64
        );
        // Values a pixel: estimate 1 + 1, logs 1 + 1, features 2 + 3, layer 3 + 5, tail 5 + 2, blend 4 + 1.
        let weights = 9 * 3 * 5 + 5 + 5 * 2 + 2;
        assert_eq!(Work::of_plan(&plan, Precision::F32).bytes, (4 * (pixels * 29 + weights)) as f64);
        // What the first convolution writes and the second one reads, and the weights.
        let reduced = pixels * (5 + 5) + weights;
        assert_eq!(
            Work::of_plan(&plan, Precision::F16).bytes,
            (4 * (pixels * 29 + weights) - 2 * reduced) as f64
        );
        let pixels = 2 * pixels;
        assert_eq!(Work::of_fused_plan(&plan, Precision::F32).bytes, (4 * (pixels + weights)) as f64);
        assert_eq!(Work::of_fused_plan(&plan, Precision::F16).bytes, (4 * pixels + 2 * weights) as f64);
    }

    #[test]
    fn the_roofline_is_the_larger_of_the_floors() {
        let peak = Peak { flop_rate: 1e9, copy_rate: 1e8 };
        assert_eq!(peak.roofline(Work { flop: 1e9, bytes: 1e7 }), 1.0);
        assert_eq!(peak.roofline(Work { flop: 1e7, bytes: 2e8 }), 2.0);
        let plan = plan();
        let (one, three) =
            (peak.floors([(&plan, 1)], Precision::F32), peak.floors([(&plan, 3)], Precision::F32));
        assert_eq!(one.gflop_per_frame, 1e-9 * plan.flop() / 2.0);
        assert!((three.bytes_floor_ms_per_frame / one.bytes_floor_ms_per_frame - 3.0).abs() < 1e-9);
        assert!((one.arithmetic_floor_ms_per_frame - 1e3 * plan.flop() / 1e9 / 2.0).abs() < 1e-12);
    }
}

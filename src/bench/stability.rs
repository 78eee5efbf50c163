//! How exact every kernel and whole nets stay where it is hard: inputs, weights and cameras that were chosen to hurt.
//!
//! [`Trial::run`] compares each step with its bound ([`step_errors`]) and the result with the f64 oracle.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::CheckFailed;
use super::check::psnr;
use crate::Result;
use crate::cpu::CpuExecutor;
use crate::cpu::bound::step_errors;
use crate::network::{Activation, Convolution, Executor, Graph, Layer, Model, Op, Plan, Shape, presets};
use crate::sensor::{Calibration, Form, Pattern, Response};
use crate::synth::Backend;

/// Pixel values that are hard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// Uniform over the whole range, with saturated and dark pixels.
    Random,
    /// No light at all.
    Zero,
    /// All pixels saturated.
    Saturated,
    /// One saturated pixel among ones of 10⁻⁶.
    OneBright,
    /// Below the smallest normal number of f32.
    Denormal,
    /// 0 and 1 in turn along t, y and x: the highest frequency that there is.
    Checkerboard,
    /// Read-outs that are saturated and dark in turn.
    Alternating,
    /// At the saturation threshold, one unit of the last place below and above, just below 1 and 1.
    AtSaturation,
}

impl Input {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Random,
        Self::Zero,
        Self::Saturated,
        Self::OneBright,
        Self::Denormal,
        Self::Checkerboard,
        Self::Alternating,
        Self::AtSaturation,
    ];

    /// Pixel values [t, y, x] of a window that begins at schedule time `schedule`.
    pub fn values(self, shape: Shape, calibration: &Calibration, schedule: i64) -> Vec<f32> {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let near = [0.98f32.next_down(), 0.98, 0.98f32.next_up(), 1f32.next_down(), 1.0];
        let bright = (shape.t / 2, shape.y / 2, shape.x / 2);
        let mut value = |t: usize, y: usize, x: usize| match self {
            Self::Random => rng.random_range(-0.1..1.1f32).clamp(0.0, 1.0),
            Self::Zero => 0.0,
            Self::Saturated => 1.0,
            Self::OneBright if (t, y, x) == bright => 1.0,
            Self::OneBright => 1e-6,
            Self::Denormal => [1e-45, 1e-40, 1.1e-38, 0.0][(t + y + x) % 4],
            Self::Checkerboard => ((t + y + x) % 2) as f32,
            Self::Alternating => {
                let time = schedule + t as i64;
                let exposure = calibration.exposure(time, y, x) as i64;
                (time.div_euclid(exposure.max(1)) + (y + x) as i64).rem_euclid(2) as f32
            }
            Self::AtSaturation => near[(t + 2 * y + 3 * x) % near.len()],
        };
        let mut values = Vec::with_capacity(shape.len());
        for t in 0..shape.t {
            for y in 0..shape.y {
                values.extend((0..shape.x).map(|x| value(t, y, x)));
            }
        }
        values
    }
}

/// What is done to a net's weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum WeightStress {
    /// Nothing.
    Plain,
    /// Large ones of opposite sign beside each other, so that sums cancel to what is small.
    Cancelling,
    /// Times 2²⁰; the scale behind the activation undoes it.
    ScaledUp,
    /// Times 2⁻²⁰; the scale behind the activation undoes it.
    ScaledDown,
    /// Batch-normalisation scales of 10⁻⁶, 10⁻¹², … in turn, one of them 0.
    TinyScales,
    /// Features of some ten thousand, near the largest number of f16.
    NearF16Limit,
    /// Features of some ten million, which f16 can hold in other units only.
    BeyondF16Limit,
    /// Fusion weights at their floor: what they are made of is far below zero.
    AtFloor,
}

impl WeightStress {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Plain,
        Self::Cancelling,
        Self::ScaledUp,
        Self::ScaledDown,
        Self::TinyScales,
        Self::NearF16Limit,
        Self::BeyondF16Limit,
        Self::AtFloor,
    ];

    /// Changes a net.
    pub fn apply(self, model: &mut Model) {
        let nodes: Vec<_> = model.graph.nodes.iter().filter(|node| node.convolution().is_some()).collect();
        for node in nodes {
            let Some(layer) = model.layers.get_mut(&node.name) else { continue };
            let activation = node.convolution().map_or(Activation::None, |conv| conv.activation);
            let homogeneous = matches!(activation, Activation::None | Activation::LeakyRelu(_));
            let taps = node.convolution().map_or(1, Convolution::taps);
            let transposed = matches!(node.op, Op::ConvTranspose3d(_));
            let mut other = Layer::clone(layer);
            self.change(&mut other, taps, homogeneous && !transposed);
            *layer = other.into();
        }
    }

    fn change(self, layer: &mut Layer, taps: usize, undone: bool) {
        let scaled = |layer: &mut Layer, factor: f32| {
            let Some((scale, _)) = layer.norm.as_mut().filter(|_| undone) else { return };
            for scale in scale.iter_mut() {
                *scale /= factor;
            }
            layer.weight.iter_mut().chain(&mut layer.bias).for_each(|weight| *weight *= factor);
        };
        match self {
            Self::Plain => {}
            Self::Cancelling => {
                for (i, weight) in layer.weight.iter_mut().enumerate() {
                    let sign = if (i / taps + i % taps).is_multiple_of(2) { 1.0 } else { -1.0 };
                    *weight = sign * (512.0 + *weight);
                }
                // What does not cancel stays small enough for f16.
                let count = layer.weight.len() as f32 / layer.bias.len().max(1) as f32;
                if let Some((scale, _)) = &mut layer.norm {
                    for scale in scale.iter_mut() {
                        *scale /= 512.0 * count.sqrt();
                    }
                } else {
                    layer.weight.iter_mut().for_each(|weight| *weight /= 8.0);
                }
            }
            Self::ScaledUp => scaled(layer, 2f32.powi(20)),
            Self::ScaledDown => scaled(layer, 2f32.powi(-20)),
            Self::TinyScales => {
                if let Some((scale, _)) = &mut layer.norm {
                    let sizes = [1e-6, 1e-12, 1e-20, 1e-38, 0.0, 1.0];
                    scale.iter_mut().zip(sizes.iter().cycle()).for_each(|(scale, size)| *scale *= size);
                }
            }
            Self::NearF16Limit | Self::BeyondF16Limit => {
                if undone {
                    let size = if self == Self::NearF16Limit { 3e4 } else { 3e7 };
                    layer.bias.iter_mut().enumerate().for_each(|(i, bias)| {
                        *bias += if i % 2 == 0 { size } else { -size };
                    });
                    // The next layers see what they are used to.
                    layer.weight.iter_mut().for_each(|weight| *weight = weight.clamp(-1.0, 1.0) * 1e-4);
                }
            }
            Self::AtFloor => {
                if !undone && taps == 1 {
                    layer.bias.fill(-200.0);
                }
            }
        }
    }
}

/// A pattern and a response.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCalibration {
    /// Name of both.
    pub name: String,
    /// Their tables.
    pub calibration: Calibration,
}

impl NamedCalibration {
    /// A built-in pattern with a response.
    pub fn new(pattern: &str, response: &str, form: Form) -> Result<Self> {
        let pattern = Pattern::built_in(pattern)?;
        let calibration =
            Calibration::new(&pattern, &Response::new(form, pattern.shortest_exposure() as f64)?);
        Ok(Self { name: format!("{} {response}", pattern.name()), calibration })
    }

    /// All patterns, and for the default one responses that bend: steep, flat, and nearly vertical.
    pub fn all() -> Result<Vec<Self>> {
        let linear = Pattern::NAMES.into_iter().map(|name| Self::new(name, "linear", Form::Linear));
        let vertical = vec![(0.0, 0.0), (0.3, 0.1), (0.300_001, 0.9), (0.9, 0.900_001), (1.0, 1.0)];
        let flat = vec![(0.0, 0.0), (0.2, 0.4), (0.8, 0.4), (0.81, 0.99), (1.0, 1.0)];
        let bent = [
            ("gamma 2.2", Form::Gamma(2.2)),
            ("gamma 10", Form::Gamma(10.0)),
            ("gamma 0.1", Form::Gamma(0.1)),
            ("soft knee 0.75", Form::SoftKnee(0.75)),
            ("vertical table", Form::Table(vertical)),
            ("flat table", Form::Table(flat)),
        ];
        let bent = bent.into_iter().map(|(name, form)| Self::new("mpve-1-4", name, form));
        linear.chain(bent).collect()
    }
}

/// A small net in which every kernel occurs, behind a normalisation where it can be.
pub fn every_kernel() -> Result<Model> {
    let json = r#"{"version": 1, "name": "every-kernel", "pattern": "any",
        "window": {"frames": 4, "lead": 1, "hop": 2}, "nodes": [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {"name": "logs", "op": "log_irradiance", "inputs": ["measurement"]},
        {"name": "features", "op": "features", "inputs": ["measurement", "estimate", "logs"], "channels":
            ["log_irradiance", "log_estimate", "measurement", "saturated", "log_exposure"],
            "neighbours": [-1, 1], "block": [1, 1, 1]},
        {"name": "conv", "op": "conv3d", "inputs": ["features"], "out_channels": 12, "kernel": [3, 3, 3],
            "stride": [1, 2, 2], "activation": {"leaky_relu": 0.2}, "norm": true},
        {"name": "wide", "op": "conv3d", "inputs": ["conv"], "out_channels": 8, "kernel": [1, 3, 3],
            "stride": [1, 1, 1], "activation": {"leaky_relu": 0.2}, "norm": true},
        {"name": "up", "op": "conv_transpose3d", "inputs": ["wide"], "out_channels": 8, "kernel": [1, 4, 4],
            "stride": [1, 2, 2], "activation": {"leaky_relu": 0.2}, "norm": true},
        {"name": "kernels", "op": "conv3d", "inputs": ["up"], "out_channels": 4, "kernel": [1, 3, 3],
            "stride": [1, 1, 1], "activation": "none", "norm": true},
        {"name": "blended", "op": "blend", "inputs": ["kernels", "logs", "estimate"], "block": [1, 1, 1],
            "taps": [[0, -1, 0], [-1, 0, 1], [1, 1, -1]]},
        {"name": "ldr", "op": "conv3d", "inputs": ["up"], "out_channels": 3, "kernel": [1, 3, 3],
            "stride": [1, 1, 1], "activation": "sigmoid"},
        {"name": "irradiance", "op": "inverse_response", "inputs": ["ldr"], "exposures": [2, 4, 8]},
        {"name": "weights", "op": "conv3d", "inputs": ["irradiance"], "out_channels": 3, "kernel": [1, 1, 1],
            "stride": [1, 1, 1], "activation": {"softplus": 0.0001}},
        {"name": "result", "op": "fuse", "inputs": ["weights", "irradiance"]}], "output": "result"}"#;
    Ok(Model::random(Graph::from_json(json)?, 5)?)
}

/// A preset with its trained weights, or random ones where it has none.
pub fn preset(name: &str) -> Result<Model> {
    let preset = presets::by_name(name)?;
    if preset.trained { Model::load(name) } else { Ok(Model::random(preset.graph()?, 1)?) }
}

/// A net under stress.
pub struct Trial<'a> {
    /// The net before its weights are changed.
    pub model: &'a Model,
    /// What is done to them.
    pub weights: WeightStress,
    /// The camera.
    pub camera: &'a NamedCalibration,
    /// Rows and columns, multiples of the net's granularity.
    pub extent: [usize; 2],
}

/// How far a step of a trial went.
#[derive(Clone, Debug, Serialize)]
pub struct StressedStep {
    /// Its name.
    pub step: String,
    /// Its kernel.
    pub kernel: &'static str,
    /// Largest error as a fraction of its bound.
    pub fraction: f64,
    /// Largest magnitude of its results.
    pub magnitude: f32,
}

/// What came out of a trial with one input.
#[derive(Clone, Debug, Serialize)]
pub struct TrialOutcome {
    /// Name of the net.
    pub net: String,
    /// What was done to its weights.
    pub weights: WeightStress,
    /// Pattern and response.
    pub camera: String,
    /// Rows and columns.
    pub extent: [usize; 2],
    /// The pixel values.
    pub input: Input,
    /// `gpu` or `cpu`.
    pub executor: &'static str,
    /// `f32` or `f16`.
    pub precision: &'static str,
    /// The steps in order.
    pub steps: Vec<StressedStep>,
    /// PSNR in dB of irradiance against the f64 oracle, peak 1.
    pub psnr_db: Option<f64>,
    /// Steps whose results are stored in larger units, since f16 could not hold them, and the units.
    pub rescaled: Vec<(String, f32)>,
}

impl TrialOutcome {
    /// The largest error of a step as a fraction of its bound.
    pub fn fraction(&self) -> f64 {
        self.steps.iter().map(|step| step.fraction).fold(0.0, f64::max)
    }

    /// What it was, in words.
    pub fn what(&self) -> String {
        let Self { net, weights, input, camera, executor, precision, .. } = self;
        format!("{net}, {weights:?} weights, {input:?} input, {camera}, {executor} {precision}")
    }
}

impl Trial<'_> {
    /// Runs the trial with several inputs.
    pub fn run(&self, backend: &Backend, inputs: &[Input]) -> Result<Vec<TrialOutcome>> {
        let mut model = self.model.clone();
        self.weights.apply(&mut model);
        let [height, width] = self.extent;
        let plan = Plan::lower(&model, height, width)?;
        let calibration = &self.camera.calibration;
        let outcome = |input: Input| TrialOutcome {
            net: model.graph.name.clone(),
            weights: self.weights,
            camera: self.camera.name.clone(),
            extent: self.extent,
            input,
            executor: backend.name(),
            precision: backend.precision().name(),
            steps: Vec::new(),
            psnr_db: None,
            rescaled: Vec::new(),
        };
        let mut executor = backend.executor(plan.clone(), calibration, false)?;
        let mut oracle = CpuExecutor::<f64>::new(plan.clone(), calibration.clone());
        // Not at the beginning of the pattern.
        let schedule = 3;
        let mut result = vec![0.0; plan.result.shape.len()];
        let mut exact = result.clone();
        let one = |&input: &Input| -> Result<TrialOutcome> {
            let mut outcome = outcome(input);
            let measurement = input.values(plan.measurement.shape, calibration, schedule);
            executor.run(&measurement, schedule, &mut result)?;
            outcome.rescaled = executor.rescaled();
            if let Some(at) = result.iter().position(|p| !p.is_finite()) {
                let problem = format!("{}: value {at} is {}", outcome.what(), result[at]);
                return Err(CheckFailed(problem).into());
            }
            oracle.run(&measurement, schedule, &mut exact)?;
            outcome.psnr_db = Some(psnr([(&exact[..], &result[..])].into_iter(), width));
            let errors =
                step_errors(&mut *executor, calibration, &measurement, schedule, backend.precision())?;
            let step = |error: crate::cpu::bound::StepError| StressedStep {
                step: error.step,
                kernel: error.kernel,
                fraction: error.fraction,
                magnitude: error.magnitude,
            };
            outcome.steps = errors.into_iter().map(step).collect();
            Ok(outcome)
        };
        inputs.iter().map(one).collect()
    }
}

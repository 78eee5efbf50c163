//! What the GPU tests share: an adapter, small graphs, measurements, and the comparison with the CPU twins.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use pix2hdr::cpu;
use pix2hdr::gpu::{AdapterChoice, Gpu, GpuExecutor};
use pix2hdr::network::{Executor, Graph, Kernel, Model, Plan, Step, Tensor};
use pix2hdr::sensor::{Calibration, Form, Pattern, Response};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The real GPU if there is one, else software Vulkan. Tests do not pass without either.
pub fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| {
        let choice = AdapterChoice { substring: None, allow_software: true };
        Gpu::open(&choice).unwrap_or_else(|error| {
            panic!("the GPU tests need a Vulkan driver; mesa-vulkan-drivers has a software one: {error}")
        })
    })
}

/// Tables of the default camera, with a response that bends.
pub fn calibration() -> Calibration {
    let pattern = Pattern::built_in("mpve-1-4").unwrap();
    let saturation = pattern.shortest_exposure() as f64;
    Calibration::new(&pattern, &Response::new(Form::Gamma(2.2), saturation).unwrap())
}

/// Random pixel values with dark and saturated ones, and a saturated corner.
pub fn measurement(plan: &Plan, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let shape = plan.measurement.shape;
    (0..shape.len())
        .map(|index| {
            let (y, x) = (index / shape.x % shape.y, index % shape.x);
            let value = rng.random_range(-0.1..1.1f32).clamp(0.0, 1.0);
            if y < 5 && x < 5 && shape.y > 5 && shape.x > 5 { 1.0 } else { value }
        })
        .collect()
}

/// A plan with random weights for a graph and a size.
pub fn plan(graph: &str, height: usize, width: usize) -> Plan {
    let graph = Graph::from_json(graph).unwrap();
    Plan::lower_unaligned(&Model::random(graph, 1).unwrap(), height, width).unwrap()
}

/// A graph of `nodes` behind an estimate and `channels` feature channels a pixel, for windows of `frames` frames.
pub fn graph(frames: usize, channels: usize, nodes: &str, output: &str) -> String {
    let names = ["log_irradiance", "log_estimate", "measurement", "saturated", "log_exposure"];
    let features: Vec<String> = (0..channels).map(|i| format!("\"{}\"", names[i % names.len()])).collect();
    format!(
        r#"{{"version": 1, "name": "test", "pattern": "any",
        "window": {{"frames": {frames}, "lead": 0, "hop": {frames}}}, "nodes": [
        {{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}},
        {{"name": "features", "op": "features", "inputs": ["measurement", "estimate"],
          "channels": [{}], "block": [1, 1, 1]}}{}{nodes}], "output": "{output}"}}"#,
        features.join(", "),
        if nodes.is_empty() { "" } else { ", " }
    )
}

/// Name of a kernel, which is that of its shader and twin.
pub fn kernel_name(kernel: &Kernel) -> &'static str {
    match kernel {
        Kernel::BoxEstimate => "box_estimate",
        Kernel::Features { .. } => "features",
        Kernel::Conv3d(_) => "conv3d",
        Kernel::ConvTranspose3d(_) => "conv_transpose3d",
        Kernel::InverseResponse { .. } => "inverse_response",
        Kernel::Fuse => "fuse",
        Kernel::Unfold { .. } => "unfold",
    }
}

/// Largest error as a fraction of its bound, by kernel.
pub type Fractions = BTreeMap<&'static str, f64>;

/// Compares the output of each step with the f64 twin's on the step's own inputs, as the GPU read them.
pub fn fractions(executor: &mut GpuExecutor, measurement: &[f32], schedule: i64) -> Fractions {
    let calibration = calibration();
    let mut fractions = Fractions::new();
    let mut visit = |step: &Step, inputs: &[Tensor], output: &Tensor| {
        let inputs: Vec<Tensor<f64>> = inputs.iter().map(|input| input.map(|&v| f64::from(v))).collect();
        let exact = cpu::evaluate(&step.kernel, &inputs, output.shape, &calibration, schedule);
        let bound = cpu::bound::bound(&step.kernel, &inputs, &exact, &calibration, schedule, cpu::bound::F32);
        let fraction = cpu::bound::largest_fraction(output, &exact, &bound);
        let largest = fractions.entry(kernel_name(&step.kernel)).or_insert(0.0);
        *largest = fraction.max(*largest);
    };
    executor.trace(measurement, schedule, &mut visit).unwrap();
    fractions
}

/// Runs a plan on the GPU and compares it step by step.
pub fn compare(plan: Plan, schedule: i64) -> Fractions {
    let measurement = measurement(&plan, 2);
    let mut executor = GpuExecutor::new(gpu(), plan, &calibration()).unwrap();
    fractions(&mut executor, &measurement, schedule)
}

//! Speed of the GPU executor: convolutions by themselves, then presets.
//!
//! `cargo bench --bench gpu -- [PRESET …] [--size HEIGHTxWIDTH] [--adapter SUBSTRING] [--precision f16]
//! [--variant PIXELSxVECTORSxLANES[wide]]`, by
//! default no presets, 128×128 pixels, a real GPU if there is one, f32, and variants as the executor chooses them. Each time
//! is the shortest of several windows with upload and download. On Linux, the operations per second of processor time
//! are shown too: of software Vulkan they say more than wall time where other programs run.

use std::time::{Duration, Instant};

use pix2hdr::gpu::{AdapterChoice, Gpu, GpuExecutor, Options, Variant};
use pix2hdr::network::{Executor, Graph, Model, Plan, Precision, Shape, presets};
use pix2hdr::sensor::{Calibration, Form, Pattern, Response};

/// How long to repeat windows of one plan.
const PATIENCE: Duration = Duration::from_secs(3);

/// Convolutions: size [t, y, x], channels in and out, kernel.
const CONVOLUTIONS: [([usize; 3], usize, [usize; 3]); 3] =
    [([1, 64, 32], 96, [1, 3, 3]), ([8, 64, 64], 32, [3, 3, 3]), ([2, 32, 32], 128, [3, 3, 3])];

fn main() {
    // Cargo adds `--bench`.
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let (mut names, mut size, mut adapter, mut options) = (Vec::new(), [128, 128], None, Options::default());
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_else(|| panic!("{argument} wants a value"));
        match argument.as_str() {
            "--size" => size = numbers(&value()),
            "--precision" if value() == "f16" => options.precision = Precision::F16,
            "--variant" => options.variant = Some(variant(&value())),
            "--adapter" => adapter = Some(value()),
            _ => names.push(argument),
        }
    }
    let gpu = Gpu::open(&AdapterChoice { substring: adapter, allow_software: true }).expect("an adapter");
    println!("{}", gpu.adapter());
    for ([t, y, x], channels, kernel) in CONVOLUTIONS {
        let plan = convolution([t, y, x], channels, kernel);
        measure(&gpu, &format!("conv3d {channels} channels {kernel:?} {t}×{y}×{x}"), plan, &options);
    }
    for name in names {
        let graph = presets::by_name(&name).and_then(|preset| preset.graph()).expect("a preset");
        let model = Model::random(graph, 1).expect("a valid graph");
        let plan = Plan::lower(&model, size[0], size[1]).expect("a size that the preset accepts");
        measure(&gpu, &format!("{name} {}×{}", size[0], size[1]), plan, &options);
    }
}

/// Numbers with an x between them.
fn numbers<const N: usize>(text: &str) -> [usize; N] {
    let parts: Vec<usize> = text.split('x').map(|part| part.parse().expect("a number")).collect();
    parts.try_into().expect("as many numbers as wanted")
}

/// A variant such as 4x8x8wide.
fn variant(text: &str) -> Variant {
    let (text, wide) = text.strip_suffix("wide").map_or((text, false), |text| (text, true));
    let [pixels, vectors, lanes] = numbers(text);
    Variant { pixels, vectors, lanes, wide }
}

/// A plan of one convolution, with a result of one value.
fn convolution([t, y, x]: [usize; 3], channels: usize, kernel: [usize; 3]) -> Plan {
    let graph = format!(
        r#"{{"version": 1, "name": "convolution", "pattern": "any",
        "window": {{"frames": {t}, "lead": 0, "hop": {t}}}, "nodes": [
        {{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}},
        {{"name": "features", "op": "features", "inputs": ["measurement", "estimate"],
          "channels": ["measurement"], "block": [1, 1, 1]}},
        {{"name": "input", "op": "conv3d", "inputs": ["features"], "out_channels": {channels},
          "kernel": [1, 1, 1], "stride": [1, 1, 1], "activation": "none"}},
        {{"name": "result", "op": "conv3d", "inputs": ["input"], "out_channels": {channels},
          "kernel": {kernel:?}, "stride": [1, 1, 1], "activation": {{"leaky_relu": 0.2}}}}],
        "output": "result"}}"#
    );
    let model = Model::random(Graph::from_json(&graph).expect("a valid graph"), 1).expect("a valid graph");
    let mut plan = Plan::lower_unaligned(&model, y, x).expect("any size");
    plan.steps.drain(..plan.steps.len() - 1);
    plan.result.shape = Shape { t: 1, y: 1, x: 1, c: 1 };
    plan
}

fn measure(gpu: &Gpu, what: &str, plan: Plan, options: &Options<'_>) {
    let pattern = Pattern::built_in("mpve-1-4").expect("a built-in pattern");
    let response = Response::new(Form::Linear, pattern.shortest_exposure() as f64).expect("a response");
    let calibration = Calibration::new(&pattern, &response);
    let (gflop, frames) = (plan.flop() / 1e9, plan.window.hop as f64);
    let measurement = vec![0.5; plan.measurement.shape.len()];
    let mut result = vec![0.0; plan.result.shape.len()];
    let begun = Instant::now();
    let mut executor = GpuExecutor::with_options(gpu, plan, &calibration, options).expect("a plan that fits");
    executor.run(&measurement, 0, &mut result).expect("a run");
    let first = begun.elapsed();
    let (mut shortest, mut windows) = (Duration::MAX, 0);
    let (begun, processor) = (Instant::now(), processor_time());
    while windows < 3 || begun.elapsed() < PATIENCE {
        let started = Instant::now();
        executor.run(&measurement, 0, &mut result).expect("a run");
        shortest = shortest.min(started.elapsed());
        windows += 1;
    }
    let seconds = shortest.as_secs_f64();
    let mut line = format!("{what}: {:.2} ms/frame, {:.1} GFLOP/s", 1e3 * seconds / frames, gflop / seconds);
    if let Some((before, after)) = processor.zip(processor_time()).filter(|(before, after)| after > before) {
        line += &format!(", {:.2} GFLOP per processor second", gflop * f64::from(windows) / (after - before));
    }
    println!("{line} (made and first run in {:.1} s)", first.as_secs_f64());
}

/// Processor time of this process in seconds: fields 14 and 15 of /proc/self/stat, in hundredths of a second.
fn processor_time() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let ticks = stat.rsplit_once(')')?.1.split_whitespace().skip(11).take(2);
    ticks.map(|field| field.parse::<f64>().ok()).sum::<Option<f64>>().map(|ticks| ticks / 100.0)
}

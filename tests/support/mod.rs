//! What the GPU tests share: an adapter, a camera, small graphs and measurements.

use std::sync::OnceLock;

use pix2hdr::gpu::{AdapterChoice, Gpu, Variant};
use pix2hdr::network::{Graph, Model, Plan};
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

/// Ways to divide a convolution that the adapter can run, whatever the layer: blocks of all shapes, alone and in teams,
/// with narrow and wide loads.
#[allow(dead_code, reason = "each test file uses a part of this module")]
pub fn variants() -> Vec<Variant> {
    let [_, lanes] = gpu().adapter().subgroup_sizes;
    let all = [
        (1, 1, 1, false),
        (3, 3, 1, true),
        (8, 2, 1, false),
        (1, 1, lanes, true),
        (3, 2, lanes, false),
        (2, 8, lanes, true),
    ]
    .map(|(pixels, vectors, lanes, wide)| Variant { pixels, vectors, lanes: lanes as usize, wide });
    let supported: Vec<Variant> = all.into_iter().filter(|&variant| gpu().supports(variant)).collect();
    let software = gpu().adapter().is_software();
    assert!(!software || supported.len() == all.len(), "software Vulkan runs {supported:?} only");
    supported
}

/// Tables of a camera with different exposures at all places and times of its pattern, and a response that bends.
pub fn calibration() -> Calibration {
    let exposures = (0..5 * 3 * 2).map(|i| (1 + 7 * i % 31) as f32).collect();
    let pattern = Pattern::built_in("mpve-1-4").unwrap();
    let saturation = pattern.shortest_exposure() as f64;
    let tables = Calibration::new(&pattern, &Response::new(Form::Gamma(2.2), saturation).unwrap());
    Calibration::from_tables([5, 3, 2], exposures, tables.inverse_response().to_vec()).unwrap()
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

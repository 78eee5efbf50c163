//! Every shader against its CPU twin at f64, within derived bounds (DESIGN §7).
//!
//! Each test prints the largest error as a fraction of its bound; `--nocapture` shows them.

mod support;

use pix2hdr::gpu::GpuExecutor;
use pix2hdr::network::{Graph, Model, Plan};
use support::{Fractions, calibration, compare, fractions, gpu, graph, measurement, plan};

/// Fails if a step left its bound, or if `kernel` did not run.
fn assert_within_bounds(what: &str, fractions: &Fractions, kernels: &[&str]) {
    println!("{what}: {fractions:.3?}");
    for (kernel, fraction) in fractions {
        assert!(*fraction <= 1.0, "{what}: {kernel} is off by {fraction:.3} times its bound");
    }
    for kernel in kernels {
        assert!(fractions.contains_key(kernel), "{what}: {kernel} did not run");
    }
}

/// A convolution node behind the features.
fn convolution(op: &str, out_channels: usize, kernel: [usize; 3], stride: [usize; 3], more: &str) -> String {
    format!(
        r#"{{"name": "result", "op": "{op}", "inputs": ["features"], "out_channels": {out_channels},
        "kernel": {kernel:?}, "stride": {stride:?}, {more}}}"#
    )
}

const PLAIN: &str = r#""activation": "none""#;

/// Sizes [t, y, x]: single pixels, single rows and columns, primes, and widths around the blocks of invocations.
const SIZES: [[usize; 3]; 8] =
    [[1, 1, 1], [1, 1, 17], [1, 13, 1], [5, 1, 2], [2, 3, 7], [1, 5, 8], [3, 7, 9], [1, 2, 67]];

#[test]
fn box_estimate_and_features() {
    let mut sizes = SIZES.to_vec();
    sizes.extend([[1, 2, 2], [9, 11, 13]]);
    for ([t, y, x], schedule) in sizes.into_iter().zip([0, 1, 7, -3, 1_000_003, i64::MIN, i64::MAX, 5, 6, 2])
    {
        for channels in [1, 2, 3, 5, 11, 16] {
            let plan = plan(&graph(t, channels, "", "features"), y, x);
            let what = format!("features {t}×{y}×{x}, {channels} channels");
            assert_within_bounds(&what, &compare(plan, schedule), &["box_estimate", "features"]);
        }
    }
}

#[test]
fn folded_features_and_unfold() {
    for (block, [t, y, x]) in
        [([1, 1, 1], [2, 3, 5]), ([2, 2, 2], [4, 6, 10]), ([4, 2, 4], [8, 6, 20]), ([3, 1, 5], [3, 7, 15])]
    {
        let channels: usize = block.iter().product();
        let nodes = format!(
            r#"{{"version": 1, "name": "test", "pattern": "any",
            "window": {{"frames": {t}, "lead": 0, "hop": {t}}}, "nodes": [
            {{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}},
            {{"name": "folded", "op": "features", "inputs": ["measurement", "estimate"],
              "channels": ["log_exposure", "log_estimate", "saturated"], "block": {block:?}}},
            {{"name": "residual", "op": "conv3d", "inputs": ["folded"], "out_channels": {channels},
              "kernel": [1, 1, 1], "stride": [1, 1, 1], "activation": "none"}},
            {{"name": "result", "op": "unfold", "inputs": ["residual", "estimate"], "block": {block:?},
              "start": 0}}], "output": "result"}}"#
        );
        let what = format!("block {block:?} of {t}×{y}×{x}");
        assert_within_bounds(&what, &compare(plan(&nodes, y, x), 3), &["features", "unfold"]);
    }
}

#[test]
fn unfold_of_a_part_of_the_window() {
    let nodes = r#"{"version": 1, "name": "test", "pattern": "any",
        "window": {"frames": 6, "lead": 1, "hop": 2}, "nodes": [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {"name": "folded", "op": "features", "inputs": ["measurement", "estimate"],
          "channels": ["log_estimate"], "block": [6, 1, 1]},
        {"name": "residual", "op": "conv3d", "inputs": ["folded"], "out_channels": 2,
          "kernel": [1, 1, 1], "stride": [1, 1, 1], "activation": "none"},
        {"name": "result", "op": "unfold", "inputs": ["residual", "estimate"], "block": [2, 1, 1],
          "start": 1}], "output": "result"}"#;
    assert_within_bounds("unfold from frame 1", &compare(plan(nodes, 3, 5), 3), &["unfold"]);
}

#[test]
fn conv3d_of_all_sizes() {
    for [t, y, x] in SIZES {
        for (kernel, stride) in [([1, 1, 1], [1, 1, 1]), ([3, 3, 3], [1, 1, 1]), ([3, 3, 3], [2, 2, 2])] {
            let nodes = convolution("conv3d", 6, kernel, stride, PLAIN);
            let what = format!("conv3d {kernel:?} stride {stride:?} of {t}×{y}×{x}");
            assert_within_bounds(&what, &compare(plan(&graph(t, 5, &nodes, "result"), y, x), 0), &["conv3d"]);
        }
    }
}

#[test]
fn conv3d_of_all_channels() {
    for in_channels in [1, 2, 3, 4, 5, 8, 13] {
        for out_channels in [1, 3, 4, 5, 8, 12, 17] {
            let nodes = convolution("conv3d", out_channels, [1, 3, 3], [1, 1, 1], PLAIN);
            let what = format!("conv3d {in_channels} → {out_channels} channels");
            let plan = plan(&graph(2, in_channels, &nodes, "result"), 5, 11);
            assert_within_bounds(&what, &compare(plan, 0), &["conv3d"]);
        }
    }
}

#[test]
fn conv3d_of_all_kernels_and_strides() {
    for kernel in [[7, 7, 7], [1, 3, 3], [3, 1, 1], [1, 1, 5], [5, 3, 1]] {
        for stride in [[1, 1, 1], [2, 2, 2], [1, 2, 3], [4, 1, 2]] {
            let nodes = convolution("conv3d", 5, kernel, stride, PLAIN);
            let what = format!("conv3d {kernel:?} stride {stride:?}");
            assert_within_bounds(
                &what,
                &compare(plan(&graph(5, 3, &nodes, "result"), 9, 13), 0),
                &["conv3d"],
            );
        }
    }
}

#[test]
fn conv_transpose3d_of_all_kernels_and_strides() {
    let kernels = [
        ([4, 4, 4], [2, 2, 2]),
        ([3, 3, 3], [1, 1, 1]),
        ([2, 2, 2], [2, 2, 2]),
        ([1, 4, 4], [1, 2, 2]),
        ([3, 5, 4], [3, 1, 4]),
        ([5, 3, 6], [1, 3, 2]),
    ];
    for [t, y, x] in SIZES {
        for (kernel, stride) in kernels {
            let nodes = convolution("conv_transpose3d", 5, kernel, stride, PLAIN);
            let what = format!("conv_transpose3d {kernel:?} stride {stride:?} of {t}×{y}×{x}");
            let plan = plan(&graph(t, 3, &nodes, "result"), y, x);
            assert_within_bounds(&what, &compare(plan, 0), &["conv_transpose3d"]);
        }
    }
    for (in_channels, out_channels) in [(1, 1), (4, 8), (13, 17)] {
        let nodes = convolution("conv_transpose3d", out_channels, [4, 4, 4], [2, 2, 2], PLAIN);
        let what = format!("conv_transpose3d {in_channels} → {out_channels} channels");
        let plan = plan(&graph(2, in_channels, &nodes, "result"), 5, 9);
        assert_within_bounds(&what, &compare(plan, 0), &["conv_transpose3d"]);
    }
}

#[test]
fn epilogues() {
    let activations = [
        r#""none""#,
        r#"{"leaky_relu": 0.2}"#,
        r#"{"leaky_relu": -1.5}"#,
        r#""sigmoid""#,
        r#"{"softplus": 0.001}"#,
    ];
    for op in ["conv3d", "conv_transpose3d"] {
        for activation in activations {
            for (norm, add) in [(false, false), (true, false), (false, true), (true, true)] {
                let add_key = if add { r#", "add": "features""# } else { "" };
                let more = format!(r#""activation": {activation}, "norm": {norm}{add_key}"#);
                let nodes = convolution(op, 6, [1, 3, 3], [1, 1, 1], &more);
                let what = format!("{op} {more}");
                let plan = plan(&graph(2, 6, &nodes, "result"), 4, 9);
                assert_within_bounds(&what, &compare(plan, 0), &[op]);
            }
        }
    }
}

#[test]
fn rendered_exposures_are_fused() {
    for n in [1, 2, 3, 4, 5] {
        let exposures: Vec<usize> = (0..n).map(|i| 2 << i).collect();
        let nodes = format!(
            r#"{{"name": "ldr", "op": "conv3d", "inputs": ["features"], "out_channels": {n},
              "kernel": [1, 3, 3], "stride": [1, 1, 1], "activation": "sigmoid"}},
            {{"name": "irradiance", "op": "inverse_response", "inputs": ["ldr"], "exposures": {exposures:?}}},
            {{"name": "weights", "op": "conv3d", "inputs": ["irradiance"], "out_channels": {n},
              "kernel": [1, 1, 1], "stride": [1, 1, 1], "activation": {{"softplus": 0.001}}}},
            {{"name": "result", "op": "fuse", "inputs": ["weights", "irradiance"]}}"#
        );
        let what = format!("{n} rendered exposures");
        let fractions = compare(plan(&graph(2, 3, &nodes, "result"), 7, 11), 0);
        assert_within_bounds(&what, &fractions, &["inverse_response", "fuse"]);
    }
}

#[test]
fn concatenations_are_read_and_written_in_place() {
    let layer = |name: &str, input: &str, out: usize| {
        format!(
            r#"{{"name": "{name}", "op": "conv3d", "inputs": ["{input}"], "out_channels": {out},
            "kernel": [1, 3, 3], "stride": [1, 1, 1], "activation": {{"leaky_relu": 0.2}}}}"#
        )
    };
    let nodes = [
        layer("a", "features", 8),
        layer("b", "features", 4),
        layer("c", "features", 5),
        r#"{"name": "all", "op": "concat", "inputs": ["a", "b", "c"]}"#.to_owned(),
        // Reads a part, with the stride of the whole.
        layer("d", "b", 3),
        layer("e", "all", 6),
        r#"{"name": "two", "op": "concat", "inputs": ["e_wide", "d_wide"]}"#.to_owned(),
        layer("result", "two", 7),
    ];
    let mut nodes = nodes.to_vec();
    nodes.insert(6, layer("e_wide", "e", 4));
    nodes.insert(7, layer("d_wide", "d", 2));
    let plan = plan(&graph(2, 3, &nodes.join(", "), "result"), 5, 9);
    assert_within_bounds("concatenations", &compare(plan, 0), &["conv3d"]);
}

/// More workgroups than one dimension of a dispatch holds.
#[test]
fn a_frame_of_more_than_four_million_pixels() {
    let json = r#"{"version": 1, "name": "test", "pattern": "any",
        "window": {"frames": 1, "lead": 0, "hop": 1}, "nodes": [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}], "output": "estimate"}"#;
    let plan = plan(json, 2053, 2063);
    assert!(plan.measurement.shape.pixels() > 65535 * 64);
    assert_within_bounds("2053×2063 pixels", &compare(plan, 0), &["box_estimate"]);
}

/// All presets, step by step.
#[test]
fn presets() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("weights-format/presets");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let graph = Graph::from_json(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let [_, gy, gx] = graph.granularity().unwrap();
        let name = graph.name.clone();
        let model = Model::random(graph, 1).unwrap();
        let plan = Plan::lower(&model, 12usize.next_multiple_of(gy), 20usize.next_multiple_of(gx)).unwrap();
        let flop = plan.flop();
        let fractions = compare(plan, 5);
        assert_within_bounds(&format!("preset {name} ({:.2} GFLOP)", flop / 1e9), &fractions, &["conv3d"]);
        names.push(name);
    }
    for name in ["fast", "paper"] {
        assert!(names.iter().any(|n| n == name), "preset '{name}' was not among {names:?}");
    }
}

/// A comparison is worth something only if it fails where a shader is wrong.
#[test]
fn broken_shaders_are_caught() {
    let nodes = format!(
        "{}, {}, {}",
        r#"{"name": "a", "op": "conv3d", "inputs": ["features"], "out_channels": 6, "kernel": [3, 3, 3],
            "stride": [1, 1, 2], "activation": {"leaky_relu": 0.2}, "norm": true}"#,
        r#"{"name": "b", "op": "conv_transpose3d", "inputs": ["a"], "out_channels": 2, "kernel": [1, 1, 4],
            "stride": [1, 1, 2], "activation": "sigmoid"}"#,
        r#"{"name": "c", "op": "inverse_response", "inputs": ["b"], "exposures": [2, 4]},
           {"name": "d", "op": "conv3d", "inputs": ["c"], "out_channels": 2, "kernel": [1, 1, 1],
            "stride": [1, 1, 1], "activation": {"softplus": 0.001}, "add": "b"},
           {"name": "e", "op": "conv3d", "inputs": ["d"], "out_channels": 1, "kernel": [1, 1, 1],
            "stride": [1, 1, 1], "activation": "none"},
           {"name": "f", "op": "unfold", "inputs": ["e", "estimate"], "block": [1, 1, 1], "start": 0},
           {"name": "result", "op": "fuse", "inputs": ["d", "c"]}"#,
    );
    let json = graph(3, 3, &nodes, "result");
    let mutants = [
        ("box_estimate", "2 * (n - 1) - i", "n - 1"),
        ("box_estimate", "measured < SATURATED", "measured <= 1.0"),
        ("box_estimate", "% PATTERN_PERIOD", "% (PATTERN_PERIOD + 1)"),
        ("features", "channel % CHANNELS", "(channel + 1) % CHANNELS"),
        ("features", "MU * p", "MU * p * 1.00001"),
        ("conv3d", "tap_y - PADDING_Y", "tap_y - PADDING_Y + 1"),
        ("conv3d", "tap_t * KERNEL_Y + tap_y", "tap_y * KERNEL_T + tap_t"),
        ("conv3d", "in_x_0 < INPUT_X", "in_x_0 <= INPUT_X"),
        ("conv3d", "in_0.y * weight_1_0", "in_0.y * weight_0_0"),
        ("conv3d", "terms[WEIGHT_VECTORS + vector]", "terms[vector]"),
        ("conv3d", "pixel * ADDED_STRIDE", "(pixel + 1) * ADDED_STRIDE"),
        ("conv3d", "max(v, vec4<f32>())", "v"),
        ("conv3d", "ACTIVATION_PARAMETER * v", "0.2001 * v"),
        ("conv_transpose3d", "(phase_x + PADDING_X) % STRIDE_X", "phase_x % STRIDE_X"),
        ("conv_transpose3d", "y * STRIDE_Y + phase_y", "y * STRIDE_Y + phase_x"),
        ("conv_transpose3d", "abs(v)", "v"),
        ("inverse_response", "index + 1u", "index"),
        ("inverse_response", "rendered_exposures[i]", "rendered_exposures[0]"),
        ("fuse", "WEIGHTS_C + i", "i"),
        ("unfold", ") + d", ") - d"),
    ];
    let sound = compare(plan(&json, 5, 10), 0);
    assert_within_bounds("sound shaders", &sound, &mutants.map(|(kernel, ..)| kernel));
    for (kernel, correct, wrong) in mutants {
        let plan = plan(&json, 5, 10);
        let measurement = measurement(&plan, 2);
        let edited = std::cell::Cell::new(false);
        let edit = |step: &pix2hdr::network::Step, text: String| {
            if support::kernel_name(&step.kernel) != kernel {
                return text;
            }
            let broken = text.replace(correct, wrong);
            edited.set(edited.get() || broken != text);
            broken
        };
        let mut executor = GpuExecutor::with_edited_shaders(gpu(), plan, &calibration(), edit).unwrap();
        assert!(edited.get(), "{kernel} has no '{correct}' to break");
        let fraction = fractions(&mut executor, &measurement, 0)[kernel];
        println!("{kernel} with '{wrong}': {fraction:.1} times its bound");
        assert!(fraction > 1.0, "nobody notices that {kernel} has '{wrong}' in place of '{correct}'");
    }
}

//! Every shader against its CPU twin at f64, within derived bounds (design §7).
//!
//! Each test prints the largest error as a fraction of its bound; `--nocapture` shows them.

mod support;

use std::cell::Cell;
use std::collections::BTreeMap;

use pix2hdr::cpu::bound::{self, StepError};
use pix2hdr::gpu::{ExecutorOptions, GpuExecutor, Variant};
use pix2hdr::network::{Model, Plan, Precision, Step, presets};
use support::{calibration, gpu, graph, measurement, plan, variants};

/// Largest error as a fraction of its bound, by kernel.
type Fractions = BTreeMap<&'static str, f64>;

/// Compares the output of each step with the f64 twin's.
fn fractions(
    executor: &mut GpuExecutor,
    measurement: &[f32],
    schedule: i64,
    precision: Precision,
) -> Fractions {
    let mut fractions = Fractions::new();
    let errors = bound::step_errors(executor, &calibration(), measurement, schedule, precision).unwrap();
    for StepError { step, kernel, fraction, .. } in errors {
        if fraction > 1.0 {
            // In the order of the steps: the first of these lines is where the executors part.
            println!("step '{step}' ({kernel}) leaves its bound by a factor of {fraction:.3}");
        }
        let largest = fractions.entry(kernel).or_insert(0.0);
        *largest = fraction.max(*largest);
    }
    fractions
}

/// Runs a plan on the GPU at both precisions and compares it step by step.
fn compare(plan: Plan, schedule: i64) -> Fractions {
    compare_variant(plan, schedule, None)
}

/// As [`compare`], with convolutions divided in a given way.
fn compare_variant(plan: Plan, schedule: i64, variant: Option<Variant>) -> Fractions {
    let options = ExecutorOptions { variant, ..ExecutorOptions::default() };
    let mut largest = compare_with(plan.clone(), schedule, &options);
    let reduced = compare_with(plan, schedule, &ExecutorOptions { precision: Precision::F16, ..options });
    println!("f16: {reduced:.3?}");
    for (kernel, fraction) in reduced {
        let largest = largest.entry(kernel).or_insert(0.0);
        *largest = fraction.max(*largest);
    }
    largest
}

/// Runs a plan on the GPU with options and compares it step by step.
fn compare_with(plan: Plan, schedule: i64, options: &ExecutorOptions<'_>) -> Fractions {
    let measurement = measurement(&plan, 2);
    let mut executor = GpuExecutor::with_options(gpu(), plan, &calibration(), options).unwrap();
    fractions(&mut executor, &measurement, schedule, options.precision)
}

/// Fails if a step left its bound, or if one of `kernels` did not run.
fn assert_within_bounds(what: &str, fractions: &Fractions, kernels: &[&str]) {
    println!("{what}: {fractions:.3?}");
    for (kernel, fraction) in fractions {
        assert!(*fraction <= 1.0, "{what}: {kernel} is off by {fraction:.3} times its bound");
    }
    for kernel in kernels {
        assert!(fractions.contains_key(kernel), "{what}: {kernel} did not run");
    }
}

/// A convolution node.
fn layer(
    op: &str,
    name: &str,
    input: &str,
    out: usize,
    taps: ([usize; 3], [usize; 3]),
    more: &str,
) -> String {
    let (kernel, stride) = taps;
    format!(
        r#"{{"name": "{name}", "op": "{op}", "inputs": ["{input}"], "out_channels": {out},
        "kernel": {kernel:?}, "stride": {stride:?}, {more}}}"#
    )
}

const PLAIN: &str = r#""activation": "none""#;

/// A graph with one layer for each of several kernels and strides, all on the features.
fn layers(op: &str, frames: usize, channels: [usize; 2], taps: &[([usize; 3], [usize; 3])]) -> String {
    let nodes: Vec<String> = taps
        .iter()
        .enumerate()
        .map(|(i, &taps)| layer(op, &format!("layer{i}"), "features", channels[1], taps, PLAIN))
        .collect();
    graph(frames, channels[0], &nodes.join(", "), "layer0")
}

/// Sizes [t, y, x]: single pixels, single rows and columns, primes, and widths around the blocks of invocations.
const SIZES: [[usize; 3]; 8] =
    [[1, 1, 1], [1, 1, 17], [1, 13, 1], [5, 1, 2], [2, 3, 7], [1, 5, 8], [3, 7, 9], [1, 2, 67]];

/// Kernels and strides of convolutions: all shapes of kernel, and strides that do and do not divide the sizes.
const TAPS: [([usize; 3], [usize; 3]); 9] = [
    ([1, 1, 1], [1, 1, 1]),
    ([3, 3, 3], [1, 1, 1]),
    ([3, 3, 3], [2, 2, 2]),
    ([1, 3, 3], [1, 2, 3]),
    ([7, 7, 7], [1, 1, 1]),
    ([7, 1, 7], [2, 1, 2]),
    ([5, 3, 1], [1, 1, 1]),
    ([3, 1, 5], [1, 1, 2]),
    ([1, 1, 1], [4, 1, 2]),
];

/// The same for transposed convolutions.
const TRANSPOSED_TAPS: [([usize; 3], [usize; 3]); 7] = [
    ([4, 4, 4], [2, 2, 2]),
    ([3, 3, 3], [1, 1, 1]),
    ([2, 2, 2], [2, 2, 2]),
    ([1, 1, 1], [1, 1, 1]),
    ([1, 4, 4], [1, 2, 2]),
    ([3, 5, 4], [3, 1, 4]),
    ([5, 3, 6], [1, 3, 2]),
];

#[test]
fn box_estimate_and_features() {
    let schedules = [0, 1, 7, -3, 1_000_003, i64::MIN + 8, i64::MAX - 8, 5];
    for (index, ([t, y, x], schedule)) in SIZES.into_iter().zip(schedules).enumerate() {
        let channels = [2, 2, 3, 5, 8, 9, 11, 16][index];
        let what = format!("{channels} features of {t}×{y}×{x} from {schedule}");
        let fractions = compare(plan(&graph(t, channels, "", "features"), y, x), schedule);
        assert_within_bounds(&what, &fractions, &["box_estimate", "features"]);
    }
    let fractions = compare(plan(&graph(9, 5, "", "features"), 2, 2), 2);
    assert_within_bounds("9×2×2", &fractions, &["box_estimate", "features"]);
}

#[test]
fn folded_features() {
    for (block, [t, y, x]) in
        [([1, 1, 1], [2, 3, 5]), ([2, 2, 2], [4, 6, 10]), ([4, 2, 4], [8, 6, 20]), ([3, 1, 5], [3, 7, 15])]
    {
        let json = format!(
            r#"{{"version": 1, "name": "test", "pattern": "any",
            "window": {{"frames": {t}, "lead": 0, "hop": {t}}}, "nodes": [
            {{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}},
            {{"name": "logs", "op": "log_irradiance", "inputs": ["measurement"]}},
            {{"name": "folded", "op": "features", "inputs": ["measurement", "estimate", "logs"],
              "channels": ["log_exposure", "log_estimate", "saturated", "log_irradiance"],
              "neighbours": [-2, 1, -9], "block": {block:?}}}], "output": "folded"}}"#
        );
        let what = format!("block {block:?} of {t}×{y}×{x}");
        assert_within_bounds(&what, &compare(plan(&json, y, x), 3), &["features", "log_irradiance"]);
    }
}

/// A net that predicts kernels, with windows that the result needs the whole of or only a part.
#[test]
fn blend_of_a_part_of_the_window() {
    for ([by, bx], [y, x], [frames, lead, hop]) in [
        ([2, 4], [6, 12], [12, 4, 4]),
        ([1, 1], [1, 1], [1, 0, 1]),
        ([1, 3], [5, 9], [5, 2, 2]),
        ([3, 1], [9, 67], [4, 0, 4]),
    ] {
        let channels = 4 * by * bx;
        let json = format!(
            r#"{{"version": 1, "name": "test", "pattern": "any",
            "window": {{"frames": {frames}, "lead": {lead}, "hop": {hop}}}, "nodes": [
            {{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}},
            {{"name": "logs", "op": "log_irradiance", "inputs": ["measurement"]}},
            {{"name": "folded", "op": "features", "inputs": ["measurement", "estimate", "logs"],
              "channels": ["log_estimate", "saturated"], "neighbours": [-3], "block": [1, {by}, {bx}]}},
            {{"name": "weights", "op": "conv3d", "inputs": ["folded"], "out_channels": {channels},
              "kernel": [3, 1, 1], "stride": [1, 1, 1], "activation": "none"}},
            {{"name": "result", "op": "blend", "inputs": ["weights", "logs", "estimate"],
              "block": [1, {by}, {bx}], "taps": [[0, -1, 2], [-2, 0, 0], [3, 1, -1]]}}], "output": "result"}}"#
        );
        let what = format!("blend of blocks {by}×{bx}, {hop} of {frames} frames");
        assert_within_bounds(&what, &compare(plan(&json, y, x), 3), &["blend"]);
    }
}

#[test]
fn conv3d_of_all_sizes() {
    for [t, y, x] in SIZES {
        let fractions = compare(plan(&layers("conv3d", t, [5, 6], &TAPS[..3]), y, x), 0);
        assert_within_bounds(&format!("conv3d of {t}×{y}×{x}"), &fractions, &["conv3d"]);
    }
}

#[test]
fn conv3d_of_all_kernels_and_strides() {
    for variant in variants() {
        let plan = plan(&layers("conv3d", 4, [3, 13], &TAPS), 5, 19);
        let fractions = compare_variant(plan, 0, Some(variant));
        assert_within_bounds(&format!("conv3d as {variant:?}"), &fractions, &["conv3d"]);
    }
}

#[test]
fn conv_transpose3d_of_all_sizes() {
    for [t, y, x] in SIZES {
        let fractions = compare(plan(&layers("conv_transpose3d", t, [5, 6], &TRANSPOSED_TAPS[..2]), y, x), 0);
        assert_within_bounds(&format!("conv_transpose3d of {t}×{y}×{x}"), &fractions, &["conv_transpose3d"]);
    }
}

#[test]
fn conv_transpose3d_of_all_kernels_and_strides() {
    for variant in variants() {
        let plan = plan(&layers("conv_transpose3d", 2, [3, 13], &TRANSPOSED_TAPS), 5, 19);
        let fractions = compare_variant(plan, 0, Some(variant));
        let what = format!("conv_transpose3d as {variant:?}");
        assert_within_bounds(&what, &fractions, &["conv_transpose3d"]);
    }
}

#[test]
fn convolutions_of_all_channels() {
    for in_channels in [1, 2, 3, 4, 5, 8, 13] {
        for op in ["conv3d", "conv_transpose3d"] {
            let nodes = [1, 3, 4, 5, 8, 17]
                .map(|out| layer(op, &format!("to{out}"), "features", out, ([1, 3, 3], [1, 1, 1]), PLAIN));
            let plan = plan(&graph(2, in_channels, &nodes.join(", "), "to1"), 3, 11);
            let what = format!("{op} from {in_channels} channels");
            assert_within_bounds(&what, &compare(plan, 0), &[op]);
        }
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
        let mut nodes = Vec::new();
        for (i, activation) in activations.iter().enumerate() {
            for (norm, add) in
                [(false, ""), (true, ""), (false, r#", "add": "features""#), (true, r#", "add": "features""#)]
            {
                let more = format!(r#""activation": {activation}, "norm": {norm}{add}"#);
                let name = format!("layer{i}{norm}{}", add.len());
                nodes.push(layer(op, &name, "features", 6, ([1, 3, 3], [1, 1, 1]), &more));
            }
        }
        let plan = plan(&graph(2, 6, &nodes.join(", "), "layer0true0"), 4, 9);
        assert_within_bounds(&format!("epilogues of {op}"), &compare(plan, 0), &[op]);
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
        layer("conv3d", name, input, out, ([1, 3, 3], [1, 1, 1]), r#""activation": {"leaky_relu": 0.2}"#)
    };
    let nodes = [
        layer("a", "features", 8),
        layer("b", "features", 4),
        layer("c", "features", 5),
        r#"{"name": "all", "op": "concat", "inputs": ["a", "b", "c"]}"#.to_owned(),
        // Reads a part, with the stride of the whole.
        layer("d", "b", 4),
        layer("e", "all", 2),
        r#"{"name": "two", "op": "concat", "inputs": ["d", "e"]}"#.to_owned(),
        layer("result", "two", 7),
    ];
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

/// All presets with random weights, step by step.
#[test]
fn all_presets() {
    for preset in presets::all() {
        let graph = preset.graph().unwrap();
        let [_, gy, gx] = graph.granularity().unwrap();
        let model = Model::random(graph, 1).unwrap();
        let plan = Plan::lower(&model, 12usize.next_multiple_of(gy), 20usize.next_multiple_of(gx)).unwrap();
        assert_within_bounds(&format!("preset {}", preset.name), &compare(plan, 5), &["conv3d"]);
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
           {"name": "e", "op": "conv3d", "inputs": ["d"], "out_channels": 3, "kernel": [1, 1, 1],
            "stride": [1, 1, 1], "activation": "none"},
           {"name": "logs", "op": "log_irradiance", "inputs": ["measurement"]},
           {"name": "near", "op": "features", "inputs": ["measurement", "estimate", "logs"],
            "channels": ["saturated"], "neighbours": [-1, 1], "block": [1, 1, 1]},
           {"name": "f", "op": "blend", "inputs": ["e", "logs", "estimate"], "block": [1, 1, 1],
            "taps": [[0, 1, 0], [-1, 0, 1]]},
           {"name": "result", "op": "fuse", "inputs": ["d", "c"]}"#,
    );
    let json = graph(3, 3, &nodes, "result");
    let mutants = [
        ("box_estimate", "2 * (n - 1) - i", "n - 1"),
        ("box_estimate", "measured < SATURATED", "measured <= 1.0"),
        ("box_estimate", "(i32(schedule.x) + frame)", "frame"),
        ("box_estimate", "y % PATTERN_ROWS", "y % PATTERN_COLS"),
        ("features", "channel % CHANNELS", "(channel + 1) % CHANNELS"),
        ("features", "MU * p", "MU * p * 1.00001"),
        ("conv3d", "STRIDE_Y - PADDING_Y", "STRIDE_Y - PADDING_Y + 1"),
        ("conv3d", "(t * KERNEL_Y + y) * KERNEL_X", "(y * KERNEL_T + t) * KERNEL_X"),
        ("conv3d", "x >= 0 &&", "x >= -1 &&"),
        ("conv3d", "vec4<f32>(column[p][i]), row[i]", "vec4<f32>(column[p][i]), row[i & 2]"),
        ("conv3d", "terms[TERM_VECTORS + vector]", "terms[vector]"),
        ("conv3d", "pixel * ADDED_STRIDE", "(pixel + 1) * ADDED_STRIDE"),
        ("conv3d", "max(v, vec4<f32>())", "v"),
        ("conv3d", "ACTIVATION_PARAMETER * v", "0.2001 * v"),
        // Sums are rounded to f16 at each tap.
        (
            "conv3d",
            "var weight =",
            "(*sums)[0][0] = vec4<f32>(unpack2x16float(pack2x16float((*sums)[0][0].xy)), \
             unpack2x16float(pack2x16float((*sums)[0][0].zw))); $0",
        ),
        ("conv_transpose3d", "(phase_x + PADDING_X) % STRIDE_X", "phase_x % STRIDE_X"),
        ("conv_transpose3d", "STRIDE_Y + phase_y", "STRIDE_Y + phase_x"),
        ("conv_transpose3d", "abs(v)", "v"),
        ("inverse_response", "index + 1u", "index"),
        ("inverse_response", "RENDERED_EXPOSURES[i]", "RENDERED_EXPOSURES[0]"),
        ("fuse", "WEIGHTS_C + i", "i"),
        ("log_irradiance", "first_frame + t", "first_frame"),
        ("features", "pixel_t + FRAME_OFFSETS", "pixel_t - FRAME_OFFSETS"),
        ("features", "(frame * geometry.logs_y", "(pixel_t * geometry.logs_y"),
        ("blend", "- pixel.base)", ")"),
        ("blend", "y < geometry.logs_y", "y < geometry.logs_y - 1"),
        ("blend", "pixel.t + dt", "pixel.t"),
        ("blend", "weight(pixel, TAPS)", "weight(pixel, 0)"),
    ];
    // At f16, what packs and unpacks four channels is part of the text too.
    let reduced_mutants = [
        ("conv3d", "pack2x16float(c.zw)", "pack2x16float(c.wz)"),
        ("conv3d", "activation(sum * terms[vector]", "activation(sum"),
        ("conv3d", "fn input_values(v: InputVector) -> vec4<f32> {", "$0 return vec4<f32>(1.0);"),
        ("conv3d", "fn weights_values(v: WeightsVector) -> vec4<f32> {", "$0 return vec4<f32>(1.0);"),
    ];
    // Where invocations share weights, each takes its own in place of another's, as if nobody had waited for it.
    let team_mutants = [
        ("conv3d", "subgroupShuffle(loaded[(4 * j + i) / LANES], u32((4 * j + i) % LANES))", "loaded[0]"),
        (
            "conv_transpose3d",
            "subgroupShuffle(loaded[(4 * j + i) / LANES], u32((4 * j + i) % LANES))",
            "loaded[0]",
        ),
    ];
    let team = variants().into_iter().find(|variant| variant.lanes > 1);
    // The window ends behind the pattern's period.
    let schedule = 3;
    let sound = compare(plan(&json, 5, 10), schedule);
    assert_within_bounds("sound shaders", &sound, &mutants.map(|(kernel, ..)| kernel));
    let mutants = mutants.iter().map(|mutant| (mutant, Precision::F32, None));
    let mutants = mutants.chain(reduced_mutants.iter().map(|mutant| (mutant, Precision::F16, None)));
    // Only adapters that can run teams have text to break.
    let shared = team_mutants.iter().filter(|_| team.is_some());
    let mutants = mutants.chain(shared.map(|mutant| (mutant, Precision::F32, team)));
    for (&(kernel, correct, wrong), precision, variant) in mutants {
        let edited = Cell::new(false);
        let edit = |step: &Step, text: &str| {
            if step.kernel.name() != kernel {
                return text.to_owned();
            }
            let broken = text.replace(correct, &wrong.replace("$0", correct));
            edited.set(edited.get() || broken != text);
            broken
        };
        let options = ExecutorOptions { precision, variant, edit: Some(&edit), ..ExecutorOptions::default() };
        let fraction = compare_with(plan(&json, 5, 10), schedule, &options)[kernel];
        assert!(edited.get(), "{kernel} has no '{correct}' to break");
        println!("{kernel} with '{wrong}': {fraction:.1} times its bound");
        assert!(fraction > 1.0, "nobody notices that {kernel} has '{wrong}' in place of '{correct}'");
    }
}

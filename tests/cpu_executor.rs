//! Whole nets on the CPU: f32 within its bounds, independence of threads, slots that are reused.

use std::collections::HashMap;

use pix2hdr::cpu::bound::{self, bound, largest_fraction};
use pix2hdr::cpu::{CpuExecutor, Shared, Simd, evaluate};
use pix2hdr::network::{Executor, Graph, Inspect, Model, Op, Plan, Step, Tensor, Window, presets};
use pix2hdr::sensor::{Calibration, Form, Pattern, Response};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SCHEDULE: i64 = 21;

fn camera() -> Calibration {
    let pattern = Pattern::built_in("mpve-1-4").unwrap();
    Calibration::new(&pattern, &Response::new(Form::Gamma(1.8), 2.0).unwrap())
}

fn model(graph: &str, seed: u64) -> Model {
    Model::random(Graph::from_json(graph).unwrap(), seed).unwrap()
}

/// Values of a 10-bit sensor, dark and saturated ones among them.
fn measurement(len: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| (rng.random_range(-0.1f32..1.3).clamp(0.0, 1.0) * 1023.0).round() / 1023.0).collect()
}

/// A U-Net: concatenations, strides, transposed convolutions, all activations, norm, added tensors, fusion.
const U_NET: &str = r#"{"version": 1, "name": "u-net", "pattern": "any",
    "window": {"frames": 4, "lead": 1, "hop": 2}, "output": "radiance", "nodes": [
    {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
    {"name": "input", "op": "features", "inputs": ["measurement", "estimate"], "block": [1, 1, 1],
     "channels": ["measurement", "log_irradiance", "log_estimate", "saturated", "log_exposure"]},
    {"name": "down0", "op": "conv3d", "inputs": ["input"], "out_channels": 20, "kernel": [3, 5, 3],
     "stride": [1, 1, 1], "activation": {"leaky_relu": 0.2}, "norm": true},
    {"name": "down1", "op": "conv3d", "inputs": ["down0"], "out_channels": 36, "kernel": [3, 3, 3],
     "stride": [2, 2, 2], "activation": {"leaky_relu": 0.1}},
    {"name": "block1a", "op": "conv3d", "inputs": ["down1"], "out_channels": 36, "kernel": [3, 3, 3],
     "stride": [1, 1, 1], "activation": {"leaky_relu": 0.2}, "norm": true},
    {"name": "block1b", "op": "conv3d", "inputs": ["block1a"], "out_channels": 36, "kernel": [3, 3, 3],
     "stride": [1, 1, 1], "activation": "none", "add": "down1"},
    {"name": "skip1", "op": "concat", "inputs": ["down1", "block1b"]},
    {"name": "up0", "op": "conv_transpose3d", "inputs": ["skip1"], "out_channels": 13, "kernel": [4, 4, 4],
     "stride": [2, 2, 2], "activation": "none", "norm": true},
    {"name": "skip0", "op": "concat", "inputs": ["down0", "up0"]},
    {"name": "ldr", "op": "conv3d", "inputs": ["skip0"], "out_channels": 3, "kernel": [3, 3, 3],
     "stride": [1, 1, 1], "activation": "sigmoid"},
    {"name": "irradiance", "op": "inverse_response", "inputs": ["ldr"], "exposures": [2, 4, 8]},
    {"name": "weights", "op": "conv3d", "inputs": ["irradiance"], "out_channels": 3, "kernel": [1, 3, 3],
     "stride": [1, 1, 1], "activation": {"softplus": 0.001}},
    {"name": "radiance", "op": "fuse", "inputs": ["weights", "irradiance"]}]}"#;

/// A net that predicts kernels, of which the result needs only a part of the frames.
const KERNELS: &str = r#"{"version": 1, "name": "kernels", "pattern": "any",
    "window": {"frames": 12, "lead": 4, "hop": 4}, "output": "radiance", "nodes": [
    {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
    {"name": "logs", "op": "log_irradiance", "inputs": ["measurement"]},
    {"name": "features", "op": "features", "inputs": ["measurement", "estimate", "logs"],
     "channels": ["log_irradiance", "log_estimate"], "neighbours": [-3, 5], "block": [1, 2, 4]},
    {"name": "entry", "op": "conv3d", "inputs": ["features"], "out_channels": 12, "kernel": [1, 3, 3],
     "stride": [1, 1, 1], "activation": {"leaky_relu": 0.2}},
    {"name": "down", "op": "conv3d", "inputs": ["entry"], "out_channels": 20, "kernel": [1, 3, 3],
     "stride": [1, 2, 2], "activation": {"leaky_relu": 0.2}},
    {"name": "block1a", "op": "conv3d", "inputs": ["down"], "out_channels": 20, "kernel": [3, 1, 1],
     "stride": [1, 1, 1], "activation": {"leaky_relu": 0.2}},
    {"name": "block1b", "op": "conv3d", "inputs": ["block1a"], "out_channels": 20, "kernel": [1, 3, 3],
     "stride": [1, 1, 1], "activation": "none", "add": "down"},
    {"name": "up", "op": "conv_transpose3d", "inputs": ["block1b"], "out_channels": 12, "kernel": [1, 2, 2],
     "stride": [1, 2, 2], "activation": "none", "add": "entry"},
    {"name": "tail", "op": "conv3d", "inputs": ["up"], "out_channels": 32, "kernel": [1, 1, 1],
     "stride": [1, 1, 1], "activation": "none"},
    {"name": "radiance", "op": "blend", "inputs": ["tail", "logs", "estimate"], "block": [1, 2, 4],
     "taps": [[0, 0, 0], [-2, 1, -1], [3, 0, 2]]}]}"#;

/// Concatenations that cannot all be written in place: nested, of the same tensor twice, of a tensor that
/// another one has, of a tensor and what reads it.
const DENSE: &str = r#"{"version": 1, "name": "dense", "pattern": "any",
    "window": {"frames": 3, "lead": 0, "hop": 3}, "output": "result", "nodes": [
    {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
    {"name": "features", "op": "features", "inputs": ["measurement", "estimate"], "block": [1, 1, 2],
     "channels": ["log_irradiance", "log_estimate"]},
    {"name": "a", "op": "conv3d", "inputs": ["features"], "out_channels": 8, "kernel": [1, 3, 3],
     "stride": [1, 1, 1], "activation": {"leaky_relu": 0.2}},
    {"name": "b", "op": "conv3d", "inputs": ["a"], "out_channels": 8, "kernel": [3, 1, 3],
     "stride": [1, 1, 1], "activation": "none", "add": "a"},
    {"name": "both", "op": "concat", "inputs": ["features", "a", "b"]},
    {"name": "c", "op": "conv3d", "inputs": ["both"], "out_channels": 4, "kernel": [1, 3, 1],
     "stride": [1, 1, 1], "activation": {"leaky_relu": 0.1}},
    {"name": "nested", "op": "concat", "inputs": ["c", "both", "a", "c"]},
    {"name": "d", "op": "conv3d", "inputs": ["nested"], "out_channels": 5, "kernel": [3, 3, 3],
     "stride": [1, 1, 1], "activation": "sigmoid"},
    {"name": "result", "op": "concat", "inputs": ["c", "d"]}]}"#;

/// A net whose frames do not depend on their window, with parts of a concatenation that later frames read, and a transposed
/// convolution whose taps overlap.
const STREAM: &str = r#"{"version": 1, "name": "stream", "pattern": "any",
    "window": {"frames": 17, "lead": 6, "hop": 5}, "output": "radiance", "nodes": [
    {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
    {"name": "logs", "op": "log_irradiance", "inputs": ["measurement"]},
    {"name": "features", "op": "features", "inputs": ["measurement", "estimate", "logs"],
     "channels": ["log_irradiance", "log_estimate"], "neighbours": [-3, 2], "block": [1, 2, 4]},
    {"name": "a", "op": "conv3d", "inputs": ["features"], "out_channels": 8, "kernel": [1, 3, 3],
     "stride": [1, 1, 1], "activation": {"leaky_relu": 0.2}},
    {"name": "b", "op": "conv3d", "inputs": ["a"], "out_channels": 6, "kernel": [1, 3, 1],
     "stride": [1, 1, 1], "activation": {"leaky_relu": 0.2}},
    {"name": "both", "op": "concat", "inputs": ["a", "b"]},
    {"name": "down", "op": "conv3d", "inputs": ["both"], "out_channels": 10, "kernel": [3, 3, 3],
     "stride": [1, 2, 2], "activation": {"leaky_relu": 0.2}},
    {"name": "wide", "op": "conv3d", "inputs": ["down"], "out_channels": 9, "kernel": [1, 1, 1],
     "stride": [1, 1, 1], "activation": "none"},
    {"name": "up", "op": "conv_transpose3d", "inputs": ["wide"], "out_channels": 12, "kernel": [1, 4, 4],
     "stride": [1, 2, 2], "activation": "none"},
    {"name": "fine", "op": "conv3d", "inputs": ["up"], "out_channels": 8, "kernel": [1, 3, 3],
     "stride": [1, 1, 1], "activation": {"leaky_relu": 0.2}},
    {"name": "tail", "op": "conv3d", "inputs": ["fine"], "out_channels": 64, "kernel": [1, 1, 1],
     "stride": [1, 1, 1], "activation": "none"},
    {"name": "radiance", "op": "blend", "inputs": ["tail", "logs", "estimate"], "block": [1, 2, 4],
     "taps": [[0, 0, 0], [-2, 1, -1], [3, 0, 2], [1, -2, 0], [0, 3, 1], [-1, 0, 0], [2, -1, 1]]}]}"#;

fn nets() -> Vec<(Model, [usize; 2])> {
    vec![
        (model(U_NET, 1), [12, 14]),
        (model(U_NET, 2), [2, 2]),
        (model(U_NET, 3), [22, 70]),
        (model(KERNELS, 4), [4, 8]),
        (model(KERNELS, 5), [36, 56]),
        (model(STREAM, 7), [28, 24]),
        (model(DENSE, 6), [5, 14]),
    ]
}

fn run<E: Executor>(mut executor: E, plan: &Plan, seed: u64) -> Vec<f32> {
    let mut result = vec![f32::NAN; plan.result.shape.len()];
    let measurement = measurement(plan.measurement.shape.len(), seed);
    executor.run(&measurement, SCHEDULE, &mut result).unwrap();
    result
}

#[test]
fn every_step_at_f32_is_within_its_bound() {
    let camera = camera();
    let nets =
        nets().into_iter().flat_map(|net| Simd::available().into_iter().map(move |simd| (net.clone(), simd)));
    for ((model, [height, width]), simd) in nets {
        let plan = Plan::lower(&model, height, width).unwrap();
        let measurement = measurement(plan.measurement.shape.len(), 7);
        let mut executor = CpuExecutor::<f32>::with_simd(plan, camera.clone(), simd);
        executor
            .trace(&measurement, SCHEDULE, &mut |step, inputs, actual| {
                let inputs: Vec<Tensor<f64>> = inputs.iter().map(|x| x.map(|&v| v as f64)).collect();
                let exact = evaluate(&step.kernel, &inputs, actual.shape, &camera, SCHEDULE);
                let bound = bound(&step.kernel, &inputs, &exact, &camera, SCHEDULE, bound::RoundOffs::FULL);
                let fraction = largest_fraction(actual, &exact, &bound);
                println!("{:8} {:12} {fraction:.3}", simd.name(), step.name);
                assert!(fraction <= 1.0, "{}, {}: {fraction} of the bound", simd.name(), step.name);

                // The comparison can fail: a value that is off by a little more than its bound is found,
                // and no bound is so wide that it would hide a wrong result.
                let mut wrong = actual.clone();
                let widest = (0..wrong.data.len()).max_by(|&a, &b| bound.data[a].total_cmp(&bound.data[b]));
                let widest = widest.unwrap();
                wrong.data[widest] = (exact.data[widest] + 1.5 * bound.data[widest]) as f32;
                assert!(largest_fraction(&wrong, &exact, &bound) > 1.0, "{}", step.name);
                wrong.data[widest] = f32::NAN;
                assert!(largest_fraction(&wrong, &exact, &bound).is_infinite(), "{}", step.name);
                let largest = exact.data.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                assert!(
                    bound.data[widest] < 1e-3 * largest,
                    "{}: a bound of {:e} on values up to {largest:e}",
                    step.name,
                    bound.data[widest]
                );
            })
            .unwrap();
    }
}

/// Tiles of other widths add the same products in the same order.
#[test]
fn the_width_of_vectors_changes_nothing() {
    let fused: Vec<Simd> = Simd::available().into_iter().filter(|simd| simd.name() != "baseline").collect();
    for (model, [height, width]) in nets() {
        let plan = Plan::lower(&model, height, width).unwrap();
        let results: Vec<Vec<u32>> = fused
            .iter()
            .map(|&simd| CpuExecutor::<f32>::with_simd(plan.clone(), camera(), simd))
            .map(|executor| run(executor, &plan, 9).iter().map(|v| v.to_bits()).collect())
            .collect();
        assert!(results.windows(2).all(|pair| pair[0] == pair[1]), "{}", plan.name);
    }
}

#[test]
fn whole_nets_at_f32_stay_close_to_the_oracle() {
    for (model, [height, width]) in nets() {
        let plan = Plan::lower(&model, height, width).unwrap();
        let fallback = run(CpuExecutor::<f32>::new(plan.clone(), camera()), &plan, 3);
        let oracle = run(CpuExecutor::<f64>::new(plan.clone(), camera()), &plan, 3);
        for (a, b) in fallback.iter().zip(&oracle) {
            assert!((a - b).abs() <= 2e-5 * b.abs().max(0.1), "{}: {a}, not {b}", plan.name);
        }
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    for (model, [height, width]) in nets() {
        let plan = Plan::lower(&model, height, width).unwrap();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(CpuExecutor::<f32>::new(plan.clone(), camera()), &plan, 5))
        };
        let one = with(1);
        for threads in [2, 5] {
            let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&one), bits(&with(threads)), "{} with {threads} threads", plan.name);
        }
    }
}

#[test]
fn a_window_leaves_nothing_behind_for_the_next() {
    for (model, [height, width]) in nets() {
        let plan = Plan::lower(&model, height, width).unwrap();
        let first = measurement(plan.measurement.shape.len(), 1);
        let second = measurement(plan.measurement.shape.len(), 2);
        let mut executor = CpuExecutor::<f32>::new(plan.clone(), camera());
        let mut results = [(); 3].map(|()| vec![f32::NAN; plan.result.shape.len()]);
        for (measurement, result) in [&first, &second, &first].into_iter().zip(&mut results) {
            executor.run(measurement, SCHEDULE, result).unwrap();
        }
        assert_eq!(results[0], results[2]);
        assert_ne!(results[0], results[1]);
    }
}

#[test]
fn pieces_change_nothing() {
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let preset = |name: &str| {
        let model = Model::random(presets::by_name(name).unwrap().graph().unwrap(), 3).unwrap();
        let [_, y, x] = model.graph.granularity().unwrap();
        (model, [2 * y, 2 * x])
    };
    for (model, [height, width]) in nets().into_iter().chain(["tiny", "fast", "paper-narrow"].map(preset)) {
        let whole = Plan::lower(&model, height, width).unwrap();
        let expected = bits(&run(CpuExecutor::<f32>::new(whole.clone(), camera()), &whole, 5));
        for bytes in [1, 10_000, 200_000] {
            let plan = Plan::in_pieces(&model, height, width, bytes).unwrap();
            let name = &plan.name;
            let blends = ["kernels", "stream", "tiny", "fast", "paper-narrow"].contains(&name.as_str());
            if bytes == 1 && blends {
                assert!(plan.steps.len() > 2 * whole.steps.len(), "{name} is not cut");
                let less = plan.slot_bytes(4) < whole.slot_bytes(4);
                assert!(name == "stream" || less, "{name} in pieces takes as much memory");
                let rows = |step: &Step| step.name == "tail" && step.output.shape.y < height / 2;
                assert!(name == "tiny" || plan.steps.iter().any(rows), "{name} is not cut into rows");
            }
            for threads in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let result = pool.install(|| run(CpuExecutor::<f32>::new(plan.clone(), camera()), &plan, 5));
                assert_eq!(expected, bits(&result), "{name}, {bytes} bytes, {threads} threads");
            }
            // One step after the other, as larger pieces are computed.
            let measurement = measurement(plan.measurement.shape.len(), 5);
            let mut frames = Vec::new();
            let output = &model.graph.output;
            CpuExecutor::<f32>::new(plan.clone(), camera())
                .trace(&measurement, SCHEDULE, &mut |step, _, tensor| {
                    if step.name == *output {
                        frames.extend_from_slice(&tensor.data);
                    }
                })
                .unwrap();
            // The others compute frames that are no results, too.
            if blends {
                assert_eq!(expected, bits(&frames), "{name}, {bytes} bytes, step by step");
            }
        }
    }
}

#[test]
fn a_window_that_follows_computes_what_is_new_and_the_same() {
    let preset = |name: &str| {
        let mut model = Model::random(presets::by_name(name).unwrap().graph().unwrap(), 3).unwrap();
        let Window { frames, lead, hop } = model.graph.window;
        model.graph.window = Window { frames: frames - hop + 9, lead, hop: 9 };
        let [_, y, x] = model.graph.granularity().unwrap();
        (model, [2 * y, 2 * x])
    };
    let nets = [(model(STREAM, 8), [28, 24]), preset("tiny"), preset("fast"), preset("paper-narrow")];
    for ((model, [height, width]), bytes) in
        nets.into_iter().flat_map(|net| [1, 10_000, usize::MAX].map(|bytes| (net.clone(), bytes)))
    {
        let Window { frames, hop, .. } = model.graph.window;
        let whole = Plan::lower(&model, height, width).unwrap();
        let plan = Plan::streaming(&model, height, width, bytes).unwrap();
        let name = &plan.name;
        assert!(plan.following.is_some(), "{name} does not stream");
        // Pieces of rows overlap.
        assert!(bytes < usize::MAX || plan.flop() < whole.flop(), "{name} computes too much anew");
        let recording = measurement((frames + 4 * hop) * height * width, 6);
        let window = |k: usize| &recording[k * hop * height * width..][..frames * height * width];
        let schedule = |k: usize| SCHEDULE + (k * hop) as i64;
        let shared = Shared::default();
        let mut streaming = CpuExecutor::<f32>::sharing(plan.clone(), camera(), &shared);
        let mut other = CpuExecutor::<f32>::sharing(whole.clone(), camera(), &shared);
        let mut state = streaming.state().unwrap();
        for k in 0..5 {
            let mut expected = vec![f32::NAN; whole.result.shape.len()];
            CpuExecutor::<f32>::new(whole.clone(), camera())
                .run(window(k), schedule(k), &mut expected)
                .unwrap();
            let mut result = vec![f32::NAN; plan.result.shape.len()];
            streaming.submit(window(k), schedule(k), Some(&mut state)).unwrap();
            streaming.collect(&mut result).unwrap();
            assert!(expected == result, "{name}, {bytes} bytes, window {k}");
            if k == 2 {
                // Another executor in the same memory, and another sequence: what is known stays known.
                other.run(window(0), schedule(0), &mut expected).unwrap();
                streaming.run(window(0), schedule(0), &mut result).unwrap();
                let mut elsewhere = streaming.state().unwrap();
                for k in [1, 3] {
                    streaming.submit(window(k), schedule(k), Some(&mut elsewhere)).unwrap();
                    streaming.collect(&mut result).unwrap();
                }
            }
        }
    }
}

/// What nobody reads is computed whole, whatever it is: it need not follow from its own frames.
#[test]
fn unread_tensors_are_not_cut() {
    let unread = [
        r#"{"name": "up", "op": "conv_transpose3d", "inputs": ["features"], "out_channels": 16,
            "kernel": [2, 2, 2], "stride": [2, 2, 2], "activation": "none"}"#,
        r#"{"name": "both", "op": "concat", "inputs": ["features", "features"]}"#,
    ];
    for unread in unread {
        let graph = format!(
            r#"{{"version": 1, "name": "unread", "pattern": "any", "output": "estimate",
            "window": {{"frames": 8, "lead": 0, "hop": 8}}, "nodes": [
            {{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}},
            {{"name": "features", "op": "features", "inputs": ["measurement", "estimate"],
             "channels": ["log_irradiance", "log_estimate", "saturated", "measurement"], "block": [1, 1, 1]}}, {unread}]}}"#
        );
        let model = model(&graph, 1);
        let whole = Plan::lower(&model, 16, 16).unwrap();
        let plan = Plan::in_pieces(&model, 16, 16, 5000).unwrap();
        let expected = run(CpuExecutor::<f32>::new(whole.clone(), camera()), &whole, 1);
        assert_eq!(expected, run(CpuExecutor::<f32>::new(plan.clone(), camera()), &plan, 1));
    }
}

/// Tiles cannot have the right halo then, so such nets are refused where there may be tiles.
#[test]
fn layers_finer_than_pixels_have_no_known_reach() {
    let graph = r#"{"version": 1, "name": "fine", "pattern": "any", "output": "result",
        "window": {"frames": 2, "lead": 0, "hop": 2}, "nodes": [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {"name": "features", "op": "features", "inputs": ["measurement", "estimate"],
         "channels": ["log_irradiance"], "block": [1, 1, 1]},
        {"name": "up", "op": "conv_transpose3d", "inputs": ["features"], "out_channels": 4, "kernel": [1, 2, 2],
         "stride": [1, 2, 2], "activation": "none"},
        {"name": "result", "op": "conv3d", "inputs": ["up"], "out_channels": 1, "kernel": [1, 7, 7],
         "stride": [1, 2, 2], "activation": "none"}]}"#;
    let error = model(graph, 1).graph.reach().unwrap_err().to_string();
    assert!(error.contains("'up'") && error.contains("finer"), "{error}");
}

/// A net with a transposed convolution through time, which is computed from its first frame on.
const TRANSPOSED: &str = r#"{"version": 1, "name": "transposed", "pattern": "any",
    "window": {"frames": 12, "lead": 4, "hop": 4}, "output": "radiance", "nodes": [
    {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
    {"name": "features", "op": "features", "inputs": ["measurement", "estimate"], "block": [1, 1, 1],
     "channels": ["log_irradiance", "log_estimate"]},
    {"name": "up", "op": "conv_transpose3d", "inputs": ["features"], "out_channels": 2, "kernel": [3, 1, 1],
     "stride": [1, 1, 1], "activation": "sigmoid"},
    {"name": "irradiance", "op": "inverse_response", "inputs": ["up"], "exposures": [2, 4]},
    {"name": "weights", "op": "conv3d", "inputs": ["irradiance"], "out_channels": 2, "kernel": [1, 1, 1],
     "stride": [1, 1, 1], "activation": {"softplus": 0.001}},
    {"name": "radiance", "op": "fuse", "inputs": ["weights", "irradiance"]}]}"#;

#[test]
fn nets_that_depend_on_their_window_do_not_stream() {
    for (graph, size) in [(U_NET, [12, 14]), (KERNELS, [4, 8]), (DENSE, [5, 14]), (TRANSPOSED, [3, 5])] {
        let plan = Plan::streaming(&model(graph, 1), size[0], size[1], 10_000).unwrap();
        assert!(plan.following.is_none(), "{}", plan.name);
        // Its windows follow each other as any others do.
        let mut executor = CpuExecutor::<f32>::new(plan.clone(), camera());
        let mut state = executor.state().unwrap();
        for seed in [1, 2] {
            let mut result = vec![f32::NAN; plan.result.shape.len()];
            let measurement = measurement(plan.measurement.shape.len(), seed);
            executor.submit(&measurement, SCHEDULE, Some(&mut state)).unwrap();
            executor.collect(&mut result).unwrap();
            assert_eq!(result, run(CpuExecutor::<f32>::new(plan.clone(), camera()), &plan, seed));
        }
    }
}

#[test]
fn executors_that_share_do_not_disturb_each_other() {
    let model = model(KERNELS, 9);
    let shared = Shared::default();
    let plans = [[4, 8], [36, 56], [12, 8]].map(|[y, x]| Plan::in_pieces(&model, y, x, 5000).unwrap());
    let mut executors = plans.clone().map(|plan| CpuExecutor::<f32>::sharing(plan, camera(), &shared));
    for seed in [1, 2] {
        for (executor, plan) in executors.iter_mut().zip(&plans) {
            let measurement = measurement(plan.measurement.shape.len(), seed);
            executor.submit(&measurement, SCHEDULE, None).unwrap();
            assert!(
                executor.submit(&measurement, SCHEDULE, None).is_err(),
                "nobody has collected the first one"
            );
        }
        for (executor, plan) in executors.iter_mut().zip(&plans) {
            let mut result = vec![f32::NAN; plan.result.shape.len()];
            executor.collect(&mut result).unwrap();
            assert_eq!(result, run(CpuExecutor::<f32>::new(plan.clone(), camera()), plan, seed));
            assert!(executor.collect(&mut result).is_err());
        }
    }
}

/// Every node as a dense tensor of its own, with all of its frames: no slots, no views, nothing left out.
fn dense(model: &Model, plan: &Plan, measurement: &[f32]) -> Tensor<f64> {
    let mut model = model.clone();
    model.graph.window = Window { lead: 0, hop: model.graph.window.frames, ..model.graph.window };
    let plan = Plan::lower(&model, plan.measurement.shape.y, plan.measurement.shape.x).unwrap();
    let given =
        Tensor { shape: plan.measurement.shape, data: measurement.iter().map(|&v| v as f64).collect() };
    let mut tensors: HashMap<&str, Tensor<f64>> = HashMap::from([("measurement", given)]);
    let shapes = model.graph.shapes(plan.measurement.shape.y, plan.measurement.shape.x).unwrap();
    for node in &model.graph.nodes {
        let inputs: Vec<Tensor<f64>> = node.tensors().map(|name| tensors[name.as_str()].clone()).collect();
        let shape = shapes[node.name.as_str()];
        let result = if matches!(node.op, Op::Concat(_)) {
            let pixel = |p: usize| {
                inputs.iter().flat_map(move |x| x.data[p * x.shape.c..][..x.shape.c].iter().copied())
            };
            Tensor { shape, data: (0..shape.pixels()).flat_map(pixel).collect() }
        } else {
            let step = plan.steps.iter().find(|step| step.name == node.name).unwrap();
            evaluate(&step.kernel, &inputs, shape, &camera(), SCHEDULE)
        };
        tensors.insert(&node.name, result);
    }
    tensors.remove(model.graph.output.as_str()).unwrap()
}

#[test]
fn slots_and_concatenations_change_nothing() {
    for (model, [height, width]) in nets() {
        let plan = Plan::lower(&model, height, width).unwrap();
        assert!(plan.slots.len() < plan.steps.len(), "slots are reused");
        let measurement = measurement(plan.measurement.shape.len(), 11);
        let expected = dense(&model, &plan, &measurement);
        let first = plan.window.lead;
        let frame = expected.shape.y * expected.shape.x;
        let mut result = vec![f32::NAN; plan.result.shape.len()];
        let mut executor = CpuExecutor::<f64>::new(plan.clone(), camera());
        executor.run(&measurement, SCHEDULE, &mut result).unwrap();
        for (a, b) in result.iter().zip(&expected.data[first * frame..]) {
            assert_eq!(a.to_bits(), (*b as f32).to_bits(), "{}", plan.name);
        }
    }
}

#[test]
fn no_measurement_makes_results_that_are_not_finite() {
    let (model, [height, width]) = nets().remove(0);
    let plan = Plan::lower(&model, height, width).unwrap();
    let mut executor = CpuExecutor::<f32>::new(plan.clone(), camera());
    let mut measurement = measurement(plan.measurement.shape.len(), 1);
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1e30, 1e30, f32::MIN_POSITIVE / 2.0, -0.0];
    for (value, odd) in measurement.iter_mut().zip(odd.iter().cycle()) {
        *value = *odd;
    }
    let mut result = vec![f32::NAN; plan.result.shape.len()];
    executor.run(&measurement, i64::MIN, &mut result).unwrap();
    assert!(result.iter().all(|v| v.is_finite()));
    executor.run(&measurement, i64::MAX - 64, &mut result).unwrap();
    assert!(result.iter().all(|v| v.is_finite()));

    // What is not a number counts as 0, and values beyond the sensor's range as its ends.
    let mut other = result.clone();
    let tame = measurement.iter().map(|v| if v.is_finite() { v.clamp(0.0, 1.0) } else { 0.0 });
    executor.run(&tame.collect::<Vec<_>>(), i64::MAX - 64, &mut other).unwrap();
    assert_eq!(result, other);
}

#[test]
fn weights_that_overflow_make_results_that_are_finite() {
    let mut model = model(U_NET, 1);
    for layer in model.layers.values_mut() {
        let layer = std::sync::Arc::make_mut(layer);
        for weight in &mut layer.weight {
            *weight = weight.signum() * f32::MAX;
        }
    }
    let plan = Plan::lower(&model, 8, 8).unwrap();
    let result = run(CpuExecutor::<f32>::new(plan.clone(), camera()), &plan, 1);
    assert!(result.iter().all(|v| v.is_finite()));
}

/// What a net without a video at its end gives is given in whole: found by fuzzing.
#[test]
fn outputs_of_fewer_frames_than_the_window_are_whole() {
    let json = r#"{"version": 1, "name": "folded", "pattern": "any",
        "window": {"frames": 64, "lead": 16, "hop": 2}, "nodes": [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {"name": "f", "op": "features", "inputs": ["measurement", "estimate"],
            "channels": ["measurement", "log_exposure"], "block": [16, 1, 1]},
        {"name": "ldr", "op": "conv3d", "inputs": ["f"], "out_channels": 2, "kernel": [1, 3, 3],
            "stride": [1, 1, 1], "activation": "sigmoid"},
        {"name": "i", "op": "inverse_response", "inputs": ["ldr"], "exposures": [2, 8]},
        {"name": "w", "op": "conv3d", "inputs": ["i"], "out_channels": 2, "kernel": [1, 1, 1],
            "stride": [1, 1, 1], "activation": {"softplus": 0.001}},
        {"name": "result", "op": "fuse", "inputs": ["w", "i"]}], "output": "result"}"#;
    let plan = Plan::lower(&model(json, 3), 4, 4).unwrap();
    assert_eq!(plan.result.shape.t, 4);
    assert!(run(CpuExecutor::<f32>::new(plan.clone(), camera()), &plan, 1).iter().all(|p| p.is_finite()));
}

#[test]
fn buffers_of_the_wrong_size_are_refused() {
    let (model, [height, width]) = nets().remove(0);
    let plan = Plan::lower(&model, height, width).unwrap();
    let (input, output) = (plan.measurement.shape.len(), plan.result.shape.len());
    let mut executor = CpuExecutor::<f32>::new(plan, camera());
    for (measurement, result) in [(input - 1, output), (input + 1, output), (input, output - 1), (0, 0)] {
        let refused = executor.run(&vec![0.5; measurement], 0, &mut vec![0.0; result]);
        assert!(refused.unwrap_err().to_string().contains("values, the plan wants"));
    }
}

//! What the GPU executor promises beyond right results: repetition, overlap, refusals and errors.

mod support;

use pix2hdr::Error;
use pix2hdr::cpu::CpuExecutor;
use pix2hdr::gpu::{AdapterChoice, ExecutorOptions, Gpu, GpuError, GpuExecutor, Variant, adapters};
use pix2hdr::network::{Executor, Inspect, Layer, Model, Plan, Precision, Step, Window, presets};
use support::{calibration, gpu, measurement, plan, variants};

fn model(preset: &str) -> Model {
    Model::random(presets::by_name(preset).unwrap().graph().unwrap(), 3).unwrap()
}

fn run(executor: &mut dyn Executor, plan: &Plan, measurement: &[f32], schedule: i64) -> Vec<f32> {
    let mut result = vec![f32::NAN; plan.result.shape.len()];
    executor.run(measurement, schedule, &mut result).unwrap();
    result
}

#[test]
fn repeated_runs_give_the_same_bits() {
    let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
    let [first, other] = [measurement(&plan, 1), measurement(&plan, 2)];
    let mut executor = GpuExecutor::new(gpu(), plan.clone(), &calibration()).unwrap();
    let expected = run(&mut executor, &plan, &first, 0);
    assert!(run(&mut executor, &plan, &other, 0) != expected, "the measurement has no effect");
    assert!(run(&mut executor, &plan, &first, 1) != expected, "the schedule has no effect");
    assert!(run(&mut executor, &plan, &first, -5) == expected, "the schedule is not periodic");
    for _ in 0..3 {
        assert!(run(&mut executor, &plan, &first, 0) == expected);
    }
    let mut fresh = GpuExecutor::new(gpu(), plan.clone(), &calibration()).unwrap();
    assert!(run(&mut fresh, &plan, &first, 0) == expected);
}

/// An executor at a precision.
fn at(precision: Precision, plan: &Plan) -> Result<GpuExecutor, GpuError> {
    let options = ExecutorOptions { precision, ..ExecutorOptions::default() };
    GpuExecutor::with_options(gpu(), plan.clone(), &calibration(), &options)
}

/// Tiles of different sizes may get different variants, and must fit together.
#[test]
fn variants_do_not_change_the_result() {
    let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
    let measurement = measurement(&plan, 1);
    for precision in [Precision::F32, Precision::F16] {
        let expected = run(&mut at(precision, &plan).unwrap(), &plan, &measurement, 0);
        for variant in variants() {
            let options = ExecutorOptions { precision, variant: Some(variant), ..ExecutorOptions::default() };
            let executor = GpuExecutor::with_options(gpu(), plan.clone(), &calibration(), &options);
            let result = run(&mut executor.unwrap(), &plan, &measurement, 0);
            assert!(result == expected, "{variant:?} at {precision:?}");
        }
    }
}

/// Layers that are worth it are measured once, the outcome is kept, and neither it nor its absence changes a result.
#[test]
fn variants_are_measured_once_and_kept() {
    // One layer of 85 million operations.
    let layer = |name: &str, input: &str, kernel: &str| {
        format!(
            r#"{{"name": "{name}", "op": "conv3d", "inputs": ["{input}"], "out_channels": 32, "kernel": {kernel},
            "stride": [1, 1, 1], "activation": {{"leaky_relu": 0.2}}}}"#
        )
    };
    let nodes = [layer("a", "features", "[1, 1, 1]"), layer("b", "a", "[3, 3, 3]")].join(", ");
    let plan = plan(&support::graph(2, 4, &nodes, "b"), 24, 32);
    let measurement = measurement(&plan, 1);
    let expected = run(&mut at(Precision::F32, &plan).unwrap(), &plan, &measurement, 0);
    let folder = tempfile::tempdir().unwrap();
    let run_in = |folder: &std::path::Path| {
        let options = ExecutorOptions { tuned_in: Some(folder), ..ExecutorOptions::default() };
        let executor = GpuExecutor::with_options(gpu(), plan.clone(), &calibration(), &options);
        assert!(
            run(&mut executor.unwrap(), &plan, &measurement, 0) == expected,
            "measuring changes the result"
        );
    };
    run_in(folder.path());
    let file = folder.path().read_dir().unwrap().next().unwrap().unwrap().path();
    let kept = std::fs::read_to_string(&file).unwrap();
    assert!(kept.contains("pixels"), "nothing was measured: {kept}");
    // What is known is used: a file that says something else stays as it is.
    let variants: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&kept).unwrap();
    let other = serde_json::json!({"pixels": 1, "vectors": 1, "lanes": 1, "wide": false});
    let others: serde_json::Map<_, _> = variants.keys().map(|key| (key.clone(), other.clone())).collect();
    std::fs::write(&file, serde_json::to_vec(&others).unwrap()).unwrap();
    run_in(folder.path());
    let after: serde_json::Map<String, serde_json::Value> =
        serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    assert!(variants.keys().all(|key| after[key] == other), "{after:?}");
    // What cannot be run here, or read, is measured again.
    for broken in [kept.replace("\"lanes\": ", "\"lanes\": 9"), "no JSON".to_owned()] {
        std::fs::write(&file, broken).unwrap();
        run_in(folder.path());
        let mended = std::fs::read_to_string(&file).unwrap();
        assert!(mended.contains("pixels") && !mended.contains("\"lanes\": 9"), "{mended}");
    }
    // A folder that cannot be made is no failure.
    run_in(&file.join("folder"));
}

#[test]
fn variants_that_the_adapter_cannot_run_are_refused() {
    let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
    let variant = Variant { pixels: 2, vectors: 2, lanes: 7, wide: false };
    let options = ExecutorOptions { variant: Some(variant), ..ExecutorOptions::default() };
    match GpuExecutor::with_options(gpu(), plan, &calibration(), &options) {
        Err(GpuError::Failed(problem)) => assert!(problem.contains("lanes: 7"), "{problem}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_result_is_that_of_the_cpu_executor() {
    let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
    let measurement = measurement(&plan, 1);
    let exact = run(&mut CpuExecutor::<f64>::new(plan.clone(), calibration()), &plan, &measurement, 4);
    let error_at = |precision| {
        let actual = run(&mut at(precision, &plan).unwrap(), &plan, &measurement, 4);
        let error = actual.iter().zip(&exact).map(|(a, e)| (a - e).abs()).fold(0.0, f32::max);
        println!("largest error at {precision:?}: {error:e}");
        error
    };
    // No bound is derived for whole nets: each step has its own in gpu_parity.rs.
    let [full, reduced] = [error_at(Precision::F32), error_at(Precision::F16)];
    assert!(full < 1e-4, "{full}");
    assert!(reduced < 2e-2, "{reduced}");
    assert!(reduced > full, "f16 was not used");
}

/// A concatenation in the slot and with the stride of another tensor before it, but of numbers that stay f32.
#[test]
fn concatenations_in_one_slot_are_two_tensors() {
    let convolution = |name: &str, channels: usize, input: &str, activation: &str| {
        format!(
            r#"{{"name": "{name}", "op": "conv3d", "inputs": ["{input}"], "out_channels": {channels}, "kernel": [1, 1, 1],
            "stride": [1, 1, 1], "activation": "{activation}"}}"#
        )
    };
    let layer = |name: &str, input: &str, activation: &str| convolution(name, 4, input, activation);
    let both = |name: &str, parts: [&str; 2]| {
        let [a, b] = parts;
        format!(r#"{{"name": "{name}", "op": "concat", "inputs": ["{a}", "{b}"]}}"#)
    };
    // Another concatenation, or a layer by itself; and parts that are written from the first one or from the last.
    let concatenation = [
        layer("a", "features", "none"),
        layer("b", "features", "none"),
        both("first", ["a", "b"]),
        layer("c", "first", "none"),
    ];
    let alone = [convolution("a", 8, "features", "none"), layer("c", "a", "none")];
    for (before, parts) in [
        (&concatenation[..], ["d", "e"]),
        (&concatenation, ["e", "d"]),
        (&alone, ["d", "e"]),
        (&alone, ["e", "d"]),
    ] {
        let behind = [
            layer("d", "c", "sigmoid"),
            layer("e", "c", "sigmoid"),
            both("second", parts),
            r#"{"name": "irradiance", "op": "inverse_response", "inputs": ["second"],
                "exposures": [1, 2, 3, 4, 5, 6, 7, 8]}"#
                .to_owned(),
        ];
        let nodes = [before, &behind].concat().join(", ");
        let plan = plan(&support::graph(2, 4, &nodes, "irradiance"), 6, 8);
        let written = |name: &str| plan.steps.iter().find(|step| step.name == name).unwrap().output;
        let [a, d] = ["a", "d"].map(written);
        assert_eq!((a.slot, a.stride), (d.slot, d.stride), "they do not share a slot");
        let measurement = measurement(&plan, 1);
        let [full, reduced] =
            [Precision::F32, Precision::F16].map(|p| run(&mut at(p, &plan).unwrap(), &plan, &measurement, 0));
        let error = full.iter().zip(&reduced).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(error < 1e-2, "{error} with parts {parts:?}");
    }
}

#[test]
fn reports_name_the_precision() {
    let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
    for (precision, name) in [(Precision::F32, "f32"), (Precision::F16, "f16")] {
        let description = at(precision, &plan).unwrap().describe();
        assert!(description.ends_with(name), "{description}");
    }
}

/// A model whose layers have been changed.
fn changed(preset: &str, change: impl Fn(&mut Layer)) -> Model {
    let mut model = model(preset);
    for layer in model.layers.values_mut() {
        let mut other = (**layer).clone();
        change(&mut other);
        *layer = other.into();
    }
    model
}

/// What f16 is for: what lies between two convolutions, and is no part of a sum of residuals.
#[test]
fn the_trunk_stays_f32() {
    let reduced = |preset: &str| -> Vec<String> {
        let plan = Plan::lower(&model(preset), 16, 32).unwrap();
        let reduced = |step: &&Step| !plan.tensors[step.output.tensor.0].full_precision;
        plan.steps.iter().filter(reduced).map(|step| step.name.clone()).collect()
    };
    assert_eq!(reduced("tiny"), ["level1block1a", "level1block2a", "fine"]);
    let paper = reduced("paper-narrow");
    assert!(paper.iter().any(|name| name == "hdr2a"), "{paper:?}");
    assert!(paper.iter().all(|name| name != "hdr2b" && name != "features"), "{paper:?}");
}

/// Features that f16 cannot hold are stored in other units: the window that met them is computed again, as are those that
/// were in flight behind it, and all later ones find room.
#[test]
fn what_f16_cannot_hold_is_stored_in_other_units() {
    // What one layer multiplies, the next one divides.
    let scaled = |factor: f32| {
        let mut model = model("tiny");
        let names = ["level1block1a", "level1block1b"];
        let [mut first, mut second] = names.map(|name| (*model.layers[name]).clone());
        first.weight.iter_mut().chain(&mut first.bias).for_each(|value| *value *= factor);
        second.weight.iter_mut().for_each(|weight| *weight /= factor);
        for (name, layer) in names.into_iter().zip([first, second]) {
            model.layers.insert(name.into(), layer.into());
        }
        Plan::lower(&model, 16, 24).unwrap()
    };
    let plan = scaled(1.0);
    let windows = [0, 1, 2].map(|seed| measurement(&plan, seed));
    let mut plain = at(Precision::F16, &plan).unwrap();
    let expected = windows.each_ref().map(|window| run(&mut plain, &plan, window, 0));
    assert!(plain.rescaled().is_empty());
    let plan = scaled(2f32.powi(40));
    let mut executor = at(Precision::F16, &plan).unwrap();
    assert!(executor.rescaled().is_empty());
    let mut result = vec![0.0; plan.result.shape.len()];
    let close = |result: &[f32], expected: &[f32]| {
        let error = result.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        // The same digits, but for values that are small beside the largest ones.
        assert!(error < 1e-4, "{error}");
    };
    executor.submit(&windows[0], 0, None).unwrap();
    executor.submit(&windows[1], 0, None).unwrap();
    for expected in &expected[..2] {
        executor.collect(&mut result).unwrap();
        close(&result, expected);
    }
    let rescaled = executor.rescaled();
    let [(step, unit)] = &rescaled[..] else { panic!("{rescaled:?}") };
    assert_eq!(step, "level1block1a");
    assert!(unit.log2().fract() == 0.0 && *unit > 1.0, "{unit}");
    close(&run(&mut executor, &plan, &windows[2], 0), &expected[2]);
    assert_eq!(executor.rescaled(), rescaled);
}

/// Windows of nine result frames, of a recording from window `k` on, and their plans: whole, and for streams.
fn windows_of_nine(model: &Model) -> ([Plan; 2], impl Fn(usize, usize) -> Vec<f32> + use<>) {
    let mut model = model.clone();
    let Window { frames, lead, hop } = model.graph.window;
    let frames = frames - hop + 9;
    model.graph.window = Window { frames, lead, hop: 9 };
    let plans =
        [Plan::lower(&model, 16, 24), Plan::streaming(&model, 16, 24, usize::MAX)].map(Result::unwrap);
    let window = move |seed: usize, k: usize| {
        let first = k * 9 * 16 * 24;
        let value = |i: usize| ((i + 977 * seed) * 7919 % 1031) as f32 / 1030.0;
        (first..first + frames * 16 * 24).map(value).collect()
    };
    (plans, window)
}

/// What a window takes over from the one before it is what it would have computed, also where sequences take turns.
#[test]
fn windows_that_follow_give_the_same_bits() {
    let ([whole, plan], window) = windows_of_nine(&model("tiny"));
    assert!(plan.following.is_some() && plan.flop() < whole.flop());
    for precision in [Precision::F32, Precision::F16] {
        let mut alone = at(precision, &whole).unwrap();
        let mut executor = at(precision, &plan).unwrap();
        let mut states = [(); 2].map(|()| executor.state().unwrap());
        for k in 0..4 {
            // The second one leaves a window out.
            let windows = [k, if k < 2 { k } else { k + 1 }];
            let schedule = |k: usize| 9 * k as i64 - 4;
            for (seed, (&k, state)) in windows.iter().zip(&mut states).enumerate() {
                executor.submit(&window(seed, k), schedule(k), Some(state)).unwrap();
            }
            for (seed, &k) in windows.iter().enumerate() {
                let mut result = vec![f32::NAN; plan.result.shape.len()];
                executor.collect(&mut result).unwrap();
                let expected = run(&mut alone, &whole, &window(seed, k), schedule(k));
                assert!(result == expected, "window {k} of sequence {seed} at {precision:?}");
            }
        }
    }
}

/// What f16 could not hold is not taken over: windows that were submitted on top of it are computed again.
#[test]
fn what_f16_cannot_hold_is_not_taken_over() {
    let net = |factor: f32| {
        let mut model = model("tiny");
        let names = ["level1block1a", "level1block1b"];
        let [mut first, mut second] = names.map(|name| (*model.layers[name]).clone());
        first.weight.iter_mut().chain(&mut first.bias).for_each(|value| *value *= factor);
        second.weight.iter_mut().for_each(|weight| *weight /= factor);
        for (name, layer) in names.into_iter().zip([first, second]) {
            model.layers.insert(name.into(), layer.into());
        }
        windows_of_nine(&model)
    };
    let ([whole, _], window) = net(1.0);
    let mut plain = at(Precision::F16, &whole).unwrap();
    let ([_, plan], _) = net(2f32.powi(40));
    let mut executor = at(Precision::F16, &plan).unwrap();
    let mut state = executor.state().unwrap();
    let mut result = vec![0.0; plan.result.shape.len()];
    executor.submit(&window(0, 0), 0, Some(&mut state)).unwrap();
    for k in 0..4 {
        executor.submit(&window(0, k + 1), 9 * (k as i64 + 1), Some(&mut state)).unwrap();
        executor.collect(&mut result).unwrap();
        let expected = run(&mut plain, &whole, &window(0, k), 9 * k as i64);
        let error = result.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(error < 1e-4, "window {k}: {error}");
    }
    assert_eq!(executor.rescaled().len(), 1);
}

/// The largest value that f16 can hold needs no other unit, the next f32 does.
#[test]
fn the_largest_f16_is_no_overflow() {
    for (bias, rescaled) in [(65504.0f32, false), (65504f32.next_up(), true)] {
        let mut quiet = changed("tiny", |layer| {
            layer.weight.fill(0.0);
            layer.bias.fill(0.0);
            layer.norm = None;
        });
        let mut layer = (*quiet.layers["level1block1a"]).clone();
        layer.bias.fill(bias);
        quiet.layers.insert("level1block1a".into(), layer.into());
        let plan = Plan::lower(&quiet, 16, 24).unwrap();
        let mut executor = at(Precision::F16, &plan).unwrap();
        run(&mut executor, &plan, &measurement(&plan, 1), 0);
        assert_eq!(!executor.rescaled().is_empty(), rescaled, "{bias}");
    }
}

/// What f32 cannot hold either has no unit, and is an error that names the step; the executor goes on.
#[test]
fn overflow_of_f32_is_reported_at_f16() {
    let mut loud = model("tiny");
    let mut layer = (*loud.layers["level1block1a"]).clone();
    layer.weight.fill(3e38);
    loud.layers.insert("level1block1a".into(), layer.into());
    let plan = Plan::lower(&loud, 16, 24).unwrap();
    let mut executor = at(Precision::F16, &plan).unwrap();
    let mut result = vec![0.0; plan.result.shape.len()];
    for _ in 0..2 {
        let error = executor.run(&measurement(&plan, 1), 0, &mut result).unwrap_err();
        let Some(GpuError::Overflow { step, value }) = error.cause() else { panic!("{error:?}") };
        assert_eq!(step, "level1block1a");
        assert!(value.parse::<f32>().unwrap() > 65504.0, "{value}");
        assert!(result.iter().all(|p| p.is_finite()));
    }
}

/// Weights beyond the largest f16, and below the smallest, lose nothing: each channel has its unit.
#[test]
fn weights_of_any_magnitude_are_as_exact() {
    let expected = {
        let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
        run(&mut at(Precision::F16, &plan).unwrap(), &plan, &measurement(&plan, 1), 0)
    };
    for factor in [2f32.powi(30), 2f32.powi(-40)] {
        // Undone behind the activation, as a normalisation does it.
        let model = changed("tiny", |layer| {
            layer.weight.iter_mut().chain(&mut layer.bias).for_each(|value| *value *= factor);
            let channels = layer.bias.len();
            let (scale, shift) = layer.norm.take().unwrap_or((vec![1.0; channels], vec![0.0; channels]));
            layer.norm = Some((scale.into_iter().map(|scale| scale / factor).collect(), shift));
        });
        let plan = Plan::lower(&model, 16, 24).unwrap();
        let mut executor = at(Precision::F16, &plan).unwrap();
        let result = run(&mut executor, &plan, &measurement(&plan, 1), 0);
        let error = result.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(error < 1e-4, "{factor:e}: {error}");
        assert!(executor.rescaled().is_empty());
    }
}

#[test]
fn windows_overlap() {
    let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
    let mut executor = GpuExecutor::new(gpu(), plan.clone(), &calibration()).unwrap();
    let windows: Vec<(Vec<f32>, i64)> = (0..5).map(|i| (measurement(&plan, i), i as i64)).collect();
    let expected: Vec<Vec<f32>> =
        windows.iter().map(|(m, schedule)| run(&mut executor, &plan, m, *schedule)).collect();
    let mut results = Vec::new();
    let mut result = vec![0.0; plan.result.shape.len()];
    for (index, (measurement, schedule)) in windows.iter().enumerate() {
        executor.submit(measurement, *schedule, None).unwrap();
        if index + 1 >= GpuExecutor::IN_FLIGHT {
            executor.collect(&mut result).unwrap();
            results.push(result.clone());
        }
    }
    while results.len() < windows.len() {
        executor.collect(&mut result).unwrap();
        results.push(result.clone());
    }
    assert!(results == expected, "overlapping windows differ from single ones");
    assert!(matches!(executor.collect(&mut result), Err(Error::Misuse(_))), "nothing is in flight");
    for _ in 0..GpuExecutor::IN_FLIGHT {
        executor.submit(&windows[0].0, 0, None).unwrap();
    }
    assert!(
        matches!(executor.submit(&windows[0].0, 0, None), Err(Error::Misuse(_))),
        "too many are in flight"
    );
}

#[test]
fn measurements_that_are_not_finite_count_as_black() {
    let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
    let mut broken = measurement(&plan, 1);
    let mut mended = broken.clone();
    for (index, value) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -f32::NAN, 2.0, -1.0, 1e-45, -0.0]
        .into_iter()
        .enumerate()
    {
        broken[37 * index] = value;
        mended[37 * index] = if value == 2.0 { 1.0 } else { 0.0 };
    }
    let mut executor = GpuExecutor::new(gpu(), plan.clone(), &calibration()).unwrap();
    let result = run(&mut executor, &plan, &broken, 0);
    assert!(result.iter().all(|p| p.is_finite()));
    // A subnormal may be flushed or not; either is nearly black.
    let expected = run(&mut executor, &plan, &mended, 0);
    let error = result.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(error < 1e-6, "{error}");
}

/// Weights that overflow are finite, so they load.
#[test]
fn results_are_finite_whatever_the_weights() {
    for preset in ["tiny", "paper-narrow"] {
        let model = changed(preset, |layer| layer.weight.iter_mut().for_each(|w| *w *= 1e30));
        let plan = Plan::lower(&model, 16, 16).unwrap();
        let mut executor = GpuExecutor::new(gpu(), plan.clone(), &calibration()).unwrap();
        let result = run(&mut executor, &plan, &measurement(&plan, 1), 0);
        assert!(result.iter().all(|p| p.is_finite()), "{preset}");
    }
}

#[test]
fn wrong_lengths_are_refused() {
    let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
    let mut executor = GpuExecutor::new(gpu(), plan.clone(), &calibration()).unwrap();
    let measurement = measurement(&plan, 1);
    let mut result = vec![0.0; plan.result.shape.len()];
    let short = executor.run(&measurement[1..], 0, &mut result).unwrap_err().to_string();
    assert!(short.contains("measurement has"), "{short}");
    let short = executor.run(&measurement, 0, &mut result[1..]).unwrap_err().to_string();
    assert!(short.contains("result has"), "{short}");
    executor.run(&measurement, 0, &mut result).unwrap();
}

#[test]
fn buffers_above_the_limit_are_refused_before_they_are_made() {
    let mut plan = plan(&support::graph(1, 1, "", "features"), 8, 8);
    let limit = gpu().largest_binding();
    plan.slots[1] = (limit / 4 + 1_000_000) as usize;
    match GpuExecutor::new(gpu(), plan, &calibration()) {
        Err(GpuError::TooLarge { what, bytes, limit }) => {
            assert!(bytes > limit && what.contains("slot 1"), "{what}: {bytes} of {limit}");
        }
        other => panic!("{other:?}"),
    }
    gpu().check().unwrap();
}

#[test]
fn a_plan_of_the_largest_slot_fits() {
    let mut plan = plan(&support::graph(1, 1, "", "features"), 8, 8);
    plan.slots[1] = (gpu().largest_binding() / 4) as usize;
    GpuExecutor::new(gpu(), plan, &calibration()).unwrap();
}

/// Software Vulkan takes its memory from the process, so a process with little address space runs out of it.
#[cfg(target_os = "linux")]
#[test]
fn memory_that_runs_out_is_an_error_that_names_what_it_was_for() {
    use std::os::unix::process::ExitStatusExt;
    const CHILD: &str = "PIX2HDR_TEST_WITH_LITTLE_MEMORY";
    const SIGSEGV: i32 = 11;
    const NAME: &str = "memory_that_runs_out_is_an_error_that_names_what_it_was_for";
    let choice = AdapterChoice { substring: Some("llvmpipe".into()), allow_software: true };
    let Ok(gpu) = Gpu::open(&choice) else {
        println!("not tested: only software Vulkan runs out of memory without harm");
        return;
    };
    if std::env::var_os(CHILD).is_none() {
        let limited = std::process::Command::new("sh")
            .args(["-c", "ulimit -v 3000000 && exec \"$0\" \"$@\""])
            .arg(std::env::current_exe().unwrap())
            .args(["--exact", NAME])
            .env(CHILD, "1")
            .status()
            .unwrap();
        // Mesa 25 maps memory that it could not get, and crashes in doing so, before any error reaches us.
        let driver = &gpu.adapter().driver;
        let crashed = limited.signal() == Some(SIGSEGV) && !driver.contains("Mesa 22");
        assert!(limited.success() || crashed, "{limited} with {driver}");
        return;
    }
    let mut plan = plan(&support::graph(1, 1, "", "features"), 8, 8);
    plan.slots.resize(64, (gpu.largest_binding() / 4) as usize);
    match GpuExecutor::new(&gpu, plan, &calibration()) {
        Err(GpuError::OutOfMemory { what, bytes }) => {
            assert!(what.starts_with("slot ") && bytes >= gpu.largest_binding(), "{bytes} for {what}");
        }
        other => panic!("{other:?}"),
    }
    // What was made before is given back.
    GpuExecutor::new(&gpu, support::plan(&support::graph(1, 1, "", "features"), 8, 8), &calibration())
        .unwrap();
}

#[test]
fn refused_shaders_are_named() {
    let plan = plan(&support::graph(1, 1, "", "features"), 8, 8);
    let edit = |step: &pix2hdr::network::Step, text: &str| match step.name.as_str() {
        "features" => format!("{text}\nthis is no shader"),
        _ => text.to_owned(),
    };
    let options = ExecutorOptions { edit: Some(&edit), ..ExecutorOptions::default() };
    match GpuExecutor::with_options(gpu(), plan, &calibration(), &options) {
        Err(GpuError::Shader { step, problem }) => {
            assert_eq!(step, "features");
            assert!(!problem.is_empty());
        }
        other => panic!("{other:?}"),
    }
    // One refusal does not spoil the device.
    gpu().check().unwrap();
}

#[test]
fn a_lost_device_is_reported_as_lost() {
    let gpu = Gpu::open(&AdapterChoice { substring: None, allow_software: true }).unwrap();
    let plan = Plan::lower(&model("tiny"), 16, 24).unwrap();
    let measurement = measurement(&plan, 1);
    let mut executor = GpuExecutor::new(&gpu, plan.clone(), &calibration()).unwrap();
    let mut result = vec![0.0; plan.result.shape.len()];
    executor.run(&measurement, 0, &mut result).unwrap();
    gpu.destroy();
    for _ in 0..2 {
        let error = executor.run(&measurement, 0, &mut result).unwrap_err();
        assert!(matches!(error.cause(), Some(GpuError::Lost(_))), "{error:?}");
    }
    assert!(matches!(GpuExecutor::new(&gpu, plan, &calibration()), Err(GpuError::Lost(_))));
}

#[test]
fn adapters_are_listed_and_found_by_name() {
    let adapters = adapters();
    let name = gpu().adapter().name.clone();
    assert!(adapters.iter().any(|adapter| adapter.name == name), "{adapters:?}");
    let choice = AdapterChoice { substring: Some(name.to_uppercase()), allow_software: false };
    assert_eq!(Gpu::open(&choice).unwrap().adapter().name, name);
    let choice = AdapterChoice { substring: Some("no such adapter".into()), allow_software: true };
    match Gpu::open(&choice) {
        Err(GpuError::NoAdapter(problem)) => assert!(problem.contains(&name), "{problem}"),
        other => panic!("{other:?}"),
    }
}

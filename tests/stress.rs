//! Numbers under stress: every kernel and both kinds of net on inputs, weights and cameras that were chosen to hurt, and
//! results that must not depend on how they were computed. `pix2hdr bench --stability` is the long form.

#[allow(dead_code, reason = "each test file uses a part of this module")]
mod support;

use std::collections::BTreeMap;

use pix2hdr::bench::stability::{self, Input, NamedCalibration, Trial, TrialOutcome, WeightStress};
use pix2hdr::network::{Model, Precision, presets};
use pix2hdr::sensor::{Capture, Form, Pattern, Sampler};
use pix2hdr::synth::{Backend, Settings, Skip, Synthesizer};
use pix2hdr::video::Video;
use support::gpu;

/// The CPU at f32, and the GPU at both precisions.
fn backends() -> [Backend; 3] {
    [Backend::Cpu, Backend::Gpu(gpu().clone(), Precision::F32), Backend::Gpu(gpu().clone(), Precision::F16)]
}

fn default_camera() -> NamedCalibration {
    NamedCalibration::new("mpve-1-4", "linear", Form::Linear).unwrap()
}

/// Fails if a step left its bound; prints the largest fraction of each kernel.
fn assert_within_bounds(outcomes: &[TrialOutcome]) {
    let mut largest = BTreeMap::<&str, f64>::new();
    for outcome in outcomes {
        for step in &outcome.steps {
            let known = largest.entry(step.kernel).or_insert(0.0);
            *known = known.max(step.fraction);
            let what = outcome.what();
            assert!(
                step.fraction <= 1.0,
                "{what}: '{}' is off by {} times its bound",
                step.step,
                step.fraction
            );
            assert!(step.magnitude.is_finite(), "{what}: '{}' reaches {}", step.step, step.magnitude);
        }
    }
    println!("{largest:.3?}");
}

#[test]
fn every_kernel_under_every_stress() {
    let (model, camera) = (stability::every_kernel().unwrap(), default_camera());
    for backend in backends() {
        let f16 = backend.precision() == Precision::F16;
        for weights in WeightStress::ALL {
            let trial = Trial { model: &model, weights, camera: &camera, extent: [6, 10] };
            let outcomes = trial.run(&backend, &Input::ALL).unwrap();
            println!("{} {} {weights:?}", backend.name(), backend.precision().name());
            assert_within_bounds(&outcomes);
            // Results that f16 cannot hold are stored in other units, all others as they are.
            let rescaled = outcomes.iter().any(|outcome| !outcome.rescaled.is_empty());
            assert_eq!(rescaled, f16 && weights == WeightStress::BeyondF16Limit, "{weights:?}: {outcomes:?}");
            let largest = outcomes.iter().flat_map(|outcome| &outcome.steps).map(|step| step.magnitude);
            let largest = largest.fold(0.0, f32::max);
            match weights {
                WeightStress::NearF16Limit => assert!((2e4..65504.0).contains(&largest), "{largest}"),
                WeightStress::BeyondF16Limit => assert!(largest > 2e7, "{largest}"),
                _ => assert!(largest < 1e4, "{weights:?} reaches {largest}"),
            }
        }
    }
}

#[test]
fn every_pattern_and_response() {
    let model = stability::every_kernel().unwrap();
    let inputs = [Input::Random, Input::Alternating, Input::AtSaturation];
    for camera in NamedCalibration::all().unwrap() {
        let trial = Trial { model: &model, weights: WeightStress::Plain, camera: &camera, extent: [6, 6] };
        for backend in &backends()[..2] {
            println!("{} {}", camera.name, backend.name());
            assert_within_bounds(&trial.run(backend, &inputs).unwrap());
        }
    }
}

/// From start to end against the f64 oracle: trained nets that predict kernels, and of the paper's topology.
#[test]
fn whole_nets_stay_close_to_the_oracle() {
    let camera = default_camera();
    for (name, extent) in [("fast", [8, 16]), ("paper-narrow", [8, 16])] {
        let model = stability::preset(name).unwrap();
        let trial = Trial { model: &model, weights: WeightStress::Plain, camera: &camera, extent };
        for backend in backends() {
            let outcomes = trial.run(&backend, &Input::ALL).unwrap();
            assert_within_bounds(&outcomes);
            let least = if backend.precision() == Precision::F16 { 60.0 } else { 100.0 };
            for outcome in outcomes {
                let psnr = outcome.psnr_db.unwrap();
                println!("{}: {psnr:.1} dB", outcome.what());
                assert!(psnr >= least, "{}: {psnr:.1} dB", outcome.what());
            }
        }
    }
}

fn capture(pattern: &str, video: &Video) -> Capture {
    Sampler::new(Pattern::built_in(pattern).unwrap(), Form::Linear).unwrap().sample(video).unwrap()
}

/// A scene in which something moves.
fn moving(frames: usize, height: usize, width: usize) -> Video {
    let value = |i: usize| {
        let (t, y, x) = (i / (height * width), i / width % height, i % width);
        0.5 + 0.5 * ((x as f32 * 0.7 - t as f32 * 0.9).sin() * (y as f32 * 0.4).cos())
    };
    Video::new(frames, height, width, (0..frames * height * width).map(value).collect()).unwrap()
}

fn synthesise(model: &Model, capture: &Capture, backend: &Backend, settings: &Settings) -> Video {
    let extent = [capture.height, capture.width];
    let mut synthesizer = Synthesizer::new(model, capture.calibration(), extent, backend, settings).unwrap();
    synthesizer.video(capture).unwrap().0
}

/// Runs, threads, tiles and windows leave the bytes as they are, on each executor and at each precision.
#[test]
fn the_same_input_gives_the_same_bytes() {
    let model = stability::preset("fast").unwrap();
    let capture = capture("mpve-1-4", &moving(11, 24, 60));
    for backend in backends() {
        let whole = synthesise(&model, &capture, &backend, &Settings::default());
        let same = |what: &str, settings: Settings| {
            let again = synthesise(&model, &capture, &backend, &settings);
            let what = format!("{} {}: {what}", backend.name(), backend.precision().name());
            assert!(again.data == whole.data, "{what} changes the result");
        };
        same("a second run", Settings::default());
        same("tiles of 16 pixels", Settings { tile: Some(16), ..Settings::default() });
        same("short windows", Settings { hop: Some(4), ..Settings::default() });
        same("skipping what repeats", Settings { skip: Skip::Exact, ..Settings::default() });
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| same(&format!("{threads} threads"), Settings::default()));
        }
    }
}

/// The smallest frames of every pattern, and recordings shorter than anything.
#[test]
fn the_smallest_recordings() {
    for name in Pattern::NAMES {
        let pattern = Pattern::built_in(name).unwrap();
        let mut model = Model::random(presets::by_name("tiny").unwrap().graph().unwrap(), 2).unwrap();
        model.graph.pattern = "any".into();
        for frames in [1, 2, pattern.period() + 1] {
            let capture = capture(name, &moving(frames, pattern.rows(), pattern.cols()));
            let video = synthesise(&model, &capture, &Backend::Cpu, &Settings::default());
            assert_eq!([video.frames, video.height, video.width], [frames, pattern.rows(), pattern.cols()]);
            assert!(video.data.iter().all(|p| p.is_finite() && *p >= 0.0), "{name}, {frames} frames");
        }
    }
}

/// A scene that does not change gives, at each phase of the pattern, the same frame for ever: no drift, no seam.
#[test]
fn a_constant_scene_stays_constant() {
    let frame: Vec<f32> =
        (0..16 * 16).map(|i| 0.02 + 0.9 * ((i * 37 % 101) as f32 / 100.0).powi(3)).collect();
    let video = Video::new(3000, 16, 16, frame.repeat(3000)).unwrap();
    let mut sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
    sampler.noise = pix2hdr::sensor::Noise::NONE;
    let capture = sampler.sample(&video).unwrap();
    let model = stability::preset("fast").unwrap();
    let result = synthesise(&model, &capture, &Backend::Cpu, &Settings::default());
    // Read-outs that began before the first frame are dark.
    for t in 48..3000 - 32 {
        assert!(result.frame(t) == result.frame(t - 8), "frame {t} differs from the one a period before");
    }
}

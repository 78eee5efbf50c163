//! Windows and tiles leave no trace: the result is that of the whole video at once.

use pix2hdr::cpu::CpuExecutor;
use pix2hdr::network::{Executor, Model, Plan, Precision, presets};
use pix2hdr::sensor::{Capture, Form, Pattern, Sampler, Timing};
use pix2hdr::synth::{Backend, ExecutorChoice, Settings, Synthesizer, check_fits};
use pix2hdr::video::Video;

fn model(preset: &str) -> Model {
    Model::random(presets::by_name(preset).unwrap().graph().unwrap(), 7).unwrap()
}

fn truth(frames: usize, height: usize, width: usize) -> Video {
    let value = |i: usize| {
        let (t, y, x) = (i / (height * width), i / width % height, i % width);
        0.5 + 0.5 * ((x as f32 * 0.7 - t as f32 * 0.9).sin() * (y as f32 * 0.4).cos())
    };
    Video::new(frames, height, width, (0..frames * height * width).map(value).collect()).unwrap()
}

fn camera() -> Sampler {
    Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap()
}

fn synthesise(model: &Model, capture: &Capture, side: Option<usize>) -> Video {
    let backend = Backend::choose(ExecutorChoice::Cpu, None, Precision::F32).unwrap();
    let extent = [capture.height, capture.width];
    let settings = Settings { tile: side, ..Settings::default() };
    let mut synthesizer =
        Synthesizer::new(model, capture.calibration(), extent, &backend, &settings).unwrap();
    synthesizer.video(capture).unwrap().0
}

/// A random net in tiles gives the bytes of the same net on the whole frame.
#[test]
fn tiles_equal_the_whole() {
    for (preset, side) in [("tiny", 24), ("fast", 40)] {
        let capture = camera().sample(&truth(9, 70, 150)).unwrap();
        let model = model(preset);
        let whole = synthesise(&model, &capture, None);
        let tiled = synthesise(&model, &capture, Some(side));
        assert_eq!(whole.data, tiled.data, "{preset}");
    }
}

/// Where a recording begins and which windows it falls into changes no frame that sees the same read-outs.
#[test]
fn windows_leave_no_seam() {
    let video = truth(72, 16, 16);
    let mut long = model("tiny");
    let capture = camera().sample(&video).unwrap();
    let at_once = synthesise(&long, &capture, None);
    let lead = long.graph.window.lead;
    for hop in [1, 5, 8, 30] {
        long.graph.window.hop = hop;
        long.graph.window.frames = hop + 2 * lead;
        let in_pieces = synthesise(&long, &capture, None);
        // The frames beyond both ends are stand-ins, the same ones for any window.
        assert_eq!(at_once.data, in_pieces.data, "hop {hop}");
    }
}

/// Sample and hold loses nothing but the read-outs behind the last frame.
#[test]
fn hold_equals_covering() {
    let video = truth(60, 16, 16);
    let mut sampler = camera();
    sampler.noise = pix2hdr::sensor::Noise::NONE;
    let model = model("tiny");
    let covering = synthesise(&model, &sampler.sample(&video).unwrap(), None);
    sampler.timing = Timing::Hold;
    let hold = synthesise(&model, &sampler.sample(&video).unwrap(), None);
    let reach = model.graph.reach().unwrap()[0] + 8;
    for t in 0..60 - reach {
        assert_eq!(covering.frame(t), hold.frame(t), "frame {t}");
    }
}

/// Any size from the pattern's tile on and any length from one frame on, all of it finite.
#[test]
fn every_size_works() {
    for preset in ["tiny", "paper-narrow"] {
        let model = model(preset);
        for (frames, height, width) in [(1, 2, 4), (2, 3, 5), (7, 5, 11), (11, 17, 6)] {
            for start in [0, -3, 5] {
                let mut sampler = camera();
                sampler.schedule_start = start;
                let video = synthesise(&model, &sampler.sample(&truth(frames, height, width)).unwrap(), None);
                assert_eq!([video.frames, video.height, video.width], [frames, height, width]);
                assert!(video.data.iter().all(|p| p.is_finite() && *p >= 0.0));
            }
        }
    }
}

/// Most windows of a short recording are not full: their time is that of the frames that they give.
#[test]
fn times_are_those_of_frames_that_were_delivered() {
    let (model, capture) = (model("tiny"), camera().sample(&truth(5, 16, 16)).unwrap());
    let mut synthesizer =
        Synthesizer::new(&model, capture.calibration(), [16, 16], &Backend::Cpu, &Settings::default())
            .unwrap();
    let (_, report) = synthesizer.video(&capture).unwrap();
    assert_eq!((report.windows, report.frames), (1, 5));
    let all = 5.0 * report.ms_per_frame() / 1e3;
    let [least, most] = [report.inference, report.wall].map(|time| time.as_secs_f64());
    assert!((0.999 * least..=most).contains(&all), "{all} s is not from {least} to {most} s");
}

/// A net that sees pixel values is for the response that it was trained with; a warning says so in one line.
#[test]
fn another_response_is_warned_of() {
    let warning = |net: &str, form: Form| {
        let sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), form).unwrap();
        let capture = sampler.sample(&truth(2, 8, 8)).unwrap();
        check_fits(&Model::load(net).unwrap(), &capture.recording()).unwrap()
    };
    assert_eq!(warning("fast", Form::Gamma(2.2)), None);
    assert_eq!(warning("paper-narrow", Form::Linear), None);
    assert!(warning("paper-narrow", Form::Gamma(2.2)).unwrap().contains("has {\"gamma\":2.2}"));
    let table = Form::Table(vec![(0.0, 0.0), (0.5, 0.6), (1.0, 1.0)]);
    assert!(warning("paper-narrow", table).unwrap().ends_with("the capture has a table of 3 rows"));
}

/// A net knows a pattern of the user's own by its name.
#[test]
fn nets_are_for_patterns_of_ones_own_too() {
    let mut model = model("tiny");
    model.graph.pattern = "mine".into();
    let pattern = |name: &str| Pattern::built_in("sve").unwrap().named(name);
    model.check_pattern(&pattern("mine")).unwrap();
    let refused = model.check_pattern(&pattern("sve")).unwrap_err().to_string();
    assert!(refused.contains("for pattern mine"), "{refused}");
}

/// Pixel values that are no numbers do not get into the net.
#[test]
fn values_that_are_no_numbers_stay_out() {
    let model = model("tiny");
    let plan = Plan::lower(&model, 8, 8).unwrap();
    let calibration = camera().sample(&truth(1, 8, 8)).unwrap().calibration();
    let mut executor = CpuExecutor::<f32>::new(plan.clone(), calibration);
    let mut measurement = vec![0.3; plan.measurement.shape.len()];
    measurement[5] = f32::NAN;
    measurement[9] = f32::INFINITY;
    measurement[13] = f32::NEG_INFINITY;
    let mut result = vec![0.0; plan.result.shape.len()];
    executor.run(&measurement, 0, &mut result).unwrap();
    assert!(result.iter().all(|p| p.is_finite()));
}

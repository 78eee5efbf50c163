//! Windows and tiles leave no trace: the result is that of the whole video at once.

use pix2hdr::cpu::CpuExecutor;
use pix2hdr::network::{Executor, Model, Plan, Precision, presets};
use pix2hdr::sensor::{
    Capture, CaptureInfo, Form, Noise, Orientation, Pattern, PatternSpec, Sampler, Timing,
};
use pix2hdr::synth::{Backend, ExecutorChoice, Settings, Skip, Synthesizer, check_fits};
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

/// What is accumulated knows neither tiles nor windows, and a run that is gone on with makes the same bytes.
#[test]
fn accumulation_knows_no_tiles_and_is_gone_on_with() {
    let backend = Backend::choose(ExecutorChoice::Cpu, None, Precision::F32).unwrap();
    let model = model("tiny");
    let capture = camera().sample(&truth(48, 40, 56)).unwrap();
    let frames = |from: usize, settings: Settings| {
        let settings = Settings { accumulate: true, ..settings };
        let extent = [capture.height, capture.width];
        let mut synthesizer =
            Synthesizer::new(&model, capture.calibration(), extent, &backend, &settings).unwrap();
        let mut frames = Vec::new();
        let sink = |result: pix2hdr::synth::ResultFrame| {
            frames.push((result.number, result.frame.values().to_vec()));
            Ok(())
        };
        synthesizer.stream(&mut *capture.frames(), from, sink).unwrap();
        frames
    };
    let whole = frames(0, Settings::default());
    assert!(whole == frames(0, Settings { tile: Some(24), hop: Some(8), ..Settings::default() }));
    assert!(whole[29..] == frames(29, Settings::default())[..]);
    let alone = synthesise(&model, &capture, None);
    assert!(whole[40].1 != alone.frame(40), "nothing was accumulated");
}

/// A camera that does not say how much its pixels scatter cannot tell change from noise.
#[test]
fn accumulation_needs_the_noise() {
    let mut camera = camera();
    camera.noise = Noise::NONE;
    let capture = camera.sample(&truth(24, 16, 16)).unwrap();
    let backend = Backend::choose(ExecutorChoice::Cpu, None, Precision::F32).unwrap();
    let settings = Settings { accumulate: true, ..Settings::default() };
    let mut synthesizer =
        Synthesizer::new(&model("tiny"), capture.calibration(), [16, 16], &backend, &settings).unwrap();
    let error = synthesizer.video(&capture).unwrap_err().to_string();
    assert!(error.contains("full_well_e") && error.contains("capture.json"), "{error}");
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

/// What a camera that is turned shows of [t, y, x] values, in the rectangle of [rows, columns] from `at` on.
fn shown(
    values: &[f32],
    sensor: [usize; 2],
    orientation: Orientation,
    at: [usize; 2],
    [rows, cols]: [usize; 2],
) -> Vec<f32> {
    let turned = Orientation::turned(sensor, orientation.transposes());
    let pixels: Vec<usize> = (at[0]..at[0] + rows)
        .flat_map(|y| (at[1]..at[1] + cols).map(move |x| [y, x]))
        .map(|place| orientation.sensor_place(turned, place))
        .map(|[v, u]| v * sensor[1] + u)
        .collect();
    values.chunks(sensor[0] * sensor[1]).flat_map(|frame| pixels.iter().map(|&pixel| frame[pixel])).collect()
}

/// What a crop, turned or not, of a recording gives is the crop of what the recording gives: to the bit, where that depends
/// on nothing outside. Every built-in net, from origins that are no multiple of anything.
#[test]
fn a_crop_by_any_origin_gives_the_same_bits() {
    for preset in presets::all().into_iter().filter(|preset| preset.trained) {
        let model = model(preset.name);
        let camera = Sampler::new(Pattern::built_in(&model.graph.pattern).unwrap(), Form::Linear).unwrap();
        let ([_, gy, gx], [_, ry, rx]) = (model.graph.granularity().unwrap(), model.graph.reach().unwrap());
        // The reach is that of a whole block of the net's grid, in which a pixel can lie anywhere.
        let reach = (ry + gy - 1).max(rx + gx - 1);
        let side = (2 * reach + 18).next_multiple_of(gy.max(gx).max(4));
        let capture = camera.sample(&truth(3, side, side)).unwrap();
        let whole = synthesise(&model, &capture, None);
        for (at, orientation) in [([1, 3], Orientation::Normal), ([2, 9], Orientation::Rotate90)] {
            let size = at.map(|at| side - at - 1);
            let crop = synthesise(&model, &capture.shown(orientation, at, size).unwrap(), None);
            let expected = shown(&whole.data, [side, side], orientation, at, size);
            let mut compared = 0;
            for (i, (value, expected)) in crop.data.iter().zip(&expected).enumerate() {
                let place = [i / size[1] % size[0], i % size[1]];
                if [0, 1].iter().all(|&axis| place[axis] >= reach && place[axis] + reach < size[axis]) {
                    assert_eq!(value, expected, "{}, {orientation:?} from {at:?}: {place:?}", preset.name);
                    compared += 1;
                }
            }
            assert!(compared >= 3 * 25, "{}: {compared} pixels", preset.name);
        }
    }
}

/// A tile that was rolled by hand is the same as an origin, and neither skipping nor an ensemble minds where frames lie.
#[test]
fn placed_frames_go_all_ways() {
    let model = model("tiny");
    let mut camera = camera();
    camera.noise = Noise::NONE;
    let capture = camera.sample(&truth(24, 48, 64)).unwrap();
    let crop = capture.shown(Orientation::Transpose, [3, 1], [45, 31]).unwrap();
    let plain = synthesise(&model, &crop, None);
    assert_eq!(synthesise(&model, &crop, Some(16)).data, plain.data, "tiles");
    // The same tile, written down as the crop shows it, is recognised.
    let tile = crop.pattern.clone().named("rolled");
    let info = CaptureInfo {
        pattern: PatternSpec::of(&tile),
        tile_origin: [0, 0],
        orientation: Orientation::Normal,
        ..crop.info.clone()
    };
    let named = Capture::new(info, [24, 45, 31], crop.counts.clone(), None).unwrap();
    assert_eq!(check_fits(&model, &named.recording()).unwrap(), None);
    assert!(named.recording().sensor_pattern().samples_like(camera.pattern()));
    let backend = Backend::choose(ExecutorChoice::Cpu, None, Precision::F32).unwrap();
    for (settings, same) in [
        (Settings { skip: Skip::Exact, ..Settings::default() }, true),
        (Settings { skip: Skip::Bounded(0.002), ..Settings::default() }, false),
        (Settings { ensemble: 8, ..Settings::default() }, false),
    ] {
        let mut synthesizer =
            Synthesizer::new(&model, crop.calibration(), [45, 31], &backend, &settings).unwrap();
        let mut frames = 0;
        let report = synthesizer
            .stream(&mut *crop.frames(), 0, |result| {
                if same {
                    assert_eq!(result.frame.values(), plain.frame(result.number));
                }
                if let Some((active, slab)) = &result.computed {
                    let cells = result.cell.map(|side| side);
                    assert_eq!(
                        active.extent()[1..],
                        [45usize.div_ceil(cells[0]), 31usize.div_ceil(cells[1])]
                    );
                    assert_eq!(active.slab(*slab).len(), active.extent()[1] * active.extent()[2]);
                }
                frames += 1;
                Ok(())
            })
            .unwrap();
        assert_eq!(frames, 24);
        if let Some(skipped) = report.skipping {
            assert_eq!(skipped.computed.len(), skipped.grid[0] * skipped.grid[1]);
        }
    }
}

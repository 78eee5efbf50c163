//! Self-ensemble: means over views in which the pattern looks the same.

use pix2hdr::Result;
use pix2hdr::network::{Model, Precision, presets};
use pix2hdr::sensor::{Capture, Form, Noise, Pattern, Sampler, Symmetry};
use pix2hdr::synth::{self, Backend, ExecutorChoice, Settings, Skip, Synthesizer};
use pix2hdr::video::{Video, tone};

const SIZE: [usize; 3] = [40, 80, 80];
/// Pixels and frames at the borders, where pixels outside of a view have stand-ins.
const BORDER: usize = 28;

fn model() -> Model {
    Model::load("tiny").unwrap()
}

/// Bars that move past a texture.
fn capture(pattern: &str, noise: Noise) -> Capture {
    let mut sampler = Sampler::new(Pattern::built_in(pattern).unwrap(), Form::Linear).unwrap();
    (sampler.noise, sampler.schedule_start) = (noise, 6);
    let [frames, height, width] = SIZE;
    let pixel = |i: usize| {
        let (t, y, x) = (i / (height * width), i / width % height, i % width);
        let bar = (x + 2 * y + 3 * t) % 40 < 9;
        0.1 * (0.9 * ((x as f32 * 0.31).sin() + (y as f32 * 0.23).cos())).exp() + if bar { 0.5 } else { 0.0 }
    };
    let video = Video::new(frames, height, width, (0..frames * height * width).map(pixel).collect()).unwrap();
    sampler.sample(&video).unwrap()
}

fn synthesise(request: ExecutorChoice, capture: &Capture, settings: &Settings) -> Result<Video> {
    let backend = Backend::choose(request, None, Precision::F32)?;
    let extent = [capture.height, capture.width];
    let mut synthesizer = Synthesizer::new(&model(), capture.calibration(), extent, &backend, settings)?;
    Ok(synthesizer.video(capture)?.0)
}

fn on_cpu(capture: &Capture, settings: &Settings) -> Video {
    synthesise(ExecutorChoice::Cpu, capture, settings).unwrap()
}

fn ensemble(ensemble: usize) -> Settings {
    Settings { ensemble, ..Settings::default() }
}

/// Where a view's frame or row or column lies in the recording; it may be outside. The recording of a view has the same
/// size, and begins as near to the recording's first or last place as the pattern lets it.
fn place(view: Symmetry, axis: usize, at: usize, capture: &Capture) -> usize {
    let Capture { info, pattern, frames, height, width, .. } = capture;
    let (start, size, repeat) = match axis {
        0 => (info.schedule_start, *frames, pattern.period() as i64),
        1 => (0, *height, pattern.rows() as i64),
        _ => (0, *width, pattern.cols() as i64),
    };
    let place = view.map(axis, start + at as i64) - start;
    let first = view.map(axis, start) - start;
    let moved = if view.backwards[axis] {
        (size as i64 - 1 - first).div_euclid(repeat) * repeat
    } else {
        -first.div_euclid(repeat) * repeat
    };
    (place + moved).rem_euclid(size as i64) as usize
}

/// The recording as a view shows it.
fn seen(capture: &Capture, view: Symmetry) -> Capture {
    let [frames, height, width] = SIZE;
    let pixel = |i: usize| {
        let (t, y, x) = (i / (height * width), i / width % height, i % width);
        let [t, y, x] = [(0, t), (1, y), (2, x)].map(|(axis, at)| place(view, axis, at, capture));
        capture.counts.value((t * height + y) * width + x)
    };
    let counts = pix2hdr::video::Counts::U16((0..frames * height * width).map(pixel).collect());
    Capture::new(capture.info.clone(), SIZE, counts, None).unwrap()
}

/// Differences of l between a recording's result and a view's, away from the borders: mean and largest.
fn difference(whole: &Video, other: &Video, view: Symmetry, capture: &Capture) -> [f64; 2] {
    let inside = |size: usize| BORDER..size - BORDER;
    let (mut sum, mut largest, mut count) = (0.0, 0.0f64, 0.0);
    for (y, x) in inside(SIZE[1]).flat_map(|y| inside(SIZE[2]).map(move |x| (y, x))) {
        for t in 16..SIZE[0] - 16 {
            let [from, row, col] = [(0, t), (1, y), (2, x)].map(|(axis, at)| place(view, axis, at, capture));
            let (one, other) = (whole.frame(from)[row * SIZE[2] + col], other.frame(t)[y * SIZE[2] + x]);
            let difference = (tone(one.into()) - tone(other.into())).abs();
            (sum, largest, count) = (sum + difference, largest.max(difference), count + 1.0);
        }
    }
    [sum / count, largest]
}

fn views(pattern: &str) -> Vec<Symmetry> {
    Symmetry::all_of(&Pattern::built_in(pattern).unwrap())
}

#[test]
fn a_view_of_a_recording_is_a_recording() {
    // With another view of the pattern, exposures would not fit, and irradiances would be off by factors.
    let capture = capture("mpve-1-4", Noise::NONE);
    let off = on_cpu(&capture, &ensemble(1));
    for view in views("mpve-1-4") {
        let result = on_cpu(&seen(&capture, view), &ensemble(1));
        let [mean, largest] = difference(&off, &result, view, &capture);
        assert!(mean < 0.02, "{view:?}: {mean}");
        assert_eq!(view == Symmetry::IDENTITY, largest == 0.0, "{view:?}");
    }
}

#[test]
fn an_ensemble_is_the_mean_over_views() {
    is_the_mean_over_views("mpve-1-4");
    // Its exposures change with time, so the schedule of a view matters.
    is_the_mean_over_views("interleaved");
}

fn is_the_mean_over_views(pattern: &str) {
    let capture = capture(pattern, Noise::default());
    let (off, two) = (on_cpu(&capture, &ensemble(0)), on_cpu(&capture, &ensemble(2)));
    let view = views(pattern)[1];
    assert!(view.backwards[0]);
    let mut other = on_cpu(&seen(&capture, view), &ensemble(1));
    // The mean of l, put where the view shows it.
    for t in 0..SIZE[0] {
        for (y, x) in (0..SIZE[1]).flat_map(|y| (0..SIZE[2]).map(move |x| (y, x))) {
            let [from, row, col] = [(0, t), (1, y), (2, x)].map(|(axis, at)| place(view, axis, at, &capture));
            let own = tone(off.frame(from)[row * SIZE[2] + col].into());
            let p = &mut other.frame_mut(t)[y * SIZE[2] + x];
            let mean = 0.5 * (own + tone((*p).into()));
            *p = ((5001f64.powf(mean) - 1.0) / 5000.0) as f32;
        }
    }
    let [_, largest] = difference(&two, &other, view, &capture);
    assert!(largest < 1e-5, "{largest}");
}

#[test]
fn tiles_short_windows_and_skipping_give_the_same_bits() {
    let capture = capture("mpve-1-4", Noise::NONE);
    let whole = on_cpu(&capture, &ensemble(8));
    for (what, settings) in [
        ("tiles", Settings { tile: Some(32), ..ensemble(8) }),
        ("short windows", Settings { hop: Some(16), ..ensemble(8) }),
        ("exact skipping", Settings { skip: Skip::Exact, ..ensemble(8) }),
    ] {
        assert!(on_cpu(&capture, &settings).data == whole.data, "{what}");
    }
}

#[test]
fn a_gpu_takes_the_same_mean() {
    let capture = capture("mpve-1-4", Noise::default());
    let cpu = on_cpu(&capture, &ensemble(4));
    let gpu = synthesise(ExecutorChoice::Gpu, &capture, &ensemble(4)).unwrap();
    let largest = cpu.data.iter().zip(&gpu.data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(largest < 1e-4, "{largest}");
}

#[test]
fn more_views_than_there_are_is_an_error() {
    let refused = |pattern: &str, count: usize| {
        let capture = capture(pattern, Noise::NONE);
        synthesise(ExecutorChoice::Cpu, &capture, &ensemble(count)).unwrap_err().to_string()
    };
    let message = refused("mpve-1-4", 9);
    assert!(message.contains("9 views") && message.contains('8') && !message.contains('\n'), "{message}");
    assert!(refused("coded", 2).contains("1 only"));
    // A net that goes through time in steps is not shown other times.
    let graph = presets::by_name("paper").unwrap().graph().unwrap();
    let calibration = capture("mpve-1-4", Noise::NONE).calibration();
    assert_eq!(synth::poses(&graph, &calibration, 4).unwrap().len(), 4);
    assert!(synth::poses(&graph, &calibration, 5).unwrap_err().to_string().contains("4 only"));
}

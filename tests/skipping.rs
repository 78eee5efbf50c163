//! Skipping leaves nothing out that matters: exact skipping no bit, bounded skipping no more than it promises.

use std::sync::Mutex;

use pix2hdr::network::{Model, Precision, presets};
use pix2hdr::sensor::{Capture, Form, Noise, Pattern, Sampler};
use pix2hdr::synth::{Backend, ExecutorChoice, Report, ResultFrame, Settings, Skip, Synthesizer};
use pix2hdr::video::{Video, tone};

/// Rows and columns of a cell.
const CELL: [usize; 2] = [4, 4];

fn model(preset: &str) -> Model {
    Model::random(presets::by_name(preset).unwrap().graph().unwrap(), 3).unwrap()
}

fn camera(pattern: &str, noise: Noise) -> Sampler {
    let mut sampler = Sampler::new(Pattern::built_in(pattern).unwrap(), Form::Linear).unwrap();
    sampler.noise = noise;
    sampler
}

/// A camera with so little noise that it hides nothing, and that says so.
fn quiet_camera() -> Sampler {
    let mut sampler = camera("mpve-1-4", Noise { full_well_e: 1e7, read_noise_e: 1.0 });
    sampler.bit_depth = 16;
    sampler
}

/// Irradiance of a static texture.
fn texture(y: usize, x: usize) -> f32 {
    0.15 * (0.9 * ((x as f32 * 0.31).sin() + (y as f32 * 0.23).cos())).exp()
}

/// A texture under what `change` makes of it: frame, row, column, irradiance.
fn scene(extents: [usize; 3], change: impl Fn(usize, usize, usize, f32) -> f32) -> Video {
    let [frames, height, width] = extents;
    let pixel = |i: usize| {
        let (t, y, x) = (i / (height * width), i / width % height, i % width);
        change(t, y, x, texture(y, x))
    };
    Video::new(frames, height, width, (0..frames * height * width).map(pixel).collect()).unwrap()
}

fn run(model: &Model, capture: &Capture, settings: &Settings) -> (Vec<ResultFrame>, Report) {
    let backend = Backend::choose(ExecutorChoice::Cpu, None, Precision::F32).unwrap();
    let extent = [capture.height, capture.width];
    let mut synthesizer = Synthesizer::new(model, capture.calibration(), extent, &backend, settings).unwrap();
    let frames = Mutex::new(Vec::new());
    let report = synthesizer
        .stream(&mut *capture.frames(), 0, |frame| {
            frames.lock().unwrap().push(frame);
            Ok(())
        })
        .unwrap();
    (frames.into_inner().unwrap(), report)
}

fn skip(skip: Skip) -> Settings {
    Settings { skip, ..Settings::default() }
}

/// Whether the cell that holds a pixel was computed for a frame.
fn computed(frame: &ResultFrame, y: usize, x: usize) -> bool {
    let (active, slab) = frame.computed.as_ref().unwrap();
    active.slab(*slab)[y / CELL[0] * active.extent()[2] + x / CELL[1]]
}

/// A box that enters a static scene, crosses it and stops.
fn passer_by(t: usize, y: usize, x: usize, p: f32) -> f32 {
    let left = 3 * t.clamp(60, 75) - 180;
    if (left..left + 6).contains(&x) && (9..14).contains(&y) { 0.7 } else { p }
}

/// Exact skipping gives the bytes of computing everything, whatever the net, the pattern and the tiles, and leaves a
/// good part of it out.
#[test]
fn exact_skipping_changes_no_bit() {
    for (preset, pattern, extent, side, most) in [
        ("tiny", "mpve-1-4", [40, 150], None, 0.6),
        ("tiny", "mpve-1-4", [30, 150], Some(48), 0.6),
        ("tiny", "mpve-1-16", [24, 120], None, 0.8),
        ("tiny", "interleaved", [21, 133], None, 0.7),
        ("fast", "mpve-1-4", [24, 180], None, 0.7),
    ] {
        let truth = scene([160, extent[0], extent[1]], passer_by);
        let capture = camera(pattern, Noise::NONE).sample(&truth).unwrap();
        let model = model(preset);
        let (off, _) = run(&model, &capture, &Settings { tile: side, ..Settings::default() });
        let (exact, report) = run(&model, &capture, &Settings { tile: side, ..skip(Skip::Exact) });
        let differing =
            off.iter().zip(&exact).find(|(off, exact)| off.frame.values() != exact.frame.values());
        assert_eq!(differing.map(|(off, _)| off.number), None, "{preset}, {pattern}");
        assert_eq!(off.len(), exact.len());
        let active = report.skipping.unwrap().active_fraction();
        assert!(active < most, "{preset}, {pattern}: {active} of the cells were computed");
    }
}

/// The paper's net has a fixed window, shorter than its pattern's period: cells are kept from two windows before.
#[test]
fn nets_with_fixed_windows_skip_exactly_too() {
    let still = scene([48, 16, 16], |_, _, _, p| p);
    let capture = camera("mpve-1-4", Noise::NONE).sample(&still).unwrap();
    let model = model("paper");
    let (off, _) = run(&model, &capture, &Settings::default());
    let (exact, report) = run(&model, &capture, &skip(Skip::Exact));
    assert!(off.iter().zip(&exact).all(|(off, exact)| off.frame.values() == exact.frame.values()));
    assert!(report.skipping.unwrap().active_fraction() < 0.5);
}

/// Where all of the scene moves, nothing is skipped, and nothing changes.
#[test]
fn a_scene_that_moves_is_computed() {
    let moving = scene([144, 24, 40], |t, y, x, _| texture(y, x + t));
    let capture = camera("mpve-1-4", Noise::default()).sample(&moving).unwrap();
    let model = model("tiny");
    let (off, _) = run(&model, &capture, &Settings::default());
    for mode in [Skip::Exact, Skip::Bounded(0.002)] {
        let (video, report) = run(&model, &capture, &skip(mode));
        assert!(report.skipping.unwrap().active_fraction() > 0.99, "{mode:?}");
        for (off, frame) in off.iter().zip(&video) {
            let differing =
                off.frame.values().iter().zip(frame.frame.values()).filter(|(a, b)| a != b).count();
            assert_eq!(differing, 0, "frame {}, {mode:?}", off.number);
        }
    }
}

/// Behind a window that moves everywhere the next one is computed without a question, so not for longer than that.
#[test]
fn a_scene_that_stops_is_kept_again() {
    let stopping = scene([480, 24, 40], |t, y, x, _| texture(y, x + t.min(200)));
    let capture = quiet_camera().sample(&stopping).unwrap();
    let model = Model::load("tiny").unwrap();
    let (off, _) = run(&model, &capture, &Settings::default());
    let (kept, _) = run(&model, &capture, &skip(Skip::Bounded(0.002)));
    let share = |frame: &ResultFrame| {
        let (active, slab) = frame.computed.as_ref().unwrap();
        let cells = active.slab(*slab);
        cells.iter().filter(|cell| **cell).count() as f64 / cells.len() as f64
    };
    assert!(kept[..240].iter().all(|frame| share(frame) == 1.0));
    // It stopped in a window that was not asked about, and the next one knows what that one saw.
    assert!(kept[240..].iter().all(|frame| share(frame) == 0.0));
    assert!(off[..240].iter().zip(&kept).all(|(off, kept)| off.frame.values() == kept.frame.values()));
    let apart = |(a, b): (&f32, &f32)| (tone(f64::from(*a)) - tone(f64::from(*b))).abs();
    let largest = off[479].frame.values().iter().zip(kept[479].frame.values()).map(apart).fold(0.0, f64::max);
    assert!(largest < 0.002, "{largest}");
}

/// Noise wakes hardly any cell, whether the capture says how large it is or not.
#[test]
fn noise_alone_wakes_nothing() {
    let still = scene([400, 48, 64], |_, _, _, p| p);
    let mut capture = camera("mpve-1-4", Noise::default()).sample(&still).unwrap();
    for noise in ["stated", "estimated"] {
        let (_, report) = run(&model("tiny"), &capture, &skip(Skip::Bounded(0.002)));
        let skipped = report.skipping.unwrap();
        assert_eq!(skipped.noise, noise);
        let whole = skipped.whole_windows as f64 / report.windows as f64;
        assert!(skipped.active_fraction() - whole < 0.02, "{noise}: {skipped:?}");
        (capture.info.full_well_e, capture.info.read_noise_e) = (None, None);
    }
}

/// A speck that moves slowly, hardly brighter than its surroundings, and a single pixel that flashes once, are seen.
#[test]
fn small_changes_are_not_averaged_away() {
    let speck = |t: usize| 10 + t / 8;
    let changing = scene([240, 48, 64], |t, y, x, p| {
        let on_speck = (20..22).contains(&y) && (speck(t)..speck(t) + 2).contains(&x);
        let flash = (y, x, t / 8) == (40, 50, 22);
        if flash {
            1.0
        } else if on_speck {
            1.5 * p
        } else {
            p
        }
    });
    let capture = camera("mpve-1-4", Noise::default()).sample(&changing).unwrap();
    let (frames, report) = run(&model("tiny"), &capture, &skip(Skip::Bounded(0.002)));
    assert!(computed(&frames[22 * 8 + 4], 40, 50), "the flash was missed");
    let seen = frames.iter().skip(40).filter(|frame| computed(frame, 20, speck(frame.number))).count();
    assert!(seen as f64 > 0.9 * 200.0, "the speck was seen in {seen} of 200 frames");
    assert!(report.skipping.unwrap().active_fraction() < 0.5);
}

/// A scene that brightens by 0.1% per window never drifts away from what computing everything gives: the reference is
/// what a cell was last computed from, not the window before.
#[test]
fn slow_drift_stays_within_the_allowed_error() {
    // Dark enough for no read-out to saturate: where one begins to, the net's result jumps.
    let brightening = scene([800, 24, 32], |t, _, _, p| 0.25 * p * 1.001f32.powf(t as f32 / 40.0));
    let capture = quiet_camera().sample(&brightening).unwrap();
    let model = Model::load("fast").unwrap();
    let (off, _) = run(&model, &capture, &Settings::default());
    for allowed in [0.0005, 0.001] {
        let (kept, report) = run(&model, &capture, &skip(Skip::Bounded(allowed)));
        let skipped = report.skipping.unwrap();
        assert!(skipped.active_fraction() < 0.4, "{skipped:?}");
        let [rows, cols] = skipped.cell;
        let mut largest: f64 = 0.0;
        for (off, kept) in off.iter().zip(&kept) {
            for cell in 0..24 / rows * (32 / cols) {
                let (top, left) = (cell / (32 / cols) * rows, cell % (32 / cols) * cols);
                let pixels = (0..rows * cols).map(|i| (top + i / cols) * 32 + left + i % cols);
                let l = |frame: &ResultFrame, i: usize| tone(f64::from(frame.frame.values()[i]));
                let change: f64 = pixels.map(|i| l(kept, i) - l(off, i)).sum();
                largest = largest.max((change / (rows * cols) as f64).abs());
            }
        }
        // It comes close to what is allowed, and 20 windows of drift would be 0.0023.
        assert!((0.3 * allowed..allowed).contains(&largest), "off by {largest} of {allowed}");
    }
}

/// Captures whose windows cannot be of the wanted length are refused.
#[test]
fn windows_of_another_length_need_a_net_that_gives_the_same() {
    let capture = camera("mpve-1-4", Noise::NONE).sample(&scene([9, 16, 16], |_, _, _, p| p)).unwrap();
    let backend = Backend::choose(ExecutorChoice::Cpu, None, Precision::F32).unwrap();
    let hop = |model: &Model, hop| {
        let settings = Settings { hop: Some(hop), ..Settings::default() };
        Synthesizer::new(model, capture.calibration(), [16, 16], &backend, &settings).map(|_| ())
    };
    hop(&model("tiny"), 16).unwrap();
    assert!(hop(&model("paper"), 16).unwrap_err().to_string().contains("16"));
}

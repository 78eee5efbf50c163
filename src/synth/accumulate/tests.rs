//! A net that is off by 0.012 in l, half of it for good at each pixel and half anew in each frame, stands for all nets.

use super::{Accumulation, SUCCESSION};
use crate::frame::Extent;
use crate::math::{MU, fnv_1a, tone};
use crate::sensor::{CameraModel, Form, Noise, Pattern, Sampler};
use crate::video::Video;

const SIDE: usize = 32;

/// The paper's camera in normal room light: 562 electrons, with a pedestal that keeps noise at black.
fn sampler() -> Sampler {
    let mut sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
    sampler.noise = Noise { full_well_e: 562.0, ..sampler.noise };
    sampler.black_level = CameraModel::built_in("pe-cmos").unwrap().black_level;
    sampler
}

/// A number in [−1, 1] for each value of `what`.
fn random(what: [usize; 3]) -> f64 {
    let hash = fnv_1a(what.into_iter().flat_map(usize::to_le_bytes));
    (hash >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// What the stand-in of a net makes of `truth`.
fn net(truth: &Video) -> Video {
    let pixels = SIDE * SIDE;
    let off = |i: usize| {
        let (t, pixel) = (i / pixels, i % pixels);
        0.012 * (1.5f64).sqrt() * (random([pixel, 0, 0]) + random([pixel, t, 1]))
    };
    let value = |(i, &p): (usize, &f32)| {
        let l = (tone(f64::from(p)) + off(i)).clamp(0.0, 1.0);
        ((l * MU.ln_1p()).exp_m1() / MU) as f32
    };
    Video::new(truth.frames, SIDE, SIDE, truth.data.iter().enumerate().map(value).collect()).unwrap()
}

/// A scene with detail down to pixels, a part of which saturates; `place` says where its pixel lies.
fn scene(frames: usize, place: impl Fn(usize, usize, usize) -> (f64, f64)) -> Video {
    let value = |i: usize| {
        let (t, y, x) = (i / (SIDE * SIDE), i / SIDE % SIDE, i % SIDE);
        let (v, u) = place(t, y, x);
        (0.02 + 0.3 * (0.5 + 0.5 * (0.9 * u).sin() * (0.7 * v).cos()).powi(3)) as f32
    };
    Video::new(frames, SIDE, SIDE, (0..frames * SIDE * SIDE).map(value).collect()).unwrap()
}

/// The stand-in's results for `truth`, and what becomes of them from frame `from` on.
fn accumulated(truth: &Video, from: usize) -> (Video, Video) {
    let capture = sampler().sample(truth).unwrap();
    let recording = capture.recording();
    let extent = Extent::from([SIDE, SIDE]);
    let mut accumulation = Accumulation::new(&recording, &recording.calibration(), extent, None).unwrap();
    let before = net(truth);
    let mut after = before.clone();
    let mut source = capture.frames();
    for number in 0..truth.frames {
        let frame = source.next().unwrap().unwrap();
        if number >= from {
            accumulation.fuse(number, frame.time(), (frame.values(), SIDE), after.frame_mut(number));
        }
    }
    (before, after)
}

/// Mean squared error of frames `times`, in l.
fn error(video: &Video, truth: &Video, times: std::ops::Range<usize>) -> f64 {
    let frames = times.len();
    let squares = times.flat_map(|t| video.frame(t).iter().zip(truth.frame(t))).map(|(&p, &q)| {
        let off = tone(f64::from(p)) - tone(f64::from(q));
        off * off
    });
    squares.sum::<f64>() / (frames * SIDE * SIDE) as f64
}

/// Ratio of the errors after and before, in dB: below zero it was worth it.
fn change(truth: &Video, times: std::ops::Range<usize>) -> f64 {
    let (before, after) = accumulated(truth, 0);
    10.0 * (error(&after, truth, times.clone()) / error(&before, truth, times)).log10()
}

/// What rests gets better the longer one looks, by more than averaging the net's results could: half of
/// their error stays for good, so that gains 3 dB.
#[test]
fn rest_pays() {
    let truth = scene(256, |_, y, x| (y as f64, x as f64));
    let (before, after) = accumulated(&truth, 0);
    let gain = |times: std::ops::Range<usize>| {
        10.0 * (error(&before, &truth, times.clone()) / error(&after, &truth, times)).log10()
    };
    let [early, later, late] = [16..32, 64..96, 192..256].map(gain);
    assert!(early < later && later < late && late > 4.0, "{early:.2}, {later:.2}, {late:.2} dB");
}

/// Nothing is believed before every pixel has been seen twice.
#[test]
fn the_first_frames_are_the_nets_to_the_bit() {
    let truth = scene(16, |_, y, x| (y as f64, x as f64));
    let (before, after) = accumulated(&truth, 0);
    assert!(before.data == after.data);
}

/// What moves gets no worse, however slowly: 1/64 to 1 pixel a frame.
#[test]
fn motion_costs_nothing() {
    for speed in [1.0 / 64.0, 0.0625, 0.25, 0.5, 1.0] {
        let truth = scene(160, |t, y, x| (y as f64, x as f64 + speed * t as f64));
        let change = change(&truth, 96..160);
        assert!(change < 0.1, "{speed} pixels a frame: {change:+.2} dB");
    }
}

/// Light that flickers looks steady to exposures as long as its period, and is news to shorter ones. With the pattern's own
/// period only the shortest see it at all, and only half of their read-outs; so little of it is above the noise of these 562
/// electrons that it costs something.
#[test]
fn flicker_costs_little() {
    for (period, most) in [(6, 0.1), (8, 1.0), (16, 0.1)] {
        let mut truth = scene(160, |_, y, x| (y as f64, x as f64));
        for t in (0..160).filter(|t| t % period < period / 2) {
            truth.frame_mut(t).iter_mut().for_each(|p| *p *= 0.5);
        }
        let change = change(&truth, 96..160);
        assert!(change < most, "a period of {period} frames: {change:+.2} dB");
    }
}

/// A change leaves no ghost: 16 frames later the error is within 0.1 dB of that without a memory.
#[test]
fn a_change_leaves_no_ghost() {
    let jump = |t: usize| if t < 100 { 0.0 } else { 11.3 };
    let moved = scene(160, |t, y, x| (y as f64, x as f64 + jump(t)));
    // A light that is switched on for a moment, over a quarter of the frame.
    let mut flashed = scene(160, |_, y, x| (y as f64, x as f64));
    for t in 100..108 {
        let frame = flashed.frame_mut(t);
        for y in 0..SIDE / 2 {
            frame[y * SIDE..][..SIDE / 2].iter_mut().for_each(|p| *p *= 2.0);
        }
    }
    for (what, truth, times) in [("a jump", moved, 116..124), ("a flash", flashed, 124..132)] {
        let change = change(&truth, times);
        assert!(change < 0.1, "{what}: {change:+.2} dB");
    }
}

/// A run that is gone on with remembers what one from the beginning would.
#[test]
fn going_on_changes_no_bit() {
    let frames = 2 * SUCCESSION + 40;
    let truth = scene(frames, |t, y, x| (y as f64, x as f64 + (t / 500) as f64));
    let number = frames - 16;
    let begins = Accumulation::begins(number);
    assert_eq!(begins, SUCCESSION);
    let (_, whole) = accumulated(&truth, 0);
    let (_, later) = accumulated(&truth, begins);
    for t in number..frames {
        assert_eq!(whole.frame(t), later.frame(t), "frame {t}");
    }
}

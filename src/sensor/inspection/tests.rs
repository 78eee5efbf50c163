use super::*;
use crate::sensor::{Capture, CaptureInfo, Form, Orientation, Pattern, Sampler};
use crate::video::Video;

fn camera() -> Sampler {
    Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap()
}

/// A static scene with some texture, and a bright part.
fn scene() -> Video {
    let value = |i: usize| if i < 64 { 0.9 } else { 0.06 + 0.02 * (i as f32 * 0.05).sin() };
    let frame: Vec<f32> = (0..32 * 32).map(value).collect();
    Video { frames: 32, height: 32, width: 32, data: frame.repeat(32) }
}

/// What is found of counts that are described otherwise.
fn found(capture: &Capture, change: impl FnOnce(&mut CaptureInfo)) -> Vec<Finding> {
    let mut info = capture.info.clone();
    change(&mut info);
    let recording = Recording::new(info, [capture.height, capture.width], None).unwrap();
    let mut inspection = Inspection::new(&recording, capture.counts.bits(), capture.frames, 0);
    let len = capture.height * capture.width;
    (0..capture.frames).for_each(|t| inspection.add(&capture.counts.range(t * len..(t + 1) * len)));
    inspection.findings()
}

/// The only thing that is found, in words.
fn only(found: &[Finding]) -> String {
    assert_eq!(found.len(), 1, "{found:#?}");
    found[0].to_string()
}

/// `capture` with other counts.
fn with(capture: &Capture, counts: Counts) -> Capture {
    Capture { counts, ..capture.clone() }
}

fn counts(capture: &Capture, map: impl Fn(u16) -> u16) -> Counts {
    Counts::U16((0..capture.counts.len()).map(|i| map(capture.counts.value(i))).collect())
}

#[test]
fn what_is_described_rightly_is_not_doubted() {
    for (pedestal, bits) in [(0, 10), (48, 10), (0, 12), (200, 12), (0, 8)] {
        let mut camera = camera();
        (camera.black_level, camera.bit_depth, camera.schedule_start) = (pedestal, bits, 3);
        let capture = camera.sample(&scene()).unwrap();
        assert_eq!(found(&capture, |_| {}), [], "pedestal {pedestal}, {bits} bits");
        let turned = capture.shown(Orientation::Rotate270, [1, 2], [29, 30]).unwrap();
        assert_eq!(found(&turned, |_| {}), [], "turned, pedestal {pedestal}, {bits} bits");
    }
}

#[test]
fn counts_beyond_the_bit_depth_are_named_with_their_cure() {
    let capture = camera().sample(&scene()).unwrap();
    let left = with(&capture, counts(&capture, |count| count << 6));
    let text = only(&found(&left, |_| {}));
    assert!(
        text.contains("multiples of 64") && text.ends_with("--bit-depth 16 --white-level 65472"),
        "{text}"
    );
    // With what it says, nothing is left to be said.
    assert_eq!(found(&left, |info| (info.bit_depth, info.white_level) = (16, 65472.0)), []);
    let text = only(&found(&capture, |info| (info.bit_depth, info.white_level) = (9, 511.0)));
    assert!(text.ends_with("511 of 9 bits: --bit-depth 10 --white-level 1023"), "{text}");
    let bytes = Counts::U8((0..capture.counts.len()).map(|i| (capture.counts.value(i) >> 2) as u8).collect());
    let text = only(&found(&with(&capture, bytes.clone()), |_| {}));
    assert!(text.ends_with("--bit-depth 8 --white-level 255"), "{text}");
    assert_eq!(found(&with(&capture, bytes), |info| (info.bit_depth, info.white_level) = (8, 255.0)), []);
}

#[test]
fn wrong_levels_are_named_with_their_cure() {
    let capture = camera().sample(&scene()).unwrap();
    let text = only(&found(&capture, |info| (info.bit_depth, info.white_level) = (16, 65535.0)));
    assert!(text.contains("1023") && text.ends_with("--white-level 1023"), "{text}");
    let text = only(&found(&capture, |info| info.white_level = 900.0));
    assert!(text.ends_with("--white-level 1023"), "{text}");
    // Lossy video: what saturates is a few counts below the largest there can be, and spreads.
    let spread = |i: usize| (f64::from(capture.counts.value(i)) * 246.0 / 1023.0) as u8 + (i * 7 % 5) as u8;
    let lossy = with(&capture, Counts::U8((0..capture.counts.len()).map(spread).collect()));
    let right = |info: &mut CaptureInfo| {
        (info.bit_depth, info.black_level, info.white_level) = (8, 2.0, 248.0);
    };
    assert_eq!(found(&lossy, right), []);
    let text = only(&found(&lossy, |info| {
        right(info);
        info.white_level = 255.0;
    }));
    assert!(text.contains("pile up") && text.contains("--white-level 24"), "{text}");
}

#[test]
fn a_wrong_black_level_is_found_by_pixels_of_different_exposure() {
    let mut camera = camera();
    camera.black_level = 48;
    let capture = camera.sample(&scene()).unwrap();
    let found = found(&capture, |info| info.black_level = 0.0);
    let [Finding::Black { black_level, error, .. }] = found[..] else { panic!("{found:#?}") };
    assert!((black_level - 48.0).abs() < 3.0 * error.max(0.5), "{black_level} ± {error}");
}

#[test]
fn linear_recordings_pass_and_gamma_encoded_ones_are_named() {
    let capture = camera().sample(&scene()).unwrap();
    let recording = capture.recording();
    let mut inspection = Inspection::new(&recording, 16, 1, 0);
    inspection.add(&capture.counts.range(0..32 * 32));
    let check = inspection.exposure().unwrap();
    assert!((check.exponent - 1.0).abs() < 0.03 && !check.is_off(), "{check:?}");
    // The same scene through a gamma that nobody told us of.
    let sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Gamma(2.2)).unwrap();
    let encoded = with(&capture, sampler.sample(&scene()).unwrap().counts);
    let text = only(&found(&encoded, |_| {}));
    assert!(text.contains("do not scale") && text.contains("--fit-response"), "{text}");
}

#[test]
fn a_wrong_schedule_is_named_with_its_cure() {
    let capture = camera().sample(&scene()).unwrap();
    let text = only(&found(&capture, |info| info.tile_origin = [0, 1]));
    assert!(text.ends_with(": --tile-origin 0,0"), "{text}");
    let text = only(&found(&capture, |info| info.schedule_start = 2));
    assert!(text.ends_with(": --schedule-start 0"), "{text}");
}

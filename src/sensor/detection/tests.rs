use super::*;
use crate::scene::{Rendering, procedural, render};
use crate::sensor::{Capture, Form, Orientation, Sampler};

/// A recording in which much moves.
fn recording(pattern: &str, frames: usize, start: i64) -> Capture {
    let scene = procedural::by_name("fan", 48, 48, 1).unwrap();
    let how = Rendering { frames, height: 48, width: 48, instants: 2, positions: 1, seed: 1 };
    let mut sampler = Sampler::new(Pattern::built_in(pattern).unwrap(), Form::Linear).unwrap();
    sampler.schedule_start = start;
    sampler.sample(&render(&*scene, how, || {})).unwrap()
}

/// What frames `which` of a recording show, in which it is described as `described`.
fn detect(capture: &Capture, described: &Recording, which: impl Iterator<Item = usize>) -> Detection {
    let mut detector = Detector::new(described);
    let len = capture.height * capture.width;
    which.for_each(|t| detector.add(&capture.counts.range(t * len..(t + 1) * len)));
    detector.detect()
}

#[test]
fn a_wrong_description_is_corrected_in_as_little_as_possible() {
    let capture = recording("mpve-1-4", 64, 3).shown(Orientation::Rotate90, [1, 1], [40, 44]).unwrap();
    let found = |change: &dyn Fn(&mut Recording)| {
        let mut described = capture.recording();
        change(&mut described);
        described.pattern = described.info.placement().shown(&capture.recording().sensor_pattern());
        detect(&capture, &described, 0..64).schedule.unwrap()
    };
    let right = found(&|_| {});
    assert!(right.as_described && right.gaps.is_empty() && right.leak == 0.0, "{right:?}");
    assert_eq!((right.placement, right.schedule_start), (capture.info.placement(), 3));
    // Periods later is as right.
    let later = found(&|described| described.info.schedule_start = 803);
    assert!(later.as_described && later.schedule_start == 803);
    let start = found(&|described| described.info.schedule_start = 0);
    assert!(!start.as_described);
    assert_eq!((start.placement, start.schedule_start), (capture.info.placement(), 3));
    let origin = found(&|described| described.info.tile_origin = [0, 0]);
    assert!(!origin.as_described && origin.placement.orientation == Orientation::Rotate90, "{origin:?}");
    let shown = |placement: Placement| placement.shown(&capture.recording().sensor_pattern());
    assert!(shown(origin.placement).samples_like(&capture.pattern) && origin.schedule_start == 3);
}

#[test]
fn dropped_and_repeated_frames_are_found() {
    let capture = recording("mpve-1-4", 128, 5);
    let described = capture.recording();
    let gaps = |which: &mut dyn Iterator<Item = usize>| {
        let found = detect(&capture, &described, which).schedule.unwrap();
        assert!(found.as_described, "{found:?}");
        found.gaps
    };
    assert_eq!(gaps(&mut (0..128)), []);
    assert_eq!(gaps(&mut (0..128).filter(|&t| t != 40)), [Gap { frame: 40, missing: 1 }]);
    let dropped = |t: &usize| !(40..43).contains(t) && *t != 90;
    assert_eq!(
        gaps(&mut (0..128).filter(dropped)),
        [Gap { frame: 40, missing: 3 }, Gap { frame: 87, missing: 1 }]
    );
    let repeated = (0..128).flat_map(|t| vec![t; if t == 70 { 2 } else { 1 }]);
    assert_eq!(gaps(&mut repeated.into_iter()), [Gap { frame: 71, missing: -1 }]);
    // One in eight is too many for what follows to be believed.
    let few = detect(&capture, &described, (0..128).filter(|t| t % 8 != 3));
    assert_eq!(few, Detection::default());
}

/// A recording of another pattern than is said, or one that says nothing, is not taken for what it is not.
#[test]
fn what_is_not_clear_is_not_known() {
    for (recorded, said) in [
        ("mpve-1-8", "mpve-1-4"),
        ("mpve-1-4", "mpve-1-8"),
        ("mpve-2x2-1-4", "mpve-1-4"),
        ("global", "mpve-1-4"),
        ("coded", "mpve-1-4"),
        ("coded", "coded"),
        ("interleaved", "mpve-1-4"),
    ] {
        let capture = recording(recorded, 96, 1);
        let mut described = capture.recording();
        described.info.pattern = crate::sensor::PatternSpec::Name(said.into());
        let described = Recording::new(described.info, [48, 48], None).unwrap();
        let found = detect(&capture, &described, 0..96);
        assert_eq!(found, Detection::default(), "{recorded}, described as {said}");
    }
    let capture = recording("mpve-1-4", 96, 0);
    let found = detect(&capture, &capture.recording(), std::iter::repeat_n(0, 96));
    assert_eq!(found, Detection::default());
    let found = detect(&capture, &capture.recording(), 0..9);
    assert_eq!(found, Detection::default(), "too few frames");
}

/// Other patterns whose places can be told apart.
#[test]
fn other_patterns_are_found() {
    for pattern in ["mpve-1-8", "mpve-1-16", "mpve-2x2-1-4", "sve", "multi-phase", "interleaved"] {
        let capture = recording(pattern, 160, 2);
        let found = detect(&capture, &capture.recording(), 0..160).schedule;
        assert!(found.is_some_and(|found| found.as_described && found.gaps.is_empty()), "{pattern}");
    }
}

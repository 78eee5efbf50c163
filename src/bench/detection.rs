//! How often a recording's own schedule is found: crops and turns of simulated recordings, at every schedule start.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

use crate::Result;
use crate::scene::{Rendering, procedural, render};
use crate::sensor::{Capture, CaptureInfo, Detector, Form, Noise, Orientation, Pattern, Sampler, Timing};
use crate::video::Counts;

/// Frames, and rows and columns of the sensor and of the crops from it.
const FRAMES: usize = 72;
const SENSOR: usize = 64;
const CROP: usize = 56;
/// Seed of scenes, noise and what lossy video adds.
const SEED: u64 = 5;

/// What is recorded: a scene, electrons at white, and whether anything in it moves.
const SCENES: [(&str, f64, &str); 9] = [
    ("fan", 9000.0, "a fan"),
    ("fan", 200.0, "a fan, much noise"),
    ("fan", f64::INFINITY, "a fan, no noise"),
    ("falling", 9000.0, "falling things"),
    ("still-moving", 9000.0, "almost still"),
    ("wedge-moving", 1000.0, "almost still, noise"),
    ("leds", 9000.0, "flashing lamps"),
    ("still", 9000.0, "still"),
    ("still", f64::INFINITY, "still, no noise"),
];

/// How often the schedule of some recordings was found.
#[derive(Clone, Debug, Default, Serialize)]
pub struct DetectionRate {
    /// What moves, and how noisy it is.
    pub scene: &'static str,
    /// How counts are stored.
    pub counts: &'static str,
    /// Recordings.
    pub recordings: usize,
    /// Part of them, in percent, of which tile origin, orientation and schedule start were found, all of them right.
    pub schedule_percent: f64,
    /// Part of them, in percent, of which it was found, rightly, what frames hold.
    pub timing_percent: f64,
    /// Recordings of which something was said that is wrong.
    pub wrong: usize,
}

/// How counts are stored.
#[derive(Clone, Copy)]
enum Storage {
    TenBits,
    EightBits,
    /// As lossy video: a tenth of the pixels is off by one, in every frame anew.
    Lossy,
}

impl Storage {
    const ALL: [Self; 3] = [Self::TenBits, Self::EightBits, Self::Lossy];

    fn name(self) -> &'static str {
        match self {
            Self::TenBits => "10 bits",
            Self::EightBits => "8 bits",
            Self::Lossy => "8 bits, lossy",
        }
    }

    /// `capture`, stored so.
    fn store(self, capture: &Capture) -> Result<Capture> {
        let depth = |bits: u32| CaptureInfo {
            bit_depth: bits,
            white_level: f64::from((1u32 << bits) - 1),
            ..capture.info.clone()
        };
        let eight = |i: usize| (capture.counts.value(i) >> 2) as u8;
        let pixels = 0..capture.counts.len();
        let (info, counts) = match self {
            Self::TenBits => return Ok(capture.clone()),
            Self::EightBits => (depth(8), pixels.map(eight).collect()),
            Self::Lossy => {
                let mut rng = ChaCha8Rng::seed_from_u64(SEED);
                let off = |i: usize| match rng.random_range(0..20) {
                    0 => eight(i).saturating_add(1),
                    1 => eight(i).saturating_sub(1),
                    _ => eight(i),
                };
                (depth(8), pixels.map(off).collect())
            }
        };
        let Capture { frames, height, width, .. } = *capture;
        Capture::new(info, [frames, height, width], Counts::U8(counts), None)
    }
}

/// Records every scene at every schedule start, covering and held, has every tile origin cut out of it in every storage,
/// turned in every way by turns, and looks at what is found.
pub fn detection() -> Result<Vec<DetectionRate>> {
    let pattern = Pattern::built_in("mpve-1-4")?;
    let mut rates: BTreeMap<[usize; 2], DetectionRate> = BTreeMap::new();
    for (number, (scene, full_well_e, shows)) in SCENES.into_iter().enumerate() {
        let scene = procedural::by_name(scene, SENSOR, SENSOR, SEED).expect("it is built in");
        let how = Rendering {
            frames: FRAMES,
            height: SENSOR,
            width: SENSOR,
            instants: 4,
            positions: 1,
            seed: SEED,
        };
        let video = render(&*scene, how, || {});
        let recordings = (0..pattern.period() as i64).flat_map(|start| {
            [Timing::Covering, Timing::Hold].map(|timing| {
                let mut sampler = Sampler::new(pattern.clone(), Form::Linear)?;
                let noise = if full_well_e.is_finite() {
                    Noise { full_well_e, ..Noise::default() }
                } else {
                    Noise::NONE
                };
                (sampler.noise, sampler.schedule_start, sampler.timing) = (noise, start, timing);
                sampler.sample(&video)
            })
        });
        for capture in recordings.collect::<Result<Vec<_>>>()? {
            let places: Vec<(usize, [usize; 2])> =
                (0..8).map(|place| (place, [place / pattern.cols(), place % pattern.cols()])).collect();
            let looked: Vec<Vec<(usize, [bool; 3])>> = places
                .into_par_iter()
                .map(|(place, [row, col])| {
                    let turn = place + number + capture.info.schedule_start as usize;
                    let orientation = Orientation::ALL[turn % Orientation::ALL.len()];
                    let at = Orientation::turned([row, col], orientation.transposes());
                    let shown = capture.shown(orientation, at, [CROP; 2])?;
                    let look = |(i, storage): (usize, Storage)| Ok((i, look(&storage.store(&shown)?)));
                    Storage::ALL.into_iter().enumerate().map(look).collect()
                })
                .collect::<Result<_>>()?;
            for (storage, [schedule, timing, wrong]) in looked.into_iter().flatten() {
                let rate = rates.entry([number, storage]).or_insert_with(|| DetectionRate {
                    scene: shows,
                    counts: Storage::ALL[storage].name(),
                    ..DetectionRate::default()
                });
                rate.recordings += 1;
                rate.schedule_percent += f64::from(u8::from(schedule));
                rate.timing_percent += f64::from(u8::from(timing));
                rate.wrong += usize::from(wrong);
            }
        }
    }
    let mut rates: Vec<DetectionRate> = rates.into_values().collect();
    for rate in &mut rates {
        let all = rate.recordings as f64;
        rate.schedule_percent *= 100.0 / all;
        rate.timing_percent *= 100.0 / all;
    }
    Ok(rates)
}

/// Whether the schedule and the timing of a recording that describes itself rightly are found, and whether something wrong
/// is.
fn look(capture: &Capture) -> [bool; 3] {
    let mut detector = Detector::new(&capture.recording());
    let len = capture.height * capture.width;
    (0..capture.frames).for_each(|t| detector.add(&capture.counts.range(t * len..(t + 1) * len)));
    let found = detector.detect();
    let schedule = found.schedule.as_ref().map(|schedule| schedule.as_described && schedule.gaps.is_empty());
    let timing = found.timing.map(|timing| timing == capture.info.timing);
    let wrong = [schedule, timing].contains(&Some(false));
    [schedule == Some(true), timing == Some(true), wrong]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is found is right, in each of some thousand recordings, and in most of those that show it, it is found.
    #[test]
    fn what_is_detected_is_right() {
        let rates = detection().unwrap();
        let mut recordings = 0;
        for rate in &rates {
            eprintln!("{rate:?}");
            assert_eq!(rate.wrong, 0, "{rate:?}");
            let shown = if rate.scene == "still, no noise" { 0.0 } else { 100.0 };
            assert_eq!(rate.schedule_percent, shown, "{rate:?}");
            recordings += rate.recordings;
        }
        assert!(recordings >= 512, "{recordings}");
    }
}

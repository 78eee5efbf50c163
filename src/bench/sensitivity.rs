//! How a result changes with what is wrong about a capture.

use serde::Serialize;

use crate::Result;
use crate::network::Model;
use crate::quality::compare;
use crate::sensor::{Capture, Form, Pattern, Sampler, Timing};
use crate::synth::{Backend, Settings, Synthesizer};
use crate::video::Counts;
use crate::video::Video;

/// Count that stands for a missing read-out: above what 10 bits can hold.
const MISSING: u16 = 65535;
/// Every so many pixels one is dead: 0.5%.
const DEAD_EVERY: usize = 200;
/// Every so many read-outs one is missing: 1%.
const MISSING_EVERY: u64 = 100;
/// Every so many frames one is dropped.
const DROPPED_EVERY: usize = 16;

/// What a disturbance costs.
#[derive(Clone, Debug, Serialize)]
pub struct Sensitivity {
    /// What is wrong.
    pub disturbance: String,
    /// PSNR-µ against the truth in dB.
    pub psnr_mu_db: f64,
    /// The same without the disturbance.
    pub undisturbed_db: f64,
}

/// Something that is wrong about a capture, and the capture.
type Disturbed = (&'static str, Capture);

/// Synthesises captures of `truth`, each with something wrong.
pub fn sensitivity(
    model: &Model,
    pattern: &Pattern,
    truth: &Video,
    backend: &Backend,
) -> Result<Vec<Sensitivity>> {
    let sampler = Sampler::new(pattern.clone(), Form::Linear)?;
    let sampled = |change: &dyn Fn(&mut Sampler)| -> Result<Capture> {
        let mut sampler = sampler.clone();
        change(&mut sampler);
        sampler.sample(truth)
    };
    let sound = sampled(&|_| {})?;
    let mut disturbed = vec![
        ("black level 1% of the range too low", sampled(&|sampler| sampler.black_error = 0.01)?),
        ("black level 1% of the range too high", sampled(&|sampler| sampler.black_error = -0.01)?),
        ("gain 5% too low", sampled(&|sampler| sampler.gain_error = 0.05)?),
        ("gain 5% too high", sampled(&|sampler| sampler.gain_error = -0.05)?),
        ("8 bits in place of 10", sampled(&|sampler| sampler.bit_depth = 8)?),
    ];
    disturbed.extend(with_dead_pixels(&sound));
    disturbed.extend(with_missing_readouts(&sound));
    disturbed.extend(with_dropped_frames(&sound));

    let extent = [sound.height, sound.width];
    let mut synthesizer =
        Synthesizer::new(model, sound.calibration(), extent, backend, &Settings::default())?;
    let mut psnr =
        |capture: &Capture| -> Result<f64> { Ok(compare(truth, &synthesizer.video(capture)?.0)?.psnr_mu) };
    let mut rows = Vec::new();
    let mut add = |sound: &Capture, disturbed: Vec<Disturbed>| -> Result<()> {
        let undisturbed_db = psnr(sound)?;
        for (name, capture) in disturbed {
            let psnr_mu_db = psnr(&capture)?;
            rows.push(Sensitivity { disturbance: name.to_owned(), psnr_mu_db, undisturbed_db });
        }
        Ok(())
    };
    add(&sound, disturbed)?;
    // A net needs no phase where frames hold the exposures that cover them, as long as exposures do not change.
    for (timing, [early, late]) in [
        (Timing::Covering, ["phase 1 frame early, covering", "phase 1 frame late, covering"]),
        (Timing::Hold, ["phase 1 frame early, sample and hold", "phase 1 frame late, sample and hold"]),
    ] {
        let sound = sampled(&|sampler| sampler.timing = timing)?;
        let shifted = |frames: i64| {
            let mut capture = sound.clone();
            capture.info.schedule_start += frames;
            capture
        };
        add(&sound, vec![(early, shifted(-1)), (late, shifted(1))])?;
    }
    Ok(rows)
}

/// Dead and hot pixels, known and not.
fn with_dead_pixels(sound: &Capture) -> Vec<Disturbed> {
    let len = sound.height * sound.width;
    // A prime step spreads the pixels over all cells of the pattern.
    let dead: Vec<usize> = (0..len / DEAD_EVERY).map(|i| (i * 7919 + 31) % len).collect();
    let disturbed = |(name, value, known): (&'static str, u16, bool)| {
        let mut capture = sound.clone();
        capture.counts = replaced(sound, |_, pixel| dead.contains(&pixel).then_some(value));
        if known {
            capture.info.dead_pixels = dead.iter().map(|&i| [i / sound.width, i % sound.width]).collect();
        }
        (name, capture)
    };
    let cases = [
        ("0.5% dead pixels, not known", 0, false),
        ("0.5% dead pixels, filled", 0, true),
        ("0.5% hot pixels, not known", 1023, false),
        ("0.5% hot pixels, filled", 1023, true),
    ];
    cases.map(disturbed).into()
}

/// Read-outs that are missing here and there, marked and not.
fn with_missing_readouts(sound: &Capture) -> Vec<Disturbed> {
    let is_missing = |t: usize, pixel: usize| {
        let schedule = sound.pattern.schedule(pixel / sound.width, pixel % sound.width);
        let end = schedule.covering(sound.info.schedule_start + t as i64).end();
        // One draw a read-out (the mixer of SplitMix64).
        let mut draw = (end as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (pixel as u64) << 32;
        for factor in [0xbf58_476d_1ce4_e5b9, 0x94d0_49bb_1331_11eb] {
            draw = (draw ^ draw >> 30).wrapping_mul(factor);
        }
        (draw ^ draw >> 31).is_multiple_of(MISSING_EVERY)
    };
    let disturbed = |(name, value, marker): (&'static str, u16, Option<u16>)| {
        let mut capture = sound.clone();
        capture.counts = replaced(sound, |t, pixel| is_missing(t, pixel).then_some(value));
        capture.info.missing_count = marker;
        (name, capture)
    };
    let cases = [
        ("1% of read-outs missing, as 0", 0, None),
        ("1% of read-outs missing, filled", MISSING, Some(MISSING)),
    ];
    cases.map(disturbed).into()
}

/// Frames that are missing now and then, noticed and not.
fn with_dropped_frames(sound: &Capture) -> Vec<Disturbed> {
    let len = sound.height * sound.width;
    let is_dropped = |t: usize| t % DROPPED_EVERY == DROPPED_EVERY / 2;
    // Those behind a frame that is dropped come too early, and the last one fills up the end.
    let kept: Vec<usize> = (0..sound.frames).filter(|&t| !is_dropped(t)).collect();
    let mut early = sound.clone();
    early.counts = sound
        .counts
        .gather((0..sound.counts.len()).map(|i| kept[(i / len).min(kept.len() - 1)] * len + i % len));
    let mut marked = sound.clone();
    marked.counts = replaced(sound, |t, _| is_dropped(t).then_some(MISSING));
    marked.info.missing_count = Some(MISSING);
    vec![("every 16th frame dropped, not known", early), ("every 16th frame dropped, filled", marked)]
}

/// Counts of which some are replaced; `value` gets frame and pixel.
fn replaced(capture: &Capture, value: impl Fn(usize, usize) -> Option<u16>) -> Counts {
    let Counts::U16(counts) = &capture.counts else { unreachable!("the simulator writes 16 bits") };
    let len = capture.height * capture.width;
    Counts::U16(counts.iter().enumerate().map(|(i, &c)| value(i / len, i % len).unwrap_or(c)).collect())
}

//! Very long recordings.

use serde::Serialize;

use super::{CheckFailed, machine};
use crate::Result;
use crate::job::{Each, Job};
use crate::network::Model;
use crate::sensor::{Form, Noise, Pattern, Sampler};
use crate::synth::{Backend, ResultFrame, Settings, Skip};
use crate::video::Video;

/// What came out of a long recording of a constant scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Soak {
    /// Frames.
    pub frames: usize,
    /// `off`, `exact` or `bounded`.
    pub skip: &'static str,
    /// Frames, away from both ends, that are not to the bit the one a period before.
    pub differing: usize,
    /// Resident memory of the process after a tenth of the frames, in bytes.
    pub early_memory_bytes: Option<u64>,
    /// The largest from there to the end.
    pub late_memory_bytes: Option<u64>,
    /// Seconds.
    pub seconds: f64,
}

/// Streams `frames` frames of a constant scene of 16×16 pixels through `model`.
pub fn soak(model: &Model, pattern: Pattern, backend: &Backend, frames: usize, skip: Skip) -> Result<Soak> {
    const SIDE: usize = 16;
    let len = pattern.period();
    let mut sampler = Sampler::new(pattern, Form::Linear)?;
    sampler.noise = Noise::NONE;
    let frame: Vec<f32> =
        (0..SIDE * SIDE).map(|i| 0.02 + 0.9 * ((i * 37 % 101) as f32 / 100.0).powi(3)).collect();
    let capture = sampler.sample(&Video::new(len, SIDE, SIDE, frame.repeat(len))?)?;
    let settings = Settings { skip, ..Settings::default() };
    let job = Job::with(capture.repeated(frames), settings, model.clone(), backend.clone())?;
    // What stands in for frames beyond the ends is the scene at the same phase, so even there nothing differs; but it
    // may be computed in windows of other lengths.
    let inside = model.graph.window.frames..frames.saturating_sub(model.graph.window.frames);
    let mut before: Vec<Vec<f32>> = vec![Vec::new(); len];
    let (mut differing, mut early, mut early_is_known) = (0, None, false);
    let sink = Each(|result: &ResultFrame| {
        let (number, values) = (result.number, result.frame.values().to_vec());
        let last = &mut before[number % len];
        if let Some(at) = values.iter().position(|p| !p.is_finite()) {
            let problem = format!("frame {number}: value {at} is not finite");
            return Err(CheckFailed(problem).into());
        }
        if inside.contains(&number) && !last.is_empty() && *last != values {
            differing += 1;
        }
        *last = values;
        if !early_is_known && number >= frames / 10 {
            early_is_known = true;
            if machine::reset_peak_memory() {
                early = machine::peak_memory();
            }
        }
        Ok(())
    });
    let report = job.run(sink, |_| ())?.report;
    Ok(Soak {
        frames,
        skip: skip.name(),
        differing,
        early_memory_bytes: early,
        late_memory_bytes: early.and_then(|_| machine::peak_memory()),
        seconds: report.wall.as_secs_f64(),
    })
}

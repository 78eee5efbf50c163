//! What the dials offer.

use pix2hdr::network::{Precision, presets};
use pix2hdr::sensor::Pattern;
use pix2hdr::synth::{self, Skip};

/// Errors that bounded skipping may be allowed, in l.
pub const ALLOWED_ERRORS: [f64; 2] = [0.0005, 0.05];

/// All executors.
pub const EXECUTORS: [synth::ExecutorChoice; 3] =
    [synth::ExecutorChoice::Auto, synth::ExecutorChoice::Gpu, synth::ExecutorChoice::Cpu];

/// All precisions.
pub const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::F16];

/// All modes of skipping, with the allowed error of `skip` if it has one.
pub fn skips(skip: Skip) -> [Skip; 3] {
    let allowed = match skip {
        Skip::Bounded(error) => error,
        _ => Skip::ALLOWED_ERROR,
    };
    [Skip::Off, Skip::Exact, Skip::Bounded(allowed)]
}

/// The nets that the dial offers: presets that have weights for `pattern`, and those that the viewer was started with.
pub fn nets(pattern: Option<&Pattern>, given: &str) -> Vec<String> {
    let fits = |preset: &presets::Preset| {
        let made_for = preset.graph().map_or_else(|_| String::new(), |graph| graph.pattern);
        let fits = |pattern| Pattern::built_in(&made_for).is_ok_and(|made| made.samples_like(pattern));
        preset.trained && pattern.is_none_or(|pattern| made_for == "any" || fits(pattern))
    };
    let mut nets: Vec<String> =
        presets::all().iter().filter(|p| fits(p)).map(|p| p.name.to_owned()).collect();
    if !nets.iter().any(|net| net == given) {
        nets.push(given.to_owned());
    }
    nets
}

/// The one behind `value`; behind the last one comes the first.
pub(crate) fn next<T: Copy + PartialEq>(all: &[T], value: T) -> T {
    let at = all.iter().position(|other| *other == value).map_or(0, |at| at + 1);
    all[at % all.len()]
}

//! `features`: the channels that a net sees of each pixel, with blocks of pixels folded into channels.

use super::camera::{Tone, inverse_response};
use super::{Real, TensorView, TensorViewMut};
use crate::network::{Block, Feature, SATURATED};
use crate::sensor::Calibration;

/// Fills all channels of all blocks.
pub fn run<R: Real>(
    channels: &[Feature],
    block: Block,
    measurement: TensorView<'_, R>,
    estimate: TensorView<'_, R>,
    output: TensorViewMut<'_, R>,
    calibration: &Calibration,
    schedule: i64,
) {
    let tone = Tone::new();
    let saturated = R::from_f64(SATURATED);
    fold(channels, block, output, |channel, t, y, x| {
        let measured = measurement.pixel(t, y, x)[0];
        let exposure = || R::from_f32(calibration.exposure(schedule + t as i64, y, x));
        match channel {
            Feature::Measurement => measured,
            Feature::LogIrradiance => tone.of(inverse_response(calibration, measured) / exposure()),
            Feature::LogEstimate => tone.of(estimate.pixel(t, y, x)[0]),
            Feature::Saturated if measured < saturated => R::ZERO,
            Feature::Saturated => R::ONE,
            Feature::LogExposure => exposure().log2(),
        }
    });
}

/// Out channel ((dt·by + dy)·bx + dx)·n + i is channel i of pixel (dt, dy, dx) of a block; `value` gives it for a
/// channel and t, y, x.
pub(super) fn fold<R: Real>(
    channels: &[Feature],
    [bt, by, bx]: Block,
    output: TensorViewMut<'_, R>,
    value: impl Fn(Feature, usize, usize, usize) -> R + Sync,
) {
    output.for_each_pixel(|t, y, x, result| {
        for (in_block, result) in result.chunks_exact_mut(channels.len()).enumerate() {
            let (dt, dy, dx) = (in_block / (by * bx), in_block / bx % by, in_block % bx);
            for (&channel, result) in channels.iter().zip(result) {
                *result = value(channel, t * bt + dt, y * by + dy, x * bx + dx);
            }
        }
    });
}

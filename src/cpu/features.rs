//! `features`: the channels that a net sees of each pixel, with blocks of pixels folded into channels.

use super::camera::{Camera, Tone};
use super::view::positions;
use super::{Real, ScratchPool, TensorView, TensorViewMut};
use crate::network::{Block, Feature, SATURATED};

/// Fills all channels of all blocks, from the measurement and the estimate.
pub fn run<R: Real>(
    channels: &[Feature],
    block: Block,
    [measurement, estimate]: [TensorView<'_, R>; 2],
    output: TensorViewMut<'_, R>,
    camera: Camera<'_>,
    scratch: &ScratchPool<R>,
) {
    let tone = Tone::new();
    let saturated = R::from_f64(SATURATED);
    fold(channels, block, output, scratch, |channel, t, y, line| {
        let measured = measurement.line(t, y);
        match channel {
            Feature::Measurement => line.copy_from_slice(measured),
            Feature::LogIrradiance => {
                camera.irradiance(t, y, measured, line);
                tone.of_all(line);
            }
            Feature::LogEstimate => {
                line.copy_from_slice(estimate.line(t, y));
                tone.of_all(line);
            }
            Feature::Saturated => {
                for (value, &measured) in line.iter_mut().zip(measured) {
                    *value = if measured < saturated { R::ZERO } else { R::ONE };
                }
            }
            Feature::LogExposure => {
                for (value, exposure) in line.iter_mut().zip(camera.exposures(t, y)) {
                    *value = R::from_f32(exposure).log2();
                }
            }
        }
    });
}

/// Out channel ((dt·by + dy)·bx + dx)·n + i is channel i of pixel (dt, dy, dx) of a block. `values` writes a
/// channel along row y of frame t.
pub(super) fn fold<R: Real>(
    channels: &[Feature],
    [bt, by, bx]: Block,
    output: TensorViewMut<'_, R>,
    scratch: &ScratchPool<R>,
    values: impl Fn(Feature, usize, usize, &mut [R]) + Sync,
) {
    let n = channels.len();
    let width = output.shape.x * bx;
    output.for_each_rows(2, |mut rows| {
        scratch.with(|scratch| {
            let line = &mut scratch.gathered;
            line.resize(width, R::ZERO);
            for [row, dt, dy] in positions([rows.len(), bt, by]) {
                for (i, &channel) in channels.iter().enumerate() {
                    values(channel, rows.t * bt + dt, (rows.y + row) * by + dy, &mut line[..width]);
                    let first = (dt * by + dy) * bx * n + i;
                    for (result, values) in rows.row(row).zip(line.chunks_exact(bx)) {
                        for (result, &value) in result[first..].iter_mut().step_by(n).zip(values) {
                            *result = value;
                        }
                    }
                }
            }
        });
    });
}

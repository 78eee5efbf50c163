//! `features`: the channels that a net sees of each pixel, with blocks of pixels folded into channels.

use super::Real;
use super::calibration::{CalibrationTables, Tone};
use super::view::positions;
use super::view::{ScratchPool, TensorView, TensorViewMut};
use crate::network::{Channel, Feature, Fold, SATURATED};

/// What is computed.
#[derive(Clone, Copy, Debug)]
pub struct Features<'a> {
    /// Channels per pixel.
    pub channels: &'a [Channel],
    /// Block that is folded.
    pub block: Fold,
    /// Frames of the log irradiance before the first block.
    pub lead: usize,
}

impl Features<'_> {
    /// Fills all channels of all blocks, from the measurement, the estimate and the log irradiance.
    pub fn run<R: Real>(
        &self,
        [measurement, estimate]: [TensorView<'_, R>; 2],
        log_irradiance: Option<TensorView<'_, R>>,
        output: TensorViewMut<'_, R>,
        tables: CalibrationTables<'_>,
        scratch: &ScratchPool<R>,
    ) {
        let tone = Tone::new();
        let saturated = R::from_f64(SATURATED);
        fold(self.channels, self.block, output, scratch, |Channel { feature, offset }, t, y, line| {
            let measured = measurement.line(t, y);
            match feature {
                Feature::Measurement => line.copy_from_slice(measured),
                Feature::LogIrradiance => match log_irradiance {
                    Some(logs) => match frame(logs.shape.t, self.lead + t, offset) {
                        Some(frame) => line.copy_from_slice(logs.line(frame, y)),
                        None => line.fill(R::ZERO),
                    },
                    None => tables.log_irradiance(t, y, measured, line),
                },
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
                    for (value, exposure) in line.iter_mut().zip(tables.exposures(t, y)) {
                        *value = R::from_f32(exposure).log2();
                    }
                }
            }
        });
    }
}

/// The frame that lies `offset` behind frame t, if it is one of `frames`.
pub(super) fn frame(frames: usize, t: usize, offset: i32) -> Option<usize> {
    t.checked_add_signed(offset as isize).filter(|&frame| frame < frames)
}

/// Out channel ((dt·by + dy)·bx + dx)·n + i is channel i of pixel (dt, dy, dx) of a block. `values` writes a
/// channel along row y of frame t.
pub(super) fn fold<R: Real>(
    channels: &[Channel],
    [bt, by, bx]: Fold,
    output: TensorViewMut<'_, R>,
    scratch: &ScratchPool<R>,
    values: impl Fn(Channel, usize, usize, &mut [R]) + Sync,
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

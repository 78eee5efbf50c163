//! `features`: the channels that a net sees of each pixel, with blocks of pixels folded into channels.

use std::f64::consts::LN_2;

use super::calibration::Tone;
use super::real::Real;
use super::rounding::{log_error, log_irradiance_error, tone_error};
use super::twin::{Operands, Twin};
use super::view::{ScratchPool, TensorViewMut, positions};
use crate::network::{Channel, Feature, FeaturesStep, Fold, SATURATED, Tensor};

impl Twin for FeaturesStep {
    /// Fills all channels of all blocks, from the measurement, the estimate and, if given, the log irradiance.
    fn run<R: Real>(&self, operands: &Operands<'_, R>, output: TensorViewMut<'_, R>) {
        let Operands { inputs: [_, _, log_irradiance], tables, scratch, .. } = *operands;
        let (measurement, estimate) = (operands.input(0), operands.input(1));
        let tone = Tone::new();
        let saturated = R::from_f64(SATURATED);
        fold(&self.channels, self.block, output, scratch, |Channel { feature, offset }, t, y, line| {
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

    fn bound(&self, operands: &Operands<'_, f64>, output: &Tensor<f64>, _weights: f64) -> Tensor<f64> {
        let Operands { inputs: [_, _, log_irradiance], tables, scratch, .. } = *operands;
        let (measurement, estimate) = (operands.input(0), operands.input(1));
        let mut error = Tensor::filled(output.shape, 0.0);
        let errors = |channel: Channel, t: usize, y: usize, line: &mut [f64]| {
            let values = measurement.line(t, y).iter().zip(tables.exposures(t, y));
            for (x, (error, (&measured, exposure))) in line.iter_mut().zip(values).enumerate() {
                *error = match channel.feature {
                    Feature::Measurement | Feature::Saturated => 0.0,
                    Feature::LogIrradiance if log_irradiance.is_some() => 0.0,
                    Feature::LogIrradiance => log_irradiance_error(tables.calibration, measured, exposure),
                    Feature::LogEstimate => tone_error(estimate.line(t, y)[x], 0.0),
                    Feature::LogExposure => log_error(exposure as f64) / LN_2,
                };
            }
        };
        fold(&self.channels, self.block, TensorViewMut::dense(&mut error), scratch, errors);
        error
    }
}

/// The frame that lies `offset` behind frame t, if it is one of `frames`.
pub(super) fn frame(frames: usize, t: usize, offset: i32) -> Option<usize> {
    t.checked_add_signed(offset as isize).filter(|&frame| frame < frames)
}

/// Out channel ((dt·by + dy)·bx + dx)·n + i is channel i of pixel (dt, dy, dx) of a block. `values` writes a
/// channel along row y of frame t.
fn fold<R: Real>(
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

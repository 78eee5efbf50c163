//! A camera's calibration and the tone curve, as kernels use them.
// Code gets the instructions of the function that it is inlined into.
#![allow(clippy::inline_always)]

use super::Real;
use super::simd::{Simd, SimdToken, Task};
use crate::network::MU;
use crate::sensor::Calibration;

/// The tables of a calibration, at the time of a tensor.
#[derive(Clone, Copy, Debug)]
pub struct CalibrationTables<'a> {
    /// The tables.
    pub calibration: &'a Calibration,
    /// Schedule time of the tensor's first frame.
    pub schedule: i64,
}

impl CalibrationTables<'_> {
    /// Exposures along row y of frame t, for ever.
    pub fn exposures(&self, t: usize, y: usize) -> impl Iterator<Item = f32> {
        self.calibration.row(self.schedule.wrapping_add(t as i64), y).iter().copied().cycle()
    }

    /// Irradiance R⁻¹(y)/e along row y of frame t, of what was `measured` there.
    pub fn irradiance<R: Real>(&self, t: usize, y: usize, measured: &[R], irradiance: &mut [R]) {
        let period = self.calibration.row(self.schedule.wrapping_add(t as i64), y);
        // Several periods in a row, so that loops over them are long enough for vectors.
        let mut repeated = [1.0; 64];
        for (repeated, &exposure) in repeated.iter_mut().zip(period.iter().cycle()) {
            *repeated = exposure;
        }
        let whole = repeated.len() / period.len() * period.len();
        let exposures = if whole > 0 { &repeated[..whole] } else { period };
        let table = &self.calibration.inverse_response;
        Simd::widest().run(Irradiance { table, exposures, measured, results: irradiance });
    }

    /// l of the irradiance.
    pub fn log_irradiance<R: Real>(&self, t: usize, y: usize, measured: &[R], line: &mut [R]) {
        self.irradiance(t, y, measured, line);
        Tone::new().of_all(line);
    }
}

/// Turns what was measured into irradiance; exposures repeat.
struct Irradiance<'a, R> {
    table: &'a [f32],
    exposures: &'a [f32],
    measured: &'a [R],
    results: &'a mut [R],
}

impl<R: Real> Task for Irradiance<'_, R> {
    #[inline(always)]
    fn run<T: SimdToken>(self, _: T) {
        let n = self.exposures.len();
        for (results, measured) in self.results.chunks_mut(n).zip(self.measured.chunks(n)) {
            for ((result, &measured), &exposure) in results.iter_mut().zip(measured).zip(self.exposures) {
                *result = inverse_response(self.table, measured) / R::from_f32(exposure);
            }
        }
    }
}

/// R⁻¹(y) in p·frames: linear between the table's nodes; the first node below 0, the last one from 1 on.
#[inline(always)]
pub fn inverse_response<R: Real>(table: &[f32], y: R) -> R {
    let intervals = table.len() - 1;
    let position = y.at_least(R::ZERO).at_most(R::ONE) * R::from_f64(intervals as f64);
    let index = position.to_index().min(intervals - 1);
    let (below, above) = (R::from_f32(table[index]), R::from_f32(table[index + 1]));
    below + (position - R::from_f64(index as f64)) * (above - below)
}

/// The tone curve l(p) = ln(1 + µp)/ln(1 + µ) and its inverse.
#[derive(Clone, Copy, Debug)]
pub struct Tone<R> {
    mu: R,
    mu_recip: R,
    ln_1p_mu: R,
    ln_1p_mu_recip: R,
}

impl<R: Real> Tone<R> {
    /// The curve for µ = 5000.
    pub fn new() -> Self {
        Self {
            mu: R::from_f64(MU),
            mu_recip: R::from_f64(MU.recip()),
            ln_1p_mu: R::from_f64(MU.ln_1p()),
            ln_1p_mu_recip: R::from_f64(MU.ln_1p().recip()),
        }
    }

    /// l(p).
    #[inline(always)]
    pub fn of(&self, p: R) -> R {
        (self.mu * p).ln_1p() * self.ln_1p_mu_recip
    }

    /// l⁻¹(v).
    #[inline(always)]
    pub fn inverse(&self, v: R) -> R {
        (v * self.ln_1p_mu).exp_m1() * self.mu_recip
    }

    /// l of all values.
    pub fn of_all(&self, values: &mut [R]) {
        Simd::widest().run(OfAll(*self, values));
    }

    /// l⁻¹ of all values, clamped to [0, 1].
    pub fn inverse_of_all(&self, values: &mut [R]) {
        Simd::widest().run(InverseOfAll(*self, values));
    }
}

struct InverseOfAll<'a, R>(Tone<R>, &'a mut [R]);

impl<R: Real> Task for InverseOfAll<'_, R> {
    #[inline(always)]
    fn run<T: SimdToken>(self, _: T) {
        let Self(tone, values) = self;
        for value in values {
            *value = tone.inverse(value.at_least(R::ZERO).at_most(R::ONE));
        }
    }
}

struct OfAll<'a, R>(Tone<R>, &'a mut [R]);

impl<R: Real> Task for OfAll<'_, R> {
    #[inline(always)]
    fn run<T: SimdToken>(self, _: T) {
        let Self(tone, values) = self;
        for value in values {
            *value = tone.of(*value);
        }
    }
}

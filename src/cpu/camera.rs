//! The camera's tables and the tone curve, as kernels use them.

use super::Real;
use crate::network::MU;
use crate::sensor::Calibration;

/// The camera at the time of a tensor.
#[derive(Clone, Copy, Debug)]
pub struct Camera<'a> {
    /// Its tables.
    pub calibration: &'a Calibration,
    /// Schedule time of the tensor's first frame.
    pub schedule: i64,
}

impl Camera<'_> {
    /// Exposures along row y of frame t, for ever.
    pub fn exposures(&self, t: usize, y: usize) -> impl Iterator<Item = f32> {
        self.calibration.row(self.schedule.wrapping_add(t as i64), y).iter().copied().cycle()
    }

    /// Irradiance R⁻¹(y)/e along row y of frame t, of what was `measured` there.
    pub fn irradiance<R: Real>(&self, t: usize, y: usize, measured: &[R], irradiance: &mut [R]) {
        let values = irradiance.iter_mut().zip(measured).zip(self.exposures(t, y));
        for ((irradiance, &measured), exposure) in values {
            *irradiance = inverse_response(self.calibration, measured) / R::from_f32(exposure);
        }
    }

    /// l of the irradiance.
    pub fn log_irradiance<R: Real>(&self, t: usize, y: usize, measured: &[R], line: &mut [R]) {
        self.irradiance(t, y, measured, line);
        let tone = Tone::new();
        for value in line {
            *value = tone.of(*value);
        }
    }
}

/// R⁻¹(y) in p·frames: linear between the table's nodes; the first node below 0, the last one from 1 on.
pub fn inverse_response<R: Real>(calibration: &Calibration, y: R) -> R {
    let table = &calibration.inverse_response;
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
    pub fn of(&self, p: R) -> R {
        (self.mu * p).ln_1p() * self.ln_1p_mu_recip
    }

    /// l⁻¹(v).
    pub fn inverse(&self, v: R) -> R {
        (v * self.ln_1p_mu).exp_m1() * self.mu_recip
    }
}

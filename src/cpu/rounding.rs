//! Roundings of the arithmetic that executors may use, and how far they carry (design §7).
//!
//! It is f32, as accurate as WGSL promises: exp to 3 + 2|x| ULP, log to 2⁻²¹ on [0.5, 2] and to 3 ULP elsewhere, division
//! to 2.5 ULP, sums in any order, fused or not.

use super::calibration::inverse_response;
use crate::network::MU;
use crate::sensor::Calibration;

/// Unit round-off of tensors that are stored as f32.
pub const F32: f64 = 1.0 / (1u32 << 24) as f64;

/// Unit round-off of tensors that are stored as f16.
pub const F16: f64 = 1.0 / (1u32 << 11) as f64;

/// Unit round-off of the arithmetic.
pub const U: f64 = F32;
/// One ULP of a number in f32 is at most this part of it.
pub const ULP: f64 = 2.0 * U;
/// Error of a quotient, as a part of it: 2.5 ULP, and one rounding of a constant.
pub const QUOTIENT: f64 = 2.5 * ULP + U;
/// Error of log close to 1.
pub const LOG_NEAR_ONE: f64 = 8.0 * U;

/// Error of R⁻¹(y)/e: the position in the table is off by a rounding, which its slope turns into an error.
pub fn irradiance_error(calibration: &Calibration, y: f64, exposure: f32) -> f64 {
    let table = &calibration.inverse_response;
    let intervals = table.len() - 1;
    let position = y.clamp(0.0, 1.0) * intervals as f64;
    let index = (position as usize).min(intervals - 1);
    // A rounded position can lie in the next interval.
    let near = &table[index.saturating_sub(1)..table.len().min(index + 3)];
    let slope = near.windows(2).map(|pair| (pair[1] - pair[0]).abs() as f64).fold(0.0, f64::max);
    let value = near.iter().map(|v| v.abs() as f64).fold(0.0, f64::max);
    (U * position * slope + 3.0 * U * value + QUOTIENT * value) / exposure as f64
}

/// Error of l(R⁻¹(y)/e).
pub fn log_irradiance_error(calibration: &Calibration, y: f64, exposure: f32) -> f64 {
    let irradiance = inverse_response(&calibration.inverse_response, y) / exposure as f64;
    tone_error(irradiance, irradiance_error(calibration, y, exposure))
}

/// Error of ln x by itself.
pub fn log_error(x: f64) -> f64 {
    if (0.49..2.01).contains(&x) { LOG_NEAR_ONE } else { 3.0 * ULP * x.ln().abs() }
}

/// Error of l(p) = ln(1 + µp)/ln(1 + µ) where p is off by `error`.
pub fn tone_error(p: f64, error: f64) -> f64 {
    let sum = 1.0 + MU * p;
    let log = (MU * error + U * (MU * p + sum)) / sum + log_error(sum);
    (log + QUOTIENT * sum.ln()) / MU.ln_1p()
}

/// Error of p = l⁻¹(v) = (exp(v ln(1 + µ)) − 1)/µ where v is off by `error`.
pub fn inverse_tone_error(p: f64, error: f64) -> f64 {
    let power = 1.0 + MU * p;
    let exponent = power.ln();
    let relative = MU.ln_1p() * error + 2.0 * U * exponent + (3.0 + 2.0 * exponent) * ULP + U;
    power * relative / MU + QUOTIENT * p
}

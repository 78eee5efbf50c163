//! ln(1 + v) and eᵛ − 1 in f32, without branches and calls: loops over them become vector code, which is
//! several times faster than the standard library's, and is accurate to a few ULP.
// Code gets the instructions of the function that it is inlined into.
#![allow(clippy::inline_always)]

use std::f32::consts::{LN_2, LOG2_E};

/// ln(1 + v) for finite v ≥ 0.
#[inline(always)]
pub fn ln_1p(v: f32) -> f32 {
    let sum = 1.0 + v;
    // sum = m · 2ᵉ with m in [√½, √2).
    let bits = sum.to_bits();
    let exponent = (bits.wrapping_sub(std::f32::consts::FRAC_1_SQRT_2.to_bits()) as i32) >> 23;
    let m = f32::from_bits(bits.wrapping_sub((exponent << 23) as u32));
    // Where e = 0, m − 1 is v, less the rounding of 1 + v.
    let f = if exponent == 0 { v } else { m - 1.0 };
    // ln m = 2 artanh s: the first terms of its series, as s² < 0.03.
    let s = f / (2.0 + f);
    let z = s * s;
    let series = z * (1.0 / 3.0 + z * (1.0 / 5.0 + z * (1.0 / 7.0 + z * (1.0 / 9.0))));
    exponent as f32 * LN_2 + (2.0 * s + 2.0 * s * series)
}

/// eᵛ − 1 for |v| ≤ 87.
#[inline(always)]
pub fn exp_m1(v: f32) -> f32 {
    /// Adding and subtracting it rounds to a whole number.
    const ROUND: f32 = 1.5 * (1 << 23) as f32;
    /// ln 2 in two parts; the products of the first one with small whole numbers are exact.
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = (std::f64::consts::LN_2 - LN_2_HIGH as f64) as f32;
    // v = k ln 2 + r.
    let k = (v * LOG2_E + ROUND) - ROUND;
    let r = (v - k * LN_2_HIGH) - k * LN_2_LOW;
    // eʳ − 1: the first terms of its series, as |r| < 0.35.
    let series = 1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0));
    let series = 1.0 / 2.0 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * series));
    let power = f32::from_bits(((k as i32 + 127) << 23) as u32);
    power * (r + r * r * series) + (power - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest error as a part of the value, in units of 2⁻²⁴, over numbers between `begin` and `end`.
    fn error(f: fn(f32) -> f32, exact: fn(f64) -> f64, begin: f32, end: f32) -> f64 {
        let numbers = (begin.to_bits()..end.to_bits()).step_by(997).map(f32::from_bits);
        let error = |v: f32| {
            let exact = exact(v as f64);
            (f(v) as f64 - exact).abs() / exact.abs() * (1 << 24) as f64
        };
        numbers.map(error).fold(0.0, f64::max)
    }

    #[test]
    fn the_functions_are_accurate() {
        let logarithm = error(ln_1p, f64::ln_1p, f32::MIN_POSITIVE, f32::MAX);
        assert!(logarithm <= 4.0, "{logarithm}");
        let power = error(exp_m1, f64::exp_m1, f32::MIN_POSITIVE, 87.0);
        assert!(power <= 4.0, "{power}");
        let negative = error(|v| exp_m1(-v), |v| (-v).exp_m1(), f32::MIN_POSITIVE, 87.0);
        assert!(negative <= 4.0, "{negative}");
        assert_eq!(ln_1p(0.0).to_bits(), 0);
        assert_eq!(exp_m1(0.0).to_bits(), 0);
    }
}

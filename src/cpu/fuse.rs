//! `fuse`: the weighted mean of irradiance (eq. 23).

use super::Real;
use super::view::{TensorView, TensorViewMut};

/// Weights w (n channels) and the result of `inverse_response` (2n channels, the last n are p) → Σ w p / Σ w.
pub fn run<R: Real>(weights: TensorView<'_, R>, rendered: TensorView<'_, R>, output: TensorViewMut<'_, R>) {
    output.for_each_pixel(|t, y, x, result| {
        let weights = weights.pixel(t, y, x);
        let irradiance = &rendered.pixel(t, y, x)[weights.len()..];
        let sum: R = weights.iter().zip(irradiance).map(|(&w, &p)| w * p).sum();
        let weight: R = weights.iter().copied().sum();
        result[0] = sum / weight;
    });
}

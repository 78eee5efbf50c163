//! `fuse`: the weighted mean of irradiance (eq. 23).

use super::real::Real;
use super::rounding::{QUOTIENT, U};
use super::twin::{Operands, Twin};
use super::view::TensorViewMut;
use crate::network::{Fuse, Tensor};

/// Weights w (n channels) and the result of `inverse_response` (2n channels, the last n are p) → Σ w p / Σ w.
impl Twin for Fuse {
    fn run<R: Real>(&self, operands: &Operands<'_, R>, output: TensorViewMut<'_, R>) {
        let (weights, rendered) = (operands.input(0), operands.input(1));
        output.for_each_pixel(|t, y, x, result| {
            let weights = weights.pixel(t, y, x);
            let irradiance = &rendered.pixel(t, y, x)[weights.len()..];
            let sum: R = weights.iter().zip(irradiance).map(|(&w, &p)| w * p).sum();
            let weight: R = weights.iter().copied().sum();
            result[0] = sum / weight;
        });
    }

    fn bound(&self, operands: &Operands<'_, f64>, output: &Tensor<f64>, _weights: f64) -> Tensor<f64> {
        let (weights, rendered) = (operands.input(0), operands.input(1));
        let mut error = Tensor::filled(output.shape, 0.0);
        for ((error, weights), (rendered, result)) in
            error.data.iter_mut().zip(weights.pixels()).zip(rendered.pixels().zip(&output.data))
        {
            let n = weights.len();
            let products: f64 = weights.iter().zip(&rendered[n..]).map(|(w, p)| (w * p).abs()).sum();
            let magnitude: f64 = weights.iter().map(|w| w.abs()).sum();
            let weight = weights.iter().sum::<f64>().abs();
            let sums = n as f64 * U * (products + magnitude * result.abs());
            *error = sums / weight + QUOTIENT * result.abs();
        }
        error
    }
}

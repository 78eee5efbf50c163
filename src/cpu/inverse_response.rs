//! `inverse_response`: rendered pixel values, and the irradiance that they stand for (eq. 22).

use super::calibration::inverse_response;
use super::real::Real;
use super::rounding::irradiance_error;
use super::twin::{Operands, Twin};
use super::view::TensorViewMut;
use crate::network::{InverseResponse, Tensor};

/// n channels of pixel values → the same n channels, then R⁻¹(y_i)/e_i.
impl Twin for InverseResponse {
    fn run<R: Real>(&self, operands: &Operands<'_, R>, output: TensorViewMut<'_, R>) {
        let (input, table) = (operands.input(0), &operands.tables.calibration.inverse_response);
        output.for_each_pixel(|t, y, x, result| {
            let (values, irradiance) = result.split_at_mut(self.exposures.len());
            values.copy_from_slice(input.pixel(t, y, x));
            for ((irradiance, &value), &exposure) in irradiance.iter_mut().zip(&*values).zip(&self.exposures)
            {
                *irradiance = inverse_response(table, value) / R::from_f32(exposure);
            }
        });
    }

    fn bound(&self, operands: &Operands<'_, f64>, output: &Tensor<f64>, _weights: f64) -> Tensor<f64> {
        let (n, calibration) = (self.exposures.len(), operands.tables.calibration);
        let mut error = Tensor::filled(output.shape, 0.0);
        for (errors, values) in error.data.chunks_exact_mut(2 * n).zip(operands.input(0).pixels()) {
            for ((error, &value), &exposure) in errors[n..].iter_mut().zip(values).zip(&self.exposures) {
                *error = irradiance_error(calibration, value, exposure);
            }
        }
        error
    }
}

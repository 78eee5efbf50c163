//! `inverse_response`: rendered pixel values, and the irradiance that they stand for (eq. 22).

use super::view::{TensorView, TensorViewMut};
use super::{Real, calibration};
use crate::sensor::Calibration;

/// n channels of pixel values → the same n channels, then R⁻¹(y_i)/e_i.
pub fn run<R: Real>(
    exposures: &[f32],
    input: TensorView<'_, R>,
    output: TensorViewMut<'_, R>,
    tables: &Calibration,
) {
    output.for_each_pixel(|t, y, x, result| {
        let (values, irradiance) = result.split_at_mut(exposures.len());
        values.copy_from_slice(input.pixel(t, y, x));
        for ((irradiance, &value), &exposure) in irradiance.iter_mut().zip(&*values).zip(exposures) {
            *irradiance =
                calibration::inverse_response(&tables.inverse_response, value) / R::from_f32(exposure);
        }
    });
}

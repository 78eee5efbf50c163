//! `log_irradiance`: l(R⁻¹(y)/e) of every pixel.

use super::real::Real;
use super::rounding::log_irradiance_error;
use super::twin::{Operands, Twin};
use super::view::TensorViewMut;
use crate::network::{LogIrradiance, Tensor};

/// Rows that one task computes.
const ROWS: usize = 16;

impl Twin for LogIrradiance {
    fn run<R: Real>(&self, operands: &Operands<'_, R>, output: TensorViewMut<'_, R>) {
        let (measurement, tables) = (operands.input(0), operands.tables);
        output.for_each_rows(ROWS, |mut rows| {
            for row in 0..rows.len() {
                let (t, y) = (rows.t, rows.y + row);
                tables.log_irradiance(t, y, measurement.line(t, y), rows.line(row));
            }
        });
    }

    fn bound(&self, operands: &Operands<'_, f64>, output: &Tensor<f64>, _weights: f64) -> Tensor<f64> {
        let (measurement, tables) = (operands.input(0), operands.tables);
        let mut error = Tensor::filled(output.shape, 0.0);
        TensorViewMut::dense(&mut error).for_each_rows(ROWS, |mut rows| {
            for row in 0..rows.len() {
                let (t, y) = (rows.t, rows.y + row);
                let values = measurement.line(t, y).iter().zip(tables.exposures(t, y));
                for (error, (&measured, exposure)) in rows.line(row).iter_mut().zip(values) {
                    *error = log_irradiance_error(tables.calibration, measured, exposure);
                }
            }
        });
        error
    }
}

//! `log_irradiance`: l(R⁻¹(y)/e) of every pixel.

use super::Real;
use super::calibration::CalibrationTables;
use super::view::{TensorView, TensorViewMut};

/// Rows that one task computes.
const ROWS: usize = 16;

/// Log irradiance of the measured values.
pub fn run<R: Real>(
    measurement: TensorView<'_, R>,
    output: TensorViewMut<'_, R>,
    tables: CalibrationTables<'_>,
) {
    output.for_each_rows(ROWS, |mut rows| {
        for row in 0..rows.len() {
            let (t, y) = (rows.t, rows.y + row);
            tables.log_irradiance(t, y, measurement.line(t, y), rows.line(row));
        }
    });
}

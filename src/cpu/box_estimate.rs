//! `box_estimate`: the (1 2 1)ᵀ(1 2 1)-weighted mean of irradiance over the 3×3 neighbours.

use super::camera::inverse_response;
use super::{Real, ScratchPool, TensorView, TensorViewMut};
use crate::network::SATURATED;
use crate::sensor::Calibration;

/// Rows that one task computes: the two rows beside them are computed twice.
const ROWS: usize = 16;

/// Irradiance is R⁻¹(y)/e of each measured value y.
pub fn run<R: Real>(
    measurement: TensorView<'_, R>,
    output: TensorViewMut<'_, R>,
    calibration: &Calibration,
    schedule: i64,
    scratch: &ScratchPool<R>,
) {
    box_filter(measurement, output, scratch, |t, y, x| {
        let exposure = R::from_f32(calibration.exposure(schedule + t as i64, y, x));
        inverse_response(calibration, measurement.pixel(t, y, x)[0]) / exposure
    });
}

/// The weighted mean of `value` over the 3×3 neighbours, borders mirrored, saturated pixels left out unless all
/// nine are.
pub(super) fn box_filter<R: Real>(
    measurement: TensorView<'_, R>,
    output: TensorViewMut<'_, R>,
    scratch: &ScratchPool<R>,
    value: impl Fn(usize, usize, usize) -> R + Sync,
) {
    let [_, height, width] = output.shape.extent();
    let saturated = R::from_f64(SATURATED);
    let (two, sixteen) = (R::from_f64(2.0), R::from_f64(16.0));
    let weights = [R::ONE, two, R::ONE];
    output.for_each_rows(ROWS, |mut rows| {
        scratch.with(|scratch| {
            let (t, first) = (rows.t, rows.y);
            // All values of the rows first … last, and of the rows beside them.
            let last = first + rows.len() - 1;
            let top = first.saturating_sub(1);
            let bottom = (last + 1).min(height - 1);
            let values = &mut scratch.gathered;
            values.clear();
            values.extend(
                (top..=bottom).flat_map(|y| (0..width).map(move |x| (y, x))).map(|(y, x)| value(t, y, x)),
            );
            for row in 0..rows.len() {
                for x in 0..width {
                    let (mut sum, mut weight) = (R::ZERO, R::ZERO);
                    let mut sum_all = R::ZERO;
                    for (y, weight_y) in neighbours(first + row, height).into_iter().zip(weights) {
                        let measured = measurement.from(t, y, 0);
                        for (x, weight_x) in neighbours(x, width).into_iter().zip(weights) {
                            let w = weight_y * weight_x;
                            let weighted = w * values[(y - top) * width + x];
                            sum_all += weighted;
                            if measured[x * measurement.stride] < saturated {
                                sum += weighted;
                                weight += w;
                            }
                        }
                    }
                    rows.pixel(row, x)[0] = if weight > R::ZERO { sum / weight } else { sum_all / sixteen };
                }
            }
        });
    });
}

/// i − 1, i and i + 1, mirrored at the borders: −1 → 1 and n → n − 2; a size of 1 repeats.
fn neighbours(i: usize, n: usize) -> [usize; 3] {
    let before = if i > 0 { i - 1 } else { 1.min(n - 1) };
    let behind = if i + 1 < n { i + 1 } else { n.saturating_sub(2) };
    [before, i, behind]
}

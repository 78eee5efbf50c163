//! `box_estimate`: the (1 2 1)ᵀ(1 2 1)-weighted mean of irradiance over the 3×3 neighbours.

use super::real::Real;
use super::rounding::{QUOTIENT, U, irradiance_error};
use super::twin::{Operands, Twin};
use super::view::{ScratchPool, TensorView, TensorViewMut};
use crate::network::{BoxEstimate, SATURATED, Tensor};

/// Rows that one task computes; it reads the two rows beside them too.
const ROWS: usize = 16;

impl Twin for BoxEstimate {
    fn run<R: Real>(&self, operands: &Operands<'_, R>, output: TensorViewMut<'_, R>) {
        let Operands { tables, scratch, .. } = *operands;
        let measurement = operands.input(0);
        box_filter(measurement, output, scratch, |t, y, line| {
            tables.irradiance(t, y, measurement.line(t, y), line);
        });
    }

    fn bound(&self, operands: &Operands<'_, f64>, output: &Tensor<f64>, _weights: f64) -> Tensor<f64> {
        let Operands { tables, scratch, .. } = *operands;
        let measurement = operands.input(0);
        let mut error = Tensor::filled(output.shape, 0.0);
        box_filter(measurement, TensorViewMut::dense(&mut error), scratch, |t, y, line| {
            let values = line.iter_mut().zip(measurement.line(t, y)).zip(tables.exposures(t, y));
            for ((error, &measured), exposure) in values {
                *error = irradiance_error(tables.calibration, measured, exposure);
            }
        });
        // Weights are powers of two: 8 additions of positive numbers and a quotient.
        for (error, mean) in error.data.iter_mut().zip(&output.data) {
            *error += (8.0 * U + QUOTIENT) * mean;
        }
        error
    }
}

/// The weighted mean over the 3×3 neighbours, borders mirrored, saturated pixels left out unless all nine
/// are. `values` writes the values along row y of frame t.
fn box_filter<R: Real>(
    measurement: TensorView<'_, R>,
    output: TensorViewMut<'_, R>,
    scratch: &ScratchPool<R>,
    values: impl Fn(usize, usize, &mut [R]) + Sync,
) {
    let [_, height, width] = output.shape.extent();
    let saturated = R::from_f64(SATURATED);
    let (two, sixteen) = (R::from_f64(2.0), R::from_f64(16.0));
    // A line has the mirrored pixels at its ends. There are three for each row.
    let line = width + 2;
    output.for_each_rows(ROWS, |mut rows| {
        scratch.with(|scratch| {
            let lines = &mut scratch.gathered;
            lines.clear();
            lines.resize((rows.len() + 2) * 3 * line, R::ZERO);
            for (row, lines) in lines.chunks_exact_mut(3 * line).enumerate() {
                // Values that are left out are 0 in the first line and in their weights, the second line.
                let (used, lines) = lines.split_at_mut(line);
                let (weights, all) = lines.split_at_mut(line);
                let y = mirrored((rows.y + row) as isize - 1, height);
                values(rows.t, y, &mut all[1..=width]);
                let used_weights = used[1..].iter_mut().zip(&mut weights[1..]);
                for (((used, weight), &value), &measured) in
                    used_weights.zip(&all[1..]).zip(measurement.line(rows.t, y))
                {
                    *weight = if measured < saturated { R::ONE } else { R::ZERO };
                    *used = if measured < saturated { value } else { R::ZERO };
                }
                for line in [used, weights, all] {
                    line[0] = line[1 + mirrored(-1, width)];
                    line[width + 1] = line[1 + mirrored(width as isize, width)];
                }
            }
            let sums = &mut scratch.sums;
            sums.resize(3 * line, R::ZERO);
            for row in 0..rows.len() {
                let [above, here, below] =
                    [0, 1, 2].map(|i| lines[(row + i) * 3 * line..][..3 * line].iter());
                for (((sum, &above), &here), &below) in sums.iter_mut().zip(above).zip(here).zip(below) {
                    *sum = above + two * here + below;
                }
                let [used, weights, all] = [0, 1, 2].map(|i| &sums[i * line..][..line]);
                for (x, result) in rows.line(row).iter_mut().enumerate() {
                    let sum = |line: &[R]| line[x] + two * line[x + 1] + line[x + 2];
                    let weight = sum(weights);
                    *result = if weight > R::ZERO { sum(used) / weight } else { sum(all) / sixteen };
                }
            }
        });
    });
}

/// Index i of n mirrored at the borders: −1 → 1 and n → n − 2; a size of 1 repeats.
fn mirrored(i: isize, n: usize) -> usize {
    let last = n as isize - 1;
    let inside = if i > last { 2 * last - i } else { i.abs() };
    inside.clamp(0, last) as usize
}

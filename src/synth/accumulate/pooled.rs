//! Means over the pixels around.

use rayon::prelude::*;

use crate::frame::Extent;

/// Pixels before and behind one that its mean covers, along each axis.
const RADIUS: usize = 2;
/// Pixels of a mean.
pub const POOLED: usize = (2 * RADIUS + 1) * (2 * RADIUS + 1);
/// Values of a pixel.
pub const LANES: usize = 9;

/// Values of a pixel that are pooled together.
pub type Lanes = [f32; LANES];

/// The means of `values` [y, x] over 5×5 pixels, into `means`; `rows` are sums along rows. The outermost pixels stand for
/// those beyond the frame.
///
/// Sums are of five values each time, in one order, so a mean does not depend on where the frame begins.
pub fn pool(extent: Extent, values: &[Lanes], rows: &mut [Lanes], means: &mut [Lanes]) {
    let Extent { height, width } = extent;
    let around =
        |at: usize, len: usize| (0..=2 * RADIUS).map(move |i| (at + i).saturating_sub(RADIUS).min(len - 1));
    rows.par_chunks_mut(width).zip(values.par_chunks(width)).for_each(|(sums, values)| {
        for (x, sum) in sums.iter_mut().enumerate() {
            *sum = [0.0; LANES];
            around(x, width).for_each(|x| add(sum, &values[x]));
        }
    });
    let rows = &*rows;
    means.par_chunks_mut(width).enumerate().for_each(|(y, means)| {
        means.fill([0.0; LANES]);
        for row in around(y, height).map(|y| &rows[y * width..][..width]) {
            means.iter_mut().zip(row).for_each(|(mean, sum)| add(mean, sum));
        }
        means.iter_mut().flatten().for_each(|mean| *mean /= POOLED as f32);
    });
}

fn add(sum: &mut Lanes, values: &Lanes) {
    sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
}

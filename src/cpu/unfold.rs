//! `unfold`: channels unfolded into blocks of pixels, as a residual over the estimate in the log domain.
// Code gets the instructions of the function that it is inlined into.
#![allow(clippy::inline_always)]

use super::camera::Tone;
use super::simd::{Simd, Target, Task};
use super::{Real, TensorView, TensorViewMut};
use crate::network::Block;

/// Residual d and estimate of each pixel → l⁻¹(clamp(l(estimate) + d, 0, 1)).
pub fn run<R: Real>(
    block: Block,
    residual: TensorView<'_, R>,
    estimate: TensorView<'_, R>,
    output: TensorViewMut<'_, R>,
) {
    let tone = Tone::new();
    unfold(block, residual, output, |t, y, line| {
        Simd::widest().run(Residual { tone, estimate: estimate.line(t, y), line });
    });
}

/// Turns residuals along a line into results.
struct Residual<'a, R> {
    tone: Tone<R>,
    estimate: &'a [R],
    line: &'a mut [R],
}

impl<R: Real> Task for Residual<'_, R> {
    #[inline(always)]
    fn run<T: Target>(self, _: T) {
        let Self { tone, estimate, line } = self;
        for (result, &estimate) in line.iter_mut().zip(estimate) {
            let value = tone.of(estimate) + *result;
            *result = tone.inverse(value.at_least(R::ZERO).at_most(R::ONE));
        }
    }
}

/// Pixel (dt, dy, dx) of a block is channel (dt·by + dy)·bx + dx. `finish` turns the values along row y of
/// frame t into results.
pub(super) fn unfold<R: Real>(
    [bt, by, bx]: Block,
    blocks: TensorView<'_, R>,
    output: TensorViewMut<'_, R>,
    finish: impl Fn(usize, usize, &mut [R]) + Sync,
) {
    output.for_each_rows(by, |mut rows| {
        for row in 0..rows.len() {
            let (t, y) = (rows.t, rows.y + row);
            let first = (t % bt * by + y % by) * bx;
            let line = rows.line(row);
            for (pixels, channels) in line.chunks_exact_mut(bx).zip(blocks.row(t / bt, y / by)) {
                pixels.copy_from_slice(&channels[first..first + bx]);
            }
            finish(t, y, line);
        }
    });
}

//! `unfold`: channels unfolded into blocks of pixels, as a residual over the estimate in the log domain.

use super::camera::Tone;
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
    output.for_each_pixel(|t, y, x, result| {
        let value = tone.of(estimate.pixel(t, y, x)[0]) + unfolded(block, residual, [t, y, x]);
        result[0] = tone.inverse(value.at_least(R::ZERO).at_most(R::ONE));
    });
}

/// The value of pixel (t, y, x): channel (dt·by + dy)·bx + dx of its block.
pub(super) fn unfolded<R: Real>([bt, by, bx]: Block, blocks: TensorView<'_, R>, [t, y, x]: [usize; 3]) -> R {
    let channel = (t % bt * by + y % by) * bx + x % bx;
    blocks.pixel(t / bt, y / by, x / bx)[channel]
}

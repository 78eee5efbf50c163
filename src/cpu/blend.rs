//! `blend`: predicted kernels. Each pixel has weights for the log irradiances around it, and a residual.

use super::camera::Tone;
use super::features::frame;
use super::{Real, ScratchPool, TensorView, TensorViewMut};
use crate::network::{Block, Tap};

/// What is computed.
#[derive(Clone, Copy, Debug)]
pub struct Blend<'a> {
    /// Block that is unfolded; it spans one frame.
    pub block: Block,
    /// Offsets t, y, x of the pixels that the weights are for.
    pub taps: &'a [Tap],
    /// Frames of the log irradiance before the first result frame.
    pub lead: usize,
}

/// What is read.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a, R> {
    /// For each pixel of a block a weight for each tap, then a residual.
    pub weights: TensorView<'a, R>,
    /// Log irradiance.
    pub logs: TensorView<'a, R>,
    /// Estimate of the irradiance.
    pub estimate: TensorView<'a, R>,
}

/// A result pixel and what it is made of.
#[derive(Clone, Copy, Debug)]
pub struct Pixel<'a, R> {
    /// Estimate of the irradiance.
    pub estimate: R,
    /// l of it.
    pub base: R,
    /// Log irradiance of each tap; the base in place of those outside of the frame or of the recording.
    pub logs: &'a [R],
    /// Weight of each tap, and the residual behind them.
    pub weights: &'a [R],
}

impl<R: Real> Pixel<'_, R> {
    /// base + Σ weight·(log irradiance − base) + residual.
    pub fn sum(&self) -> R {
        let Self { base, logs, weights, .. } = *self;
        let blended = logs.iter().zip(weights).fold(base, |sum, (&log, &weight)| sum + weight * (log - base));
        blended + weights[logs.len()]
    }
}

impl Blend<'_> {
    /// l⁻¹ of each pixel's sum, clamped to [0, 1].
    pub fn run<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        output: TensorViewMut<'_, R>,
        scratch: &ScratchPool<R>,
    ) {
        let tone = Tone::new();
        self.for_each_pixel(inputs, output, scratch, |pixel| pixel.sum(), |line| tone.inverse_of_all(line));
    }

    /// Writes what `result` makes of each pixel, and `finish` of a line of these.
    pub(super) fn for_each_pixel<R: Real>(
        &self,
        Inputs { weights, logs, estimate }: Inputs<'_, R>,
        output: TensorViewMut<'_, R>,
        scratch: &ScratchPool<R>,
        result: impl Fn(Pixel<'_, R>) -> R + Sync,
        finish: impl Fn(&mut [R]) + Sync,
    ) {
        let tone = Tone::new();
        let [_, by, bx] = self.block;
        let n = self.taps.len();
        let [_, height, width] = output.shape.extent();
        output.for_each_rows(by, |mut rows| {
            scratch.with(|scratch| {
                for row in 0..rows.len() {
                    let (t, y) = (rows.t, rows.y + row);
                    let estimates = estimate.line(t, y);
                    let base = &mut scratch.sums;
                    base.clear();
                    base.extend(estimates);
                    tone.of_all(base);
                    // [x][tap]
                    let near = &mut scratch.gathered;
                    near.clear();
                    near.extend(base.iter().flat_map(|&base| std::iter::repeat_n(base, n)));
                    for (i, &[dt, dy, dx]) in self.taps.iter().enumerate() {
                        let place = frame(logs.shape.t, self.lead + t, dt).zip(frame(height, y, dy));
                        let Some((tap_t, tap_y)) = place else { continue };
                        let inside = dx.min(0).unsigned_abs() as usize..width;
                        let line = logs.line(tap_t, tap_y).iter().skip(dx.max(0) as usize);
                        for (x, &log) in inside.zip(line) {
                            near[x * n + i] = log;
                        }
                    }
                    let first = y % by * bx * (n + 1);
                    let blocks = weights.row(t, y / by);
                    let pixels = blocks.flat_map(|block| block[first..].chunks_exact(n + 1).take(bx));
                    let line = rows.line(row);
                    for (x, (value, weights)) in line.iter_mut().zip(pixels).enumerate() {
                        let logs = &near[x * n..][..n];
                        *value = result(Pixel { estimate: estimates[x], base: base[x], logs, weights });
                    }
                    finish(line);
                }
            });
        });
    }
}

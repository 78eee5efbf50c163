//! What [`conv3d`](super::conv3d) and [`conv_transpose3d`](super::conv_transpose3d) share: both are sums over
//! windows of the input, followed by the epilogue.
//!
//! Results are computed in blocks of a few rows of one frame. The pixels that a block depends on are gathered
//! into scratch memory, padded with zeros. There, the taps along x of a pixel and their channels are one run
//! of neighbouring values, so that the sum is a product of short runs with packed weights ([`super::gemm`]),
//! without an im2col copy.

use super::gemm::{Product, Segment, Tile};
use super::view::{Rows, Scratch, positions};
use super::{Real, ScratchPool, TensorView, TensorViewMut};
use crate::network::{Activation, ConvolutionStep};

/// Results of a block. A block's inputs and a panel of weights should stay in the second-level cache.
const BLOCK: usize = 192;

/// Columns of a block at most.
const BLOCK_COLUMNS: usize = 64;

/// Values of a pixel that are multiplied in one go: that many rows of a panel should stay in the first-level
/// cache.
const DEPTH: usize = 256;

/// Which inputs the results along one axis depend on. Results at positions o ≡ i (mod n) are of phase i,
/// where n is the number of phases.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Inputs between neighbouring results of a phase.
    pub stride: usize,
    /// The phases: one for a convolution, as many as its stride for a transposed one.
    pub phases: Vec<Phase>,
}

/// Inputs of one phase of results.
#[derive(Clone, Copy, Debug)]
pub struct Phase {
    /// First input of the first result, which may lie in the padding.
    pub origin: isize,
    /// Number of neighbouring inputs.
    pub taps: usize,
}

/// A convolution, ready to run.
#[derive(Debug)]
pub struct Packed<R> {
    axes: [Axis; 3],
    in_channels: usize,
    out_channels: usize,
    tile: Tile,
    /// For each phase along t, y and x, weights [panel][tap t, y, x][in channel][channel of the panel].
    weights: Vec<Vec<R>>,
    bias: Vec<R>,
    norm: Option<[Vec<R>; 2]>,
    activation: Activation,
}

impl Axis {
    /// First input and phase of result `o`.
    fn window(&self, o: usize) -> (isize, usize) {
        let phase = o % self.phases.len();
        let step = o / self.phases.len() * self.stride;
        (step as isize + self.phases[phase].origin, phase)
    }

    /// First input, and one behind the last input, of results `begin` … `end`.
    fn range(&self, begin: usize, end: usize) -> (isize, isize) {
        let windows = (begin..end).map(|o| {
            let (first, phase) = self.window(o);
            (first, first + self.phases[phase].taps as isize)
        });
        windows.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default()
    }
}

impl<R: Real> Packed<R> {
    /// Packs the weights of a layer. `weight` gives the weight from in channel i to out channel o, for a
    /// phase and a tap of it along t, y and x.
    pub fn new(
        step: &ConvolutionStep,
        axes: [Axis; 3],
        weight: impl Fn(usize, usize, [usize; 3], [usize; 3]) -> f32,
    ) -> Self {
        let ConvolutionStep { in_channels, out_channels, activation, ref layer, .. } = *step;
        let tile = R::tile(out_channels);
        let panels = out_channels.div_ceil(tile.width);
        let mut weights = Vec::new();
        for phase in positions(axes.each_ref().map(|axis| axis.phases.len())) {
            let taps: [usize; 3] = std::array::from_fn(|i| axes[i].phases[phase[i]].taps);
            let mut packed =
                Vec::with_capacity(panels * tile.width * in_channels * taps.iter().product::<usize>());
            for panel in 0..panels {
                for tap in positions(taps) {
                    for i in 0..in_channels {
                        packed.extend((panel * tile.width..(panel + 1) * tile.width).map(|o| {
                            if o < out_channels { R::from_f32(weight(o, i, phase, tap)) } else { R::ZERO }
                        }));
                    }
                }
            }
            weights.push(packed);
        }
        let reals = |values: &[f32]| values.iter().map(|&v| R::from_f32(v)).collect::<Vec<R>>();
        Self {
            axes,
            in_channels,
            out_channels,
            tile,
            weights,
            bias: reals(&layer.bias),
            norm: layer.norm.as_ref().map(|(scale, shift)| [reals(scale), reals(shift)]),
            activation,
        }
    }

    /// Number of products that a result is the sum of, at most.
    pub fn products(&self) -> usize {
        let taps = |axis: &Axis| axis.phases.iter().map(|phase| phase.taps).max().unwrap_or(0);
        self.axes.iter().map(taps).product::<usize>() * self.in_channels
    }

    /// Computes all results.
    pub fn run(
        &self,
        input: TensorView<'_, R>,
        added: Option<TensorView<'_, R>>,
        output: TensorViewMut<'_, R>,
        scratch: &ScratchPool<R>,
    ) {
        let width = output.shape.x;
        // Blocks of nearly equal width.
        let columns = width.div_ceil(width.div_ceil(BLOCK_COLUMNS).max(1)).max(1);
        // Small tensors are split further, so that all threads have work to the end.
        let share = (output.shape.t * output.shape.y).div_ceil(8 * rayon::current_num_threads());
        let rows = (BLOCK / columns).min(share).max(1);
        output.for_each_rows(rows, |mut rows| {
            scratch.with(|scratch| {
                for x in (0..width).step_by(columns) {
                    self.block(input, added, &mut rows, (x, width.min(x + columns)), scratch);
                }
            });
        });
    }

    /// Computes columns `begin` … `end` of some rows.
    fn block(
        &self,
        input: TensorView<'_, R>,
        added: Option<TensorView<'_, R>>,
        rows: &mut Rows<'_, R>,
        (begin, end): (usize, usize),
        scratch: &mut Scratch<R>,
    ) {
        let [axis_t, axis_y, axis_x] = &self.axes;
        let (first_t, phase_t) = axis_t.window(rows.t);
        let taps_t = axis_t.phases[phase_t].taps;
        // Frames of the padding are left out: in a window of few frames they are many.
        let skipped = (-first_t).clamp(0, taps_t as isize) as usize;
        let frames =
            (input.shape.t as isize - first_t).clamp(skipped as isize, taps_t as isize) as usize - skipped;
        let range_t = (first_t + skipped as isize, first_t + (skipped + frames) as isize);
        let range_y = axis_y.range(rows.y, rows.y + rows.len());
        let range_x = axis_x.range(begin, end);
        gather(input, [range_t, range_y, range_x], &mut scratch.gathered);
        let row = (range_x.1 - range_x.0) as usize * self.in_channels;
        let frame = (range_y.1 - range_y.0) as usize * row;

        for (phase_y, &Phase { taps: taps_y, .. }) in axis_y.phases.iter().enumerate() {
            for (phase_x, &Phase { taps: taps_x, .. }) in axis_x.phases.iter().enumerate() {
                let run = taps_x * self.in_channels;
                scratch.segments.clear();
                for t in 0..frames {
                    for y in 0..taps_y {
                        let offset = t * frame + y * row;
                        let segment = |at| Segment { offset: offset + at, len: DEPTH.min(run - at) };
                        scratch.segments.extend((0..run).step_by(DEPTH).map(segment));
                    }
                }
                scratch.places.clear();
                scratch.pixels.clear();
                for y in 0..rows.len() {
                    let (first_y, phase) = axis_y.window(rows.y + y);
                    if phase != phase_y {
                        continue;
                    }
                    for x in begin..end {
                        let (first_x, phase) = axis_x.window(x);
                        if phase == phase_x {
                            let (y_in, x_in) =
                                ((first_y - range_y.0) as usize, (first_x - range_x.0) as usize);
                            scratch.pixels.push(y_in * row + x_in * self.in_channels);
                            scratch.places.push([y, x]);
                        }
                    }
                }
                let Some(&last) = scratch.pixels.last() else { continue };
                // The last tile is filled up with a pixel whose sums nobody reads.
                scratch.pixels.resize(scratch.pixels.len().next_multiple_of(self.tile.pixels), last);

                let phases = [axis_t.phases.len(), axis_y.phases.len(), axis_x.phases.len()];
                let weights = &self.weights[(phase_t * phases[1] + phase_y) * phases[2] + phase_x];
                let taps_yx = taps_y * run;
                for (index, panel) in weights.chunks_exact(taps_t * taps_yx * self.tile.width).enumerate() {
                    self.sum(&panel[skipped * taps_yx * self.tile.width..], scratch);
                    self.epilogue(index * self.tile.width, scratch, added, rows);
                }
            }
        }
    }

    /// Computes the sums of all pixels for one panel.
    fn sum(&self, mut panel: &[R], scratch: &mut Scratch<R>) {
        scratch.sums.clear();
        scratch.sums.resize(scratch.pixels.len() * self.tile.width, R::ZERO);
        let mut segments = &scratch.segments[..];
        while !segments.is_empty() {
            let mut depth = 0;
            let fits = |segment: &&Segment| {
                depth += segment.len;
                depth <= DEPTH
            };
            let count = segments.iter().take_while(fits).count();
            let (now, later) = segments.split_at(count);
            let depth: usize = now.iter().map(|segment| segment.len).sum();
            let (weights, rest) = panel.split_at(depth * self.tile.width);
            let product =
                Product { values: &scratch.gathered, pixels: &scratch.pixels, segments: now, panel: weights };
            R::multiply(&product, self.tile, &mut scratch.sums);
            (segments, panel) = (later, rest);
        }
    }

    /// Turns the sums of the channels from `channel` on into results.
    fn epilogue(
        &self,
        channel: usize,
        scratch: &Scratch<R>,
        added: Option<TensorView<'_, R>>,
        rows: &mut Rows<'_, R>,
    ) {
        match self.activation {
            Activation::None => self.finish(channel, scratch, added, rows, |v| v),
            Activation::LeakyRelu(slope) => {
                let slope = R::from_f32(slope);
                self.finish(channel, scratch, added, rows, |v| if v < R::ZERO { slope * v } else { v });
            }
            Activation::Sigmoid => self.finish(channel, scratch, added, rows, sigmoid),
            Activation::Softplus(floor) => {
                let floor = R::from_f32(floor);
                self.finish(channel, scratch, added, rows, |v| softplus(v) + floor);
            }
        }
    }

    /// v = activation(sum + bias); with `norm`: v = v·scale + shift; with `added`: v = v + added.
    fn finish(
        &self,
        channel: usize,
        scratch: &Scratch<R>,
        added: Option<TensorView<'_, R>>,
        rows: &mut Rows<'_, R>,
        activation: impl Fn(R) -> R,
    ) {
        let channels = channel..self.out_channels.min(channel + self.tile.width);
        let bias = &self.bias[channels.clone()];
        let norm = self.norm.as_ref().map(|norm| norm.each_ref().map(|values| &values[channels.clone()]));
        let (t, first_row) = (rows.t, rows.y);
        for (&[y, x], sums) in scratch.places.iter().zip(scratch.sums.chunks_exact(self.tile.width)) {
            let results = &mut rows.pixel(y, x)[channels.clone()];
            for ((result, &sum), &bias) in results.iter_mut().zip(sums).zip(bias) {
                *result = activation(sum + bias);
            }
            if let Some([scale, shift]) = norm {
                for ((result, &scale), &shift) in results.iter_mut().zip(scale).zip(shift) {
                    *result = *result * scale + shift;
                }
            }
            if let Some(added) = added {
                let added = &added.pixel(t, first_row + y, x)[channels.clone()];
                for (result, &added) in results.iter_mut().zip(added) {
                    *result += added;
                }
            }
        }
    }
}

/// 1/(1 + e⁻ᵛ), without overflow.
fn sigmoid<R: Real>(v: R) -> R {
    let e = (-v.abs()).exp();
    if v < R::ZERO { e / (R::ONE + e) } else { R::ONE / (R::ONE + e) }
}

/// ln(1 + eᵛ), without overflow.
fn softplus<R: Real>(v: R) -> R {
    v.at_least(R::ZERO) + (-v.abs()).exp().ln_1p()
}

/// Copies the pixels in ranges of frames, rows and columns, densely and with zeros outside of the tensor.
fn gather<R: Real>(input: TensorView<'_, R>, [t, y, x]: [(isize, isize); 3], gathered: &mut Vec<R>) {
    let channels = input.shape.c;
    let width = input.shape.x as isize;
    let len = |(begin, end): (isize, isize)| (end - begin) as usize;
    let (inside, outside) = (x.0.clamp(0, width), x.1.clamp(0, width));
    gathered.clear();
    gathered.reserve(len(t) * len(y) * len(x) * channels);
    for t in t.0..t.1 {
        for y in y.0..y.1 {
            if y < 0 || y >= input.shape.y as isize || inside >= outside {
                gathered.resize(gathered.len() + len(x) * channels, R::ZERO);
                continue;
            }
            gathered.resize(gathered.len() + len((x.0, inside)) * channels, R::ZERO);
            let pixels = input.from(t as usize, y as usize, inside as usize);
            if input.stride == channels {
                gathered.extend_from_slice(&pixels[..len((inside, outside)) * channels]);
            } else if channels == 1 {
                gathered.extend(pixels.iter().step_by(input.stride).take(len((inside, outside))));
            } else {
                for pixel in pixels.chunks(input.stride).take(len((inside, outside))) {
                    gathered.extend_from_slice(&pixel[..channels]);
                }
            }
            gathered.resize(gathered.len() + len((outside, x.1)) * channels, R::ZERO);
        }
    }
}

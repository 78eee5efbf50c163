//! What [`conv3d`](super::conv3d) and [`conv_transpose3d`](super::conv_transpose3d) share: both are sums over
//! windows of the input, followed by the epilogue.
//!
//! Results are computed in blocks of a few rows of one frame. The pixels that a block depends on are gathered
//! into scratch memory, padded with zeros. There, the taps along x of a pixel and their channels are one run
//! of neighbouring values, so that the sum is a product of short runs with packed weights ([`super::gemm`]),
//! without an im2col copy. Where they are that in the tensor itself, nothing is copied at all.
//!
//! Few output channels would leave vectors half empty. So a *group* of neighbouring results along x can count
//! as one result with all their channels, whose run is so much longer; weights outside of a result's own taps
//! are zero, which changes no sum.
// Code gets the instructions of the function that it is inlined into.
#![allow(clippy::inline_always)]

use super::Real;
use super::gemm::{Product, RegisterBlock, RegisterBlockTask, Segment, multiply};
use super::simd::{Simd, SimdToken, Vector};
use super::view::{Rows, Scratch, positions};
use super::view::{ScratchPool, TensorView, TensorViewMut};
use crate::network::{Activation, ConvolutionStep};

/// Results of a block. A block's inputs and a panel of weights should stay in the second-level cache.
const BLOCK: usize = 192;

/// Columns of a block at most.
const BLOCK_COLUMNS: usize = 64;

/// Values of a pixel that are multiplied in one go, at most.
const DEPTH: usize = 256;

/// Weights that are used in one go, at most: they should stay in the first-level cache.
const PANEL: usize = 8192;

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
    /// Number of products that a result is the sum of, at most.
    products: usize,
    simd: Simd,
    registers: RegisterBlock,
    /// Results along x that count as one.
    group: usize,
    /// For each phase along t, y and x, weights [panel][tap t, y, x][in channel][channel of the panel].
    weights: Vec<Vec<R>>,
    /// One value a channel of each panel, as those below.
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

    /// Results `begin` … `end` of one phase, each with its first input.
    fn windows(
        &self,
        phase: usize,
        begin: usize,
        end: usize,
    ) -> impl Iterator<Item = (usize, isize)> + use<> {
        let (phases, stride, origin) = (self.phases.len(), self.stride, self.phases[phase].origin);
        let first = begin.saturating_sub(phase).div_ceil(phases);
        let steps = (first..).take_while(move |step| step * phases + phase < end);
        steps.map(move |step| (step * phases + phase, (step * stride) as isize + origin))
    }

    /// Groups of results count as one; only where there is one phase.
    fn grouped(&self, group: usize) -> Self {
        let phases = self.phases.iter();
        let longer = phases.map(|p| Phase { taps: p.taps + (group - 1) * self.stride, ..*p });
        Self { stride: self.stride * group, phases: longer.collect() }
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

/// The register block, and results along x to a group, that take least time.
fn register_blocking<R: Real>(simd: Simd, out_channels: usize, axis_x: &Axis) -> (RegisterBlock, usize) {
    let cost = |&(registers, group): &(RegisterBlock, usize)| {
        let taps = axis_x.grouped(group).phases[0].taps;
        registers.cost * (out_channels * group).div_ceil(registers.width()) as f64 * taps as f64
            / group as f64
    };
    let groups = |registers: RegisterBlock| {
        let most = if axis_x.phases.len() == 1 { (registers.width() / out_channels).max(1) } else { 1 };
        (1..=most).map(move |group| (registers, group))
    };
    let blockings = RegisterBlock::all::<R>(simd).flat_map(groups);
    blockings.min_by(|a, b| cost(a).total_cmp(&cost(b))).expect("there are register blocks")
}

impl<R: Real> Packed<R> {
    /// Packs the weights of a layer. `weight` gives the weight from in channel i to out channel o, for a
    /// phase and a tap of it along t, y and x.
    pub fn new(
        step: &ConvolutionStep,
        axes: [Axis; 3],
        simd: Simd,
        weight: impl Fn(usize, usize, [usize; 3], [usize; 3]) -> f32,
    ) -> Self {
        let ConvolutionStep { in_channels, out_channels, activation, ref layer, .. } = *step;
        let taps = |axis: &Axis| axis.phases.iter().map(|phase| phase.taps).max().unwrap_or(0);
        let products = axes.iter().map(taps).product::<usize>() * in_channels;
        let (registers, group) = register_blocking::<R>(simd, out_channels, &axes[2]);
        let panels = (group * out_channels).div_ceil(registers.width());
        let (stride_x, phases_x) = (axes[2].stride, axes[2].phases.clone());
        let [axis_t, axis_y, axis_x] = axes;
        let axes = [axis_t, axis_y, axis_x.grouped(group)];
        // Channel c of a group is out channel c mod out_channels of one of its results.
        let grouped = |c: usize, i: usize, phase: [usize; 3], [t, y, x]: [usize; 3]| {
            let (result, o) = (c / out_channels, c % out_channels);
            let tap = x.checked_sub(result * stride_x).filter(|tap| *tap < phases_x[phase[2]].taps);
            tap.filter(|_| result < group).map_or(R::ZERO, |x| R::from_f32(weight(o, i, phase, [t, y, x])))
        };
        let mut weights = Vec::new();
        for phase in positions(axes.each_ref().map(|axis| axis.phases.len())) {
            let taps: [usize; 3] = std::array::from_fn(|i| axes[i].phases[phase[i]].taps);
            let mut packed =
                Vec::with_capacity(panels * registers.width() * in_channels * taps.iter().product::<usize>());
            for panel in 0..panels {
                for tap in positions(taps) {
                    for i in 0..in_channels {
                        let channels = panel * registers.width()..(panel + 1) * registers.width();
                        packed.extend(channels.map(|c| grouped(c, i, phase, tap)));
                    }
                }
            }
            weights.push(packed);
        }
        let channels = |values: &[f32]| {
            let groups = values.iter().cycle().take(group * out_channels).map(|&v| R::from_f32(v));
            let mut channels: Vec<R> = groups.collect();
            channels.resize(panels * registers.width(), R::ZERO);
            channels
        };
        Self {
            axes,
            in_channels,
            out_channels,
            products,
            simd,
            registers,
            group,
            weights,
            bias: channels(&layer.bias),
            norm: layer.norm.as_ref().map(|(scale, shift)| [channels(scale), channels(shift)]),
            activation,
        }
    }

    /// The vector instructions that the weights are packed for.
    pub fn simd(&self) -> Simd {
        self.simd
    }

    /// Number of products that a result is the sum of, at most.
    pub fn products(&self) -> usize {
        self.products
    }

    /// Computes all results.
    pub fn run(
        &self,
        input: TensorView<'_, R>,
        added: Option<TensorView<'_, R>>,
        output: TensorViewMut<'_, R>,
        scratch: &ScratchPool<R>,
    ) {
        let width = output.shape.x.div_ceil(self.group);
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

    /// Computes columns `begin` … `end` (of groups) of some rows.
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
        let ranges = [range_t, range_y, range_x];
        let mut gathered = std::mem::take(&mut scratch.gathered);
        let one_tap = axis_x.phases.iter().all(|phase| phase.taps == 1);
        let in_place =
            if one_tap || input.stride == self.in_channels { in_place(input, ranges) } else { None };
        let Pixels { values, pixel, row, frame } =
            in_place.unwrap_or_else(|| gather(input, ranges, &mut gathered));
        let depth = DEPTH.min(PANEL / self.registers.width());

        for (phase_y, &Phase { taps: taps_y, .. }) in axis_y.phases.iter().enumerate() {
            for (phase_x, &Phase { taps: taps_x, .. }) in axis_x.phases.iter().enumerate() {
                let run = taps_x * self.in_channels;
                scratch.segments.clear();
                for t in 0..frames {
                    for y in 0..taps_y {
                        let offset = t * frame + y * row;
                        let segment = |at| Segment { offset: offset + at, len: depth.min(run - at) };
                        scratch.segments.extend((0..run).step_by(depth).map(segment));
                    }
                }
                scratch.places.clear();
                scratch.pixels.clear();
                for (y, first_y) in axis_y.windows(phase_y, rows.y, rows.y + rows.len()) {
                    let row = (first_y - range_y.0) as usize * row;
                    for (x, first_x) in axis_x.windows(phase_x, begin, end) {
                        scratch.pixels.push(row + (first_x - range_x.0) as usize * pixel);
                        scratch.places.push([y - rows.y, x * self.group]);
                    }
                }
                let Some(&last) = scratch.pixels.last() else { continue };
                // The last register block is filled up with a pixel whose sums nobody reads.
                let pixels = scratch.pixels.len().next_multiple_of(self.registers.pixels);
                scratch.pixels.resize(pixels, last);
                let sums = pixels * self.registers.width();
                if scratch.sums.len() < sums {
                    scratch.sums.resize(sums, R::ZERO);
                }

                let phases = [axis_t.phases.len(), axis_y.phases.len(), axis_x.phases.len()];
                let weights = &self.weights[(phase_t * phases[1] + phase_y) * phases[2] + phase_x];
                let taps_yx = taps_y * run;
                for (index, panel) in
                    weights.chunks_exact(taps_t * taps_yx * self.registers.width()).enumerate()
                {
                    let panel = Panel {
                        layer: self,
                        index,
                        weights: &panel[skipped * taps_yx * self.registers.width()..],
                        depth,
                        values,
                        scratch,
                        added,
                        rows,
                    };
                    self.registers.run(self.simd, panel);
                }
            }
        }
        scratch.gathered = gathered;
    }
}

/// The channels of one panel, for the pixels of a block.
struct Panel<'a, 'r, R> {
    layer: &'a Packed<R>,
    index: usize,
    weights: &'a [R],
    /// Products in one go.
    depth: usize,
    /// The pixels that the block depends on.
    values: &'a [R],
    scratch: &'a mut Scratch<R>,
    added: Option<TensorView<'a, R>>,
    rows: &'a mut Rows<'r, R>,
}

impl<R: Real> RegisterBlockTask for Panel<'_, '_, R> {
    #[inline(always)]
    fn run<T: SimdToken, const PIXELS: usize, const VECTORS: usize>(mut self, token: T) {
        self.sum::<T, PIXELS, VECTORS>(token);
        match self.layer.activation {
            Activation::None => self.finish::<T, VECTORS>(token, |v| v),
            Activation::LeakyRelu(slope) => {
                let slope = R::Vector::<T>::splat(token, R::from_f32(slope));
                self.finish::<T, VECTORS>(token, |v| v.unless_negative(v * slope));
            }
            Activation::Sigmoid => self.finish::<T, VECTORS>(token, |v| v.map(sigmoid)),
            Activation::Softplus(floor) => {
                let floor = R::from_f32(floor);
                self.finish::<T, VECTORS>(token, |v| v.map(|v| softplus(v) + floor));
            }
        }
    }
}

impl<R: Real> Panel<'_, '_, R> {
    /// Computes the sums of all pixels.
    #[inline(always)]
    fn sum<T: SimdToken, const PIXELS: usize, const VECTORS: usize>(&mut self, token: T) {
        let width = VECTORS * R::Vector::<T>::LANES;
        let Scratch { sums, pixels, segments, .. } = &mut *self.scratch;
        let (mut segments, mut panel) = (&segments[..], self.weights);
        let sums = &mut sums[..pixels.len() * width];
        let mut first = true;
        // Where there is nothing but padding, there are no segments; the sums are zero then.
        while first || !segments.is_empty() {
            let mut depth = 0;
            let fits = |segment: &&Segment| {
                depth += segment.len;
                depth <= self.depth
            };
            let count = segments.iter().take_while(fits).count();
            let (now, later) = segments.split_at(count);
            let depth: usize = now.iter().map(|segment| segment.len).sum();
            let (weights, rest) = panel.split_at(depth * width);
            let product = Product { values: self.values, pixels, segments: now, panel: weights };
            multiply::<R, T, PIXELS, VECTORS>(token, &product, first, sums);
            (segments, panel, first) = (later, rest, false);
        }
    }

    /// v = activation(sum + bias); with `norm`: v = v·scale + shift; with `added`: v = v + added.
    #[inline(always)]
    fn finish<T: SimdToken, const VECTORS: usize>(
        &mut self,
        token: T,
        activation: impl Fn(R::Vector<T>) -> R::Vector<T>,
    ) {
        let lanes = R::Vector::<T>::LANES;
        let panel_width = VECTORS * lanes;
        let Packed { out_channels, group, bias, norm, .. } = self.layer;
        let channel = self.index * panel_width;
        let bias = &bias[channel..][..panel_width];
        let norm = norm.as_ref().map(|norm| norm.each_ref().map(|values| &values[channel..][..panel_width]));
        // Channels of a result in this panel.
        let channels = channel..(*out_channels).min(channel + panel_width);
        let (t, first_row, width) = (self.rows.t, self.rows.y, self.rows.width());
        let sums = self.scratch.sums.chunks_exact_mut(panel_width);
        for (&[y, x], sums) in self.scratch.places.iter().zip(sums) {
            // Everything happens in place, and in one loop: closures that are called twice are not inlined.
            for (i, sums) in sums.chunks_exact_mut(lanes).enumerate() {
                let at = i * lanes;
                let sum = R::Vector::<T>::load(token, sums);
                let mut value = activation(sum + R::Vector::<T>::load(token, &bias[at..]));
                if let Some([scale, shift]) = norm {
                    let scale = R::Vector::<T>::load(token, &scale[at..]);
                    value = value * scale + R::Vector::<T>::load(token, &shift[at..]);
                }
                value.store(sums);
            }
            for (values, x) in sums.chunks_exact(channels.len()).zip(x..width).take(*group) {
                let result = &mut self.rows.pixel(y, x)[channels.clone()];
                result.copy_from_slice(values);
                if let Some(added) = self.added {
                    let added = &added.pixel(t, first_row + y, x)[channels.clone()];
                    for (result, &added) in result.iter_mut().zip(added) {
                        *result += added;
                    }
                }
            }
        }
    }
}

/// 1/(1 + e⁻ᵛ), without overflow.
#[inline(always)]
fn sigmoid<R: Real>(v: R) -> R {
    let e = (-v.abs()).exp();
    if v < R::ZERO { e / (R::ONE + e) } else { R::ONE / (R::ONE + e) }
}

/// ln(1 + eᵛ), without overflow.
#[inline(always)]
fn softplus<R: Real>(v: R) -> R {
    v.at_least(R::ZERO) + (-v.abs()).exp().ln_1p()
}

/// The pixels in ranges of frames, rows and columns: the first one's first channel, and how far the others are apart.
struct Pixels<'a, R> {
    values: &'a [R],
    pixel: usize,
    row: usize,
    frame: usize,
}

/// The pixels as they lie in the tensor, if all are inside of it.
fn in_place<R: Real>(input: TensorView<'_, R>, ranges: [(isize, isize); 3]) -> Option<Pixels<'_, R>> {
    let TensorView { stride: pixel, shape, .. } = input;
    let inside =
        |((begin, end), len): ((isize, isize), usize)| 0 <= begin && begin < end && end <= len as isize;
    if !ranges.into_iter().zip([shape.t, shape.y, shape.x]).all(inside) {
        return None;
    }
    let [t, y, x] = ranges.map(|(begin, _)| begin as usize);
    Some(Pixels {
        values: input.from(t, y, x),
        pixel,
        row: shape.x * pixel,
        frame: shape.y * shape.x * pixel,
    })
}

/// Copies the pixels in ranges of frames, rows and columns, densely and with zeros outside of the tensor.
fn gather<'a, R: Real>(
    input: TensorView<'_, R>,
    [t, y, x]: [(isize, isize); 3],
    gathered: &'a mut Vec<R>,
) -> Pixels<'a, R> {
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
    let row = len(x) * channels;
    Pixels { values: gathered, pixel: channels, row, frame: len(y) * row }
}

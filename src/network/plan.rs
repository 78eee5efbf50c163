//! Lowering: a model becomes an ordered list of steps over a few buffers that are reused.
//!
//! Every tensor lives in a *slot*, a buffer of its own. Tensors whose lifetimes do not overlap share a slot.
//! The inputs of a concatenation are written straight into the channels of the result, so it costs nothing. A
//! step never reads the slot that it writes: safe Rust wants that on the CPU, and resource tracking on the
//! GPU. Where that keeps a tensor out of a concatenation, it is copied there.

use std::collections::{HashMap, HashSet};
use std::ops::{Range, RangeInclusive};
use std::sync::Arc;

use super::graph::MEASUREMENT;
use super::pieces::{Group, Piece};
use super::slots::{Allocation, Arrangement, Kept, indices};
use super::{
    Activation, Block, Convolution, Direction, Feature, Graph, Layer, Model, NetworkError, Node, Op, Shape,
    Tap, Window,
};

/// Most weights of the convolutions that copy, which a file of a few bytes can ask for.
const MAX_IDENTITIES: usize = 1 << 24;

/// Number of a tensor in [`Plan::tensors`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TensorId(pub usize);

/// A tensor of a plan: what is stored, whole, in one slot. The parts of a concatenation are views of one tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedTensor {
    /// Name of the node that it is the result of.
    pub name: String,
    /// Whether it is f32 at any precision of an executor (see [`full_precision`]).
    pub full_precision: bool,
    /// The slot that it lies in.
    pub slot: usize,
    /// Its values.
    pub len: usize,
    /// Its lifetime: the nodes of the graph from the first one that writes it to the last one that reads it.
    pub lifetime: RangeInclusive<usize>,
}

/// A tensor, or a part of one, inside a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct View {
    /// Which tensor.
    pub tensor: TensorId,
    /// The tensor's slot.
    pub slot: usize,
    /// Value of the slot at which the first pixel's first channel lies.
    pub offset: usize,
    /// Values between neighbouring pixels, ≥ `shape.c`. A multiple of 4 for feature channels (the padding
    /// channels hold finite values that no result depends on), 1 for tensors of one value a pixel.
    pub stride: usize,
    /// Extents.
    pub shape: Shape,
}

impl View {
    /// Frames `start` … `start + frames` of this view.
    #[must_use]
    pub fn frames(self, start: usize, frames: usize) -> Self {
        let shape = Shape { t: frames, ..self.shape };
        Self { offset: self.offset + start * self.shape.y * self.shape.x * self.stride, shape, ..self }
    }

    /// Rows `start` … `start + rows` of this view of one frame.
    #[must_use]
    fn rows(self, start: usize, rows: usize) -> Self {
        debug_assert!(self.shape.t == 1 || rows == self.shape.y, "rows of several frames lie apart");
        let shape = Shape { y: rows, ..self.shape };
        Self { offset: self.offset + start * self.shape.x * self.stride, shape, ..self }
    }
}

/// What a step computes.
#[derive(Clone, Debug)]
pub enum Kernel {
    /// Box filter: measurement → estimate.
    BoxEstimate,
    /// Measurement → log irradiance.
    LogIrradiance,
    /// Normalise and fold: measurement, estimate (, log irradiance) → channels.
    Features {
        /// Channels per pixel.
        channels: Vec<Channel>,
        /// Block that is folded.
        block: Block,
        /// Frames of the log irradiance before the first block.
        lead: usize,
    },
    /// Convolution of either direction, and its epilogue: x (, added) → channels.
    Convolution(Arc<ConvolutionStep>),
    /// Rendered pixel values → pixel values and irradiance.
    InverseResponse {
        /// Exposure of each channel, in frames.
        exposures: Vec<f32>,
    },
    /// Weighted mean: weights, (pixel values and) irradiance → radiance.
    Fuse,
    /// Predicted kernels: weights and residual, log irradiance, estimate → radiance.
    Blend {
        /// Block that is unfolded.
        block: Block,
        /// Offsets t, y, x of the pixels that the weights are for. Those outside of the log irradiance do not count.
        taps: Arc<[Tap]>,
        /// Frame and row of the log irradiance at which the result begins.
        origin: [usize; 2],
    },
}

impl Kernel {
    /// Name of the kernel, which is that of its shader and of its CPU twin.
    pub fn name(&self) -> &'static str {
        match self {
            Self::BoxEstimate => "box_estimate",
            Self::LogIrradiance => "log_irradiance",
            Self::Features { .. } => "features",
            Self::Convolution(step) => match step.direction {
                Direction::Forward => "conv3d",
                Direction::Transposed => "conv_transpose3d",
            },
            Self::InverseResponse { .. } => "inverse_response",
            Self::Fuse => "fuse",
            Self::Blend { .. } => "blend",
        }
    }

    /// The convolution, if it is one.
    pub fn convolution(&self) -> Option<&Arc<ConvolutionStep>> {
        match self {
            Self::Convolution(step) => Some(step),
            Self::BoxEstimate
            | Self::LogIrradiance
            | Self::Features { .. }
            | Self::InverseResponse { .. }
            | Self::Fuse
            | Self::Blend { .. } => None,
        }
    }
}

/// A channel of [`Kernel::Features`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channel {
    /// What is computed from the pixel.
    pub feature: Feature,
    /// How many frames later the pixel is, if it is log irradiance from the third input, which is 0 outside.
    pub offset: i32,
}

/// A convolution with all that its kernel needs.
#[derive(Clone, Debug)]
pub struct ConvolutionStep {
    /// Which way it goes.
    pub direction: Direction,
    /// Taps along t, y, x.
    pub kernel: [usize; 3],
    /// Steps along t, y, x.
    pub stride: [usize; 3],
    /// Zero padding in front along t, y, x.
    pub padding: [usize; 3],
    /// Input channels.
    pub in_channels: usize,
    /// Output channels.
    pub out_channels: usize,
    /// Applied to sum and bias.
    pub activation: Activation,
    /// Weights, bias, scale and shift.
    pub layer: Arc<Layer>,
}

impl ConvolutionStep {
    /// Whether both compute the same with the same weights.
    pub fn is_same(&self, other: &Self) -> bool {
        // Models share layers, whose many weights need no comparing then.
        let weights = Arc::ptr_eq(&self.layer, &other.layer) || self.layer == other.layer;
        let shape = |step: &Self| {
            let Self { direction, kernel, stride, padding, in_channels, out_channels, .. } = *step;
            (direction, [kernel, stride, padding], [in_channels, out_channels], step.activation)
        };
        weights && shape(self) == shape(other)
    }

    /// Input channel, output channel and tap of weight `index`: [out, in, tap], or [in, out, tap] where it is transposed.
    pub fn place_of(&self, index: usize) -> [usize; 3] {
        let taps: usize = self.kernel.iter().product();
        let (channel, tap) = (index / taps, index % taps);
        match self.direction {
            Direction::Forward => [channel % self.in_channels, channel / self.in_channels, tap],
            Direction::Transposed => [channel / self.out_channels, channel % self.out_channels, tap],
        }
    }

    /// Largest magnitude of the weights to each output channel.
    pub fn largest_weights(&self) -> Vec<f32> {
        let mut largest = vec![0.0f32; self.out_channels];
        for (index, weight) in self.layer.weight.iter().enumerate() {
            let [_, out, _] = self.place_of(index);
            largest[out] = largest[out].max(weight.abs());
        }
        largest
    }
}

/// One kernel call.
#[derive(Clone, Debug)]
pub struct Step {
    /// Name of the node.
    pub name: String,
    /// What is computed.
    pub kernel: Kernel,
    /// What is read.
    pub inputs: Vec<View>,
    /// What is written.
    pub output: View,
    /// Frame of the window in which the output of a kernel on pixels begins.
    pub first_frame: usize,
}

/// Steps that are computed together, piece by piece.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Run {
    /// Steps of each piece. Other pieces read nothing that they write.
    pub pieces: Vec<Range<usize>>,
    /// Slots of what is there for one piece at a time, and how many values of them that takes. A piece that has its own
    /// need not wait for another one.
    pub inner: Vec<(usize, usize)>,
    /// What the run writes and the following window needs again.
    pub carries: Vec<Carry>,
}

/// Frames of a tensor that a window leaves for the following one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Carry {
    /// Where they are when they were computed: the last ones of the tensor.
    pub written: View,
    /// Where they stay, if the tensor's slot is needed for other tensors: they are kept as soon as they are written.
    pub kept: Option<View>,
    /// Where they are in the following window.
    pub wanted: View,
}

/// The steps of a window right behind another one, which compute only frames that the other one has not.
#[derive(Clone, Debug)]
pub struct Following {
    /// Steps in order.
    pub steps: Vec<Step>,
    /// The same steps in runs; before each one, what it would have written of frames that are known is put there.
    pub runs: Vec<Run>,
}

/// A model lowered for one window size.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Name of the graph.
    pub name: String,
    /// Steps in order.
    pub steps: Vec<Step>,
    /// The same steps in runs: one of each run's pieces after the other, or side by side.
    pub runs: Vec<Run>,
    /// What a window right behind another one computes, where the plan is for streams.
    pub following: Option<Following>,
    /// All tensors, the measurement first.
    pub tensors: Vec<PlannedTensor>,
    /// Size of each slot, in values.
    pub slots: Vec<usize>,
    /// Where the pixel values [frames, H, W] go in.
    pub measurement: View,
    /// Where the result [hop, H, W] comes out.
    pub result: View,
    /// What the net sees at once.
    pub window: Window,
}

/// What a step reads of a tensor.
#[derive(Clone, Copy)]
struct Read {
    view: View,
    /// Frames that are wanted before the view and are not there.
    missing: usize,
    /// Row of the tensor at which the view begins.
    row: usize,
}

impl Plan {
    /// Lowers `model` for windows of `height` × `width` pixels, which must be multiples of the granularity.
    pub fn lower(model: &Model, height: usize, width: usize) -> Result<Self, NetworkError> {
        Self::in_pieces(model, height, width, usize::MAX)
    }

    /// As [`Plan::in_pieces`], for windows that mostly follow each other: where the net's frames do not depend on the
    /// window, what a window has computed stays known for the following one.
    pub fn streaming(model: &Model, height: usize, width: usize, bytes: usize) -> Result<Self, NetworkError> {
        check_size(&model.graph, height, width)?;
        Self::build(model, height, width, bytes, true)
    }

    /// As [`Plan::lower`], with several steps for a node where neighbouring nodes are computed piece by piece, so that what
    /// one leaves for the next one takes about `bytes`, at 4 a value, but at least a frame, or a few rows where those can be
    /// computed by themselves. Results are the same.
    pub fn in_pieces(model: &Model, height: usize, width: usize, bytes: usize) -> Result<Self, NetworkError> {
        check_size(&model.graph, height, width)?;
        Self::build(model, height, width, bytes, false)
    }

    /// As [`Plan::lower`], for any size that the operations accept: single operations, such as a strided
    /// convolution, are defined on odd sizes too.
    pub fn lower_unaligned(model: &Model, height: usize, width: usize) -> Result<Self, NetworkError> {
        Self::build(model, height, width, usize::MAX, false)
    }

    fn build(
        model: &Model,
        height: usize,
        width: usize,
        piece_bytes: usize,
        streams: bool,
    ) -> Result<Self, NetworkError> {
        let graph = &model.graph;
        let Arrangement { needed, shapes, heights, groups, allocations, tensors, slots, kept, news } =
            &Arrangement::new(graph, height, width, piece_bytes, streams)?;
        let covers_window = graph.shapes(height, width)?[graph.output.as_str()].t == graph.window.frames;
        let index_of = indices(graph);
        let view = |name: &str| {
            let Allocation { tensor, channel, stride } = allocations[name];
            View { tensor, slot: tensors[tensor.0].slot, offset: channel, stride, shape: shapes[name] }
        };
        // Frames and rows of a tensor that are there while a group computes a piece.
        let there = |name: &str, group: &Group<'_>, piece: &Piece<'_>| {
            let Range { start, end } = needed[name].clone();
            let rows = 0..heights[name];
            if !group.inner.contains(&name) {
                return [start..end, rows];
            }
            let frames = start.max(piece.frames.start)..end.min(piece.frames.end);
            [frames, piece.rows(index_of[name]).unwrap_or(rows)]
        };
        // The part of a tensor that holds some of the frames and rows that are there.
        let part = |name: &str, there: &[Range<usize>; 2], [frames, rows]: [Range<usize>; 2]| {
            let View { shape, .. } = view(name);
            let whole = View { shape: Shape { y: there[1].len(), ..shape }, ..view(name) };
            let frames = whole.frames(frames.start - there[0].start, frames.len());
            frames.rows(rows.start - there[1].start, rows.len())
        };
        let computed = || graph.nodes.iter().filter(|node| needed.contains_key(node.name.as_str()));
        let blends = graph.nodes.iter().filter_map(|node| match &node.op {
            Op::Blend { taps, .. } => Some((node.name.as_str(), taps.as_slice().into())),
            _ => None,
        });
        let taps_of: HashMap<&str, Arc<[Tap]>> = blends.collect();
        let copied = computed().filter(|node| matches!(node.op, Op::Concat)).flat_map(|node| {
            let parts = parts_to_copy(node, view(&node.name), view);
            parts.into_iter().map(|(_, input, _)| input.shape.c * input.shape.c)
        });
        if copied.sum::<usize>() > MAX_IDENTITIES {
            let problem = "its concatenations copy too many channels".into();
            return Err(NetworkError::Graph(graph.name.clone(), problem));
        }
        let step = |node: &Node,
                    group: &Group<'_>,
                    piece: &Piece<'_>,
                    computed: &HashMap<&str, Range<usize>>| {
            let all = computed[node.name.as_str()].clone();
            let frames = all.start.max(piece.frames.start)..all.end.min(piece.frames.end);
            if frames.is_empty() {
                return Vec::new();
            }
            if matches!(node.op, Op::Concat) {
                let cut = |name: &str| view(name).frames(frames.start - needed[name].start, frames.len());
                return copies(node, cut(&node.name), cut);
            }
            let rows = piece.rows(index_of[node.name.as_str()]);
            let wanted_rows = rows.clone().and_then(|rows| node.reads_rows(rows));
            let rows = rows.unwrap_or(0..heights[node.name.as_str()]);
            let present = there(&node.name, group, piece);
            let output = part(&node.name, &present, [frames.clone(), rows.clone()]);
            let reads: Vec<Option<Read>> = node
                .tensors()
                .zip(node.reads(frames.clone()))
                .enumerate()
                // The first input stands in for one that is not read.
                .map(|(input, (name, wanted_frames))| {
                    (!wanted_frames.is_empty()).then(|| {
                        let all = isize::MIN..isize::MAX;
                        let wanted_rows = wanted_rows.as_ref().map_or(all, |rows| rows[input].clone());
                        let wanted = [wanted_frames, wanted_rows];
                        let there = there(name, group, piece);
                        let present = [0, 1].map(|axis| {
                            let place = |at: isize| {
                                at.clamp(there[axis].start as isize, there[axis].end as isize) as usize
                            };
                            place(wanted[axis].start)..place(wanted[axis].end)
                        });
                        let missing = (present[0].start as isize - wanted[0].start) as usize;
                        let row = present[1].start;
                        Read { view: part(name, &there, present), missing, row }
                    })
                })
                .collect();
            let first = reads[0].expect("every operation reads its first input");
            // Frames of a tensor that stands before the result, where offsets reach back to `earliest` frames.
            let lead = |input: usize, earliest: Option<i32>| {
                let missing = reads.get(input).copied().flatten().map_or(0, |read| read.missing);
                earliest.map_or(0, |offset| offset.min(0).unsigned_abs() as usize) - missing
            };
            let inputs: Vec<View> = reads.iter().map(|read| read.unwrap_or(first).view).collect();
            let first = Read { view: inputs[0], ..first };
            let convolution = |conv: &Convolution, direction: Direction| {
                let transposed = direction == Direction::Transposed;
                let [padding_t, padding_y, padding_x] = conv.padding(transposed);
                // Padding is in front of the rows that are there.
                let padding_y = if transposed {
                    padding_y + rows.start - first.row * conv.stride[1]
                } else {
                    padding_y + first.row - rows.start * conv.stride[1]
                };
                Kernel::Convolution(Arc::new(ConvolutionStep {
                    direction,
                    kernel: conv.kernel,
                    stride: conv.stride,
                    padding: [if transposed { padding_t } else { first.missing }, padding_y, padding_x],
                    in_channels: first.view.shape.c,
                    out_channels: conv.out_channels,
                    activation: conv.activation,
                    layer: Arc::clone(&model.layers[&node.name]),
                }))
            };
            let mut first_frame = frames.start;
            let kernel = match &node.op {
                Op::BoxEstimate => Kernel::BoxEstimate,
                Op::LogIrradiance => Kernel::LogIrradiance,
                Op::Features { channels, neighbours, block } => {
                    first_frame *= block[0];
                    let now = channels.iter().map(|&feature| Channel { feature, offset: 0 });
                    let others =
                        neighbours.iter().map(|&offset| Channel { feature: Feature::LogIrradiance, offset });
                    Kernel::Features {
                        channels: now.chain(others).collect(),
                        block: *block,
                        lead: lead(2, neighbours.iter().min().copied()),
                    }
                }
                Op::Conv3d(conv) => convolution(conv, Direction::Forward),
                Op::ConvTranspose3d(conv) => convolution(conv, Direction::Transposed),
                Op::InverseResponse { exposures } => Kernel::InverseResponse { exposures: exposures.clone() },
                Op::Fuse => Kernel::Fuse,
                Op::Blend { block, taps } => Kernel::Blend {
                    block: *block,
                    taps: Arc::clone(&taps_of[node.name.as_str()]),
                    origin: [lead(1, taps.iter().map(|tap| tap[0]).min()), rows.start],
                },
                Op::Concat => unreachable!("returned above"),
            };
            debug_assert!(inputs.iter().all(|input| input.slot != output.slot), "{}", node.name);
            vec![Step { name: node.name.clone(), kernel, inputs, output, first_frame }]
        };
        let carry = |name: &str| {
            let count = *news.as_ref()?.carried.get(name)?;
            let all = view(name);
            let written = all.frames(all.shape.t - count, count);
            let wanted = all.frames(all.shape.t - graph.window.hop - count, count);
            let kept =
                kept.get(name).map(|&Kept { slot, stride }| View { slot, offset: 0, stride, ..written });
            Some(Carry { written, kept, wanted })
        };
        let lower = |computed: &HashMap<&str, Range<usize>>| {
            let (mut steps, mut runs) = (Vec::new(), Vec::new());
            for group in groups {
                let mut pieces = Vec::new();
                let nodes = graph.nodes[group.nodes.clone()].iter();
                let nodes = nodes.filter(|node| computed.contains_key(node.name.as_str()));
                for piece in group.pieces() {
                    let first = steps.len();
                    steps.extend(nodes.clone().flat_map(|node| step(node, group, &piece, computed)));
                    if first < steps.len() {
                        pieces.push(first..steps.len());
                    }
                }
                let inner = group.inner.iter().map(|&name| &tensors[allocations[name].tensor.0]);
                let inner = inner.map(|tensor| (tensor.slot, tensor.len)).collect();
                let carries = nodes.filter_map(|node| carry(&node.name)).collect();
                runs.push(Run { pieces, inner, carries });
            }
            (steps, runs)
        };
        let (steps, runs) = lower(needed);
        let following = news.as_ref().map(|news| lower(&news.computed));
        let following = following.map(|(steps, runs)| Following { steps, runs });
        let mut result = view(&graph.output);
        let first = needed[graph.output.as_str()].start;
        if covers_window && result.shape.c == 1 {
            result = result.frames(graph.window.lead - first, graph.window.hop);
        }
        Ok(Self {
            name: graph.name.clone(),
            steps,
            runs,
            following,
            tensors: tensors.clone(),
            slots: slots.clone(),
            measurement: view(MEASUREMENT),
            result,
            window: graph.window,
        })
    }

    /// Values in each slot that [`Plan::lower`], [`Plan::in_pieces`] or [`Plan::streaming`] would plan for, without the many
    /// steps of large frames; and whether windows that follow each other would compute only what is new.
    pub fn slots_of(
        model: &Model,
        height: usize,
        width: usize,
        piece_bytes: usize,
        streams: bool,
    ) -> Result<(Vec<usize>, bool), NetworkError> {
        check_size(&model.graph, height, width)?;
        let arrangement = Arrangement::new(&model.graph, height, width, piece_bytes, streams)?;
        Ok((arrangement.slots, arrangement.news.is_some()))
    }

    /// Operations of all convolutions, two per multiplication and addition, for one window: one of many, where the plan is
    /// for streams.
    pub fn flop(&self) -> f64 {
        self.usual_steps().iter().map(Step::flop).sum()
    }

    /// The steps of most windows: of one that follows another one, where the plan is for streams.
    pub fn usual_steps(&self) -> &[Step] {
        self.following.as_ref().map_or(&self.steps, |following| &following.steps)
    }

    /// Bytes of all slots with `bytes` per value.
    pub fn slot_bytes(&self, bytes: usize) -> usize {
        self.slots.iter().sum::<usize>() * bytes
    }
}

impl Step {
    /// Schedule time at which the output of a kernel on pixels begins, in a window that begins at `window`.
    pub fn schedule(&self, window: i64) -> i64 {
        window.wrapping_add(self.first_frame as i64)
    }

    /// Operations of the convolution, two per multiplication and addition; 0 for other kernels.
    pub fn flop(&self) -> f64 {
        let Some(conv) = self.kernel.convolution() else { return 0.0 };
        let pixels = match conv.direction {
            Direction::Forward => self.output.shape.pixels(),
            Direction::Transposed => self.inputs[0].shape.pixels(),
        };
        let taps: usize = conv.kernel.iter().product();
        2.0 * pixels as f64 * (taps * conv.in_channels * conv.out_channels) as f64
    }
}

fn check_size(graph: &Graph, height: usize, width: usize) -> Result<(), NetworkError> {
    let [_, gy, gx] = graph.granularity()?;
    if height == 0 || width == 0 || !height.is_multiple_of(gy) || !width.is_multiple_of(gx) {
        return Err(NetworkError::Graph(
            graph.name.clone(),
            format!("a window of {height}×{width} pixels is not a multiple of {gy}×{gx}"),
        ));
    }
    Ok(())
}

/// The tensors that are f32 at any precision (design §7). f16 is for what lies between two convolutions and no further:
///
/// - what is no convolution's result: irradiance, its logarithms, and the features that everything is computed from;
/// - what is no convolution's input: the result, and what the kernels behind a net make of its last layers;
/// - what residuals are added to, and the sums: this trunk runs through all of a net, and would be rounded at each sum.
///
/// The tensors of a concatenation are stored alike, since they lie side by side.
pub(super) fn full_precision(graph: &Graph) -> HashSet<&str> {
    let mut full = HashSet::from([MEASUREMENT, graph.output.as_str()]);
    for node in &graph.nodes {
        let name = node.name.as_str();
        match (node.convolution(), &node.op) {
            (Some(conv), _) => {
                if let Some(added) = &conv.add {
                    full.extend([added.as_str(), name]);
                }
            }
            (None, Op::Concat) => {}
            (None, _) => full.extend(node.tensors().map(String::as_str).chain([name])),
        }
    }
    loop {
        let before = full.len();
        for concat in graph.nodes.iter().filter(|node| matches!(node.op, Op::Concat)) {
            let alike = || concat.tensors().chain([&concat.name]).map(String::as_str);
            if alike().any(|name| full.contains(name)) {
                full.extend(alike());
            }
        }
        if full.len() == before {
            return full;
        }
    }
}

/// The steps that copy into a concatenation what is not written there straight away: 1×1×1 convolutions with
/// the identity, which are exact at any precision.
fn copies(concat: &Node, whole: View, view: impl Fn(&str) -> View) -> Vec<Step> {
    let copy = |(name, input, output): (&String, View, View)| {
        let c = input.shape.c;
        let weight = (0..c * c).map(|i| if i % (c + 1) == 0 { 1.0 } else { 0.0 }).collect();
        let kernel = Kernel::Convolution(Arc::new(ConvolutionStep {
            direction: Direction::Forward,
            kernel: [1; 3],
            stride: [1; 3],
            padding: [0; 3],
            in_channels: c,
            out_channels: c,
            activation: Activation::None,
            layer: Arc::new(Layer { weight, bias: vec![0.0; c], norm: None }),
        }));
        let name = format!("{name} in {}", concat.name);
        Step { name, kernel, inputs: vec![input], output, first_frame: 0 }
    };
    parts_to_copy(concat, whole, view).into_iter().map(copy).collect()
}

/// The tensors that have to be copied into a concatenation, where they lie, and where they go.
fn parts_to_copy(concat: &Node, whole: View, view: impl Fn(&str) -> View) -> Vec<(&String, View, View)> {
    let mut channel = 0;
    let mut parts = Vec::new();
    for name in &concat.inputs {
        let input = view(name);
        let output = View { offset: whole.offset + channel, shape: input.shape, ..whole };
        channel += input.shape.c;
        if input != output {
            parts.push((name, input, output));
        }
    }
    parts
}

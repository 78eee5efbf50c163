//! The layer graph: which operations a net consists of, as data (`weights-format/README.md`).

use std::collections::{HashMap, HashSet};
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::{NetworkError, Shape};
use crate::math::lcm;

/// Name of the tensor that every graph is given.
pub(super) const MEASUREMENT: &str = "measurement";

/// Bounds on what a file may declare, far above any useful net: they keep a hostile file from asking for
/// absurd amounts of memory or time.
const MAX_NODES: usize = 1024;
const MAX_CHANNELS: usize = 8192;
const MAX_EXTENT: usize = 64;
const MAX_FRAMES: usize = 256;
/// Values of one tensor, far more than any memory holds: sums of them do not overflow.
const MAX_VALUES: usize = 1 << 50;

/// A net as data: nodes in the order in which they are computed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Graph {
    /// Version of the format: 1.
    pub version: u32,
    /// Name of the preset.
    pub name: String,
    /// Name of the pattern that the net was made for, or `any`.
    pub pattern: String,
    /// How much the net sees at once.
    pub window: Window,
    /// The operations.
    pub nodes: Vec<Node>,
    /// Name of the node that is the result.
    pub output: String,
}

/// How much of the video a net sees at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// Frames that the net sees.
    pub frames: usize,
    /// Frames before the first result frame.
    pub lead: usize,
    /// Result frames, and how far the next window lies behind this one.
    pub hop: usize,
}

/// One operation with its name and inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Unique name.
    pub name: String,
    /// What is done.
    #[serde(flatten)]
    pub op: Op,
    /// Names of the tensors that go in.
    pub inputs: Vec<String>,
}

/// Extents of a block that is folded into channels: frames, rows, columns.
pub type Block = [usize; 3];

/// The operations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "op", rename_all = "snake_case")]
pub enum Op {
    /// The box filter of design §4.
    BoxEstimate,
    /// l(R⁻¹(y)/e) of every pixel.
    LogIrradiance,
    /// Input normalisation, and folding of blocks into channels: measurement, estimate (, log irradiance).
    Features {
        /// Channels per pixel.
        channels: Vec<Feature>,
        /// Behind them, the log irradiance of the same pixel this many frames later (before, if negative); 0
        /// outside of the window.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        neighbours: Vec<i32>,
        /// Block that is folded.
        block: Block,
    },
    /// Convolution with its epilogue.
    Conv3d(Convolution),
    /// Transposed convolution with its epilogue.
    ConvTranspose3d(Convolution),
    /// Channels one behind the other.
    Concat,
    /// Rendered pixel values to irradiance (eq. 22).
    InverseResponse {
        /// Exposure of each channel, in frames.
        exposures: Vec<f32>,
    },
    /// Weighted fusion (eq. 23).
    Fuse,
    /// Predicted kernels: weights w and a residual d for each pixel, log irradiance, estimate → the radiance whose
    /// log is l(estimate) + Σ w·(log irradiance of the tap − l(estimate)) + d.
    Blend {
        /// Block that is unfolded; it spans one frame.
        block: Block,
        /// Pixels, as offsets t, y, x from the result's, that the weights are for. Those outside do not count.
        taps: Vec<Tap>,
    },
}

/// An offset in frames, rows and columns.
pub type Tap = [i32; 3];

impl Op {
    /// Whether the result has one value a pixel and is stored densely.
    pub(super) fn is_video(&self) -> bool {
        matches!(self, Self::BoxEstimate | Self::LogIrradiance | Self::Fuse | Self::Blend { .. })
    }
}

/// A channel that [`Op::Features`] computes from a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// y.
    Measurement,
    /// l(R⁻¹(y)/e).
    LogIrradiance,
    /// l of the estimate.
    LogEstimate,
    /// 1 where y is saturated.
    Saturated,
    /// log2 e.
    LogExposure,
}

/// Which way a convolution goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Result o is the sum over inputs o·stride − padding + tap.
    Forward,
    /// Input i adds to results i·stride − padding + tap.
    Transposed,
}

/// Parameters of a convolution and its epilogue.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Convolution {
    /// Output channels.
    pub out_channels: usize,
    /// Taps along t, y, x.
    pub kernel: [usize; 3],
    /// Steps along t, y, x.
    pub stride: [usize; 3],
    /// Applied to the sum and bias.
    pub activation: Activation,
    /// Whether a per-channel scale and shift follows the activation.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub norm: bool,
    /// Node that is added last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub add: Option<String>,
}

/// Activation functions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// v.
    None,
    /// v, or slope·v below zero.
    LeakyRelu(f32),
    /// 1/(1 + e⁻ᵛ).
    Sigmoid,
    /// ln(1 + eᵛ) plus a floor.
    Softplus(f32),
}

impl Graph {
    /// Reads a graph from JSON and checks it.
    pub fn from_json(json: &str) -> Result<Self, NetworkError> {
        let graph: Self =
            serde_json::from_str(json).map_err(|e| NetworkError::Format(format!("layer graph: {e}")))?;
        graph.check()?;
        Ok(graph)
    }

    fn check(&self) -> Result<(), NetworkError> {
        let fail = |problem: String| Err(NetworkError::Graph(self.name.clone(), problem));
        let Window { frames, lead, hop } = self.window;
        if self.version != 1 {
            return fail(format!("version {} is not supported (this program reads 1)", self.version));
        }
        if hop == 0 || frames > MAX_FRAMES || lead > frames || hop > frames - lead {
            return fail(format!("window of {frames} frames cannot give {hop} from frame {lead}"));
        }
        if self.nodes.len() > MAX_NODES {
            return fail(format!("{} nodes, more than {MAX_NODES}", self.nodes.len()));
        }
        let [_, y, x] = self.granularity()?;
        self.shapes(y, x).map(drop)
    }

    /// Extents t, y, x of which a window must be a multiple.
    pub fn granularity(&self) -> Result<[usize; 3], NetworkError> {
        // How many measurement pixels one pixel of each node spans.
        let mut spans: HashMap<&str, [usize; 3]> = HashMap::from([(MEASUREMENT, [1; 3])]);
        let mut largest = [1; 3];
        for node in &self.nodes {
            let inputs: Vec<_> =
                node.inputs.iter().map(|name| spans.get(name.as_str()).copied().unwrap_or([1; 3])).collect();
            let span = inputs.first().copied().unwrap_or([1; 3]);
            let span: [usize; 3] = match &node.op {
                Op::Features { block, .. } => *block,
                Op::Conv3d(conv) => std::array::from_fn(|i| span[i] * conv.stride[i].min(MAX_EXTENT)),
                Op::ConvTranspose3d(conv) => std::array::from_fn(|i| span[i] / conv.stride[i].max(1)),
                op if op.is_video() && !matches!(op, Op::Fuse) => [1; 3],
                _ => span,
            };
            if span.iter().any(|&s| s > MAX_EXTENT) {
                return Err(node.fail(format!("spans {span:?} pixels, more than {MAX_EXTENT}")));
            }
            largest = std::array::from_fn(|i| lcm(largest[i], span[i].max(1)));
            if largest.iter().any(|&s| s > 16 * MAX_EXTENT) {
                let problem = format!("granularity {largest:?} is too coarse");
                return Err(NetworkError::Graph(self.name.clone(), problem));
            }
            spans.insert(&node.name, span);
        }
        Ok(largest)
    }

    /// Pixels beyond its own that the output depends on, to each side along t, y, x: the halo that a tile needs
    /// to give the same result as the whole.
    pub fn reach(&self) -> Result<[usize; 3], NetworkError> {
        self.granularity()?;
        // Span and reach of each node, in measurement pixels.
        let mut known: HashMap<&str, ([usize; 3], [usize; 3])> =
            HashMap::from([(MEASUREMENT, ([1; 3], [0; 3]))]);
        for node in &self.nodes {
            let first = node.inputs.first().map_or(MEASUREMENT, String::as_str);
            let (span, _) = known.get(first).copied().unwrap_or(([1; 3], [0; 3]));
            // The span of the result, and how much further it reaches than each of the first inputs; others
            // it reads in place.
            let mut more = [[0; 3]; 3];
            let furthest = |offsets: &mut dyn Iterator<Item = i32>| {
                offsets.map(i32::unsigned_abs).max().unwrap_or(0) as usize
            };
            let span: [usize; 3] = match &node.op {
                Op::BoxEstimate => {
                    more[0] = [0, 1, 1];
                    span
                }
                Op::Features { neighbours, block, .. } => {
                    more[2][0] = furthest(&mut neighbours.iter().copied());
                    *block
                }
                Op::Conv3d(conv) => {
                    let padding = conv.padding(false);
                    more[0] = std::array::from_fn(|i| padding[i] * span[i]);
                    std::array::from_fn(|i| span[i] * conv.stride[i])
                }
                Op::ConvTranspose3d(conv) => {
                    if (0..3).any(|i| !span[i].is_multiple_of(conv.stride[i])) {
                        return Err(node.fail("is finer than the pixels, so its reach is not known".into()));
                    }
                    let fine: [usize; 3] = std::array::from_fn(|i| span[i] / conv.stride[i]);
                    more[0] = std::array::from_fn(|i| conv.transposed_reach(i) * fine[i]);
                    fine
                }
                Op::Blend { taps, .. } => {
                    more[1] = std::array::from_fn(|i| furthest(&mut taps.iter().map(|tap| tap[i])));
                    [1; 3]
                }
                Op::LogIrradiance | Op::Concat | Op::InverseResponse { .. } | Op::Fuse => span,
            };
            let reach = node.tensors().zip(more.into_iter().chain(std::iter::repeat([0; 3])));
            let reach = reach.fold([0; 3], |reach: [usize; 3], (input, more)| {
                let (_, before) = known.get(input.as_str()).copied().unwrap_or_default();
                std::array::from_fn(|i| reach[i].max(before[i] + more[i]))
            });
            known.insert(&node.name, (span, reach));
        }
        Ok(known.get(self.output.as_str()).map_or([0; 3], |(_, reach)| *reach))
    }

    /// Shapes of all tensors for measurements of `height` × `width` pixels, in the order of the nodes and with
    /// the measurement first.
    pub fn shapes(&self, height: usize, width: usize) -> Result<HashMap<&str, Shape>, NetworkError> {
        let measurement = Shape { t: self.window.frames, y: height, x: width, c: 1 };
        let mut shapes: HashMap<&str, Shape> = HashMap::from([(MEASUREMENT, measurement)]);
        // Tensors of one value a pixel are stored densely and feed the operations on pixels; all others feed
        // convolutions.
        let mut scalar: HashSet<&str> = HashSet::from([MEASUREMENT]);
        for node in &self.nodes {
            let mut inputs = Vec::with_capacity(node.inputs.len());
            for (i, name) in node.inputs.iter().enumerate() {
                let &shape = shapes
                    .get(name.as_str())
                    .ok_or_else(|| node.fail(format!("no tensor '{name}' before it")))?;
                let wants_scalar = match &node.op {
                    Op::BoxEstimate | Op::LogIrradiance | Op::Features { .. } => true,
                    Op::Blend { .. } => i > 0,
                    _ => false,
                };
                if wants_scalar != scalar.contains(name.as_str()) {
                    let kind = if wants_scalar { "one value a pixel" } else { "feature channels" };
                    return Err(node.fail(format!("input '{name}' does not hold {kind}")));
                }
                inputs.push(shape);
            }
            let shape = node.shape(&inputs, measurement, |name| shapes.get(name).copied())?;
            if node.op.is_video() {
                scalar.insert(&node.name);
            }
            if shapes.insert(&node.name, shape).is_some() {
                return Err(node.fail("the name is used twice".into()));
            }
        }
        if !shapes.contains_key(self.output.as_str()) || self.output == MEASUREMENT {
            return Err(NetworkError::Graph(
                self.name.clone(),
                format!("no node '{}' for the output", self.output),
            ));
        }
        Ok(shapes)
    }
}

impl Graph {
    /// Frames of each tensor that the result depends on. Tensors that no other node reads count as results, all of their
    /// frames; tensors that none of these depend on are left out.
    ///
    /// `shapes` are those of [`Graph::shapes`].
    pub(super) fn needed_frames<'a>(
        &'a self,
        shapes: &HashMap<&'a str, Shape>,
    ) -> HashMap<&'a str, Range<usize>> {
        let Window { frames, lead, hop } = self.window;
        let output = shapes[self.output.as_str()];
        let result = if output.t == frames { lead..lead + hop } else { 0..output.t };
        let unread = |name: &str| !self.nodes.iter().any(|node| node.tensors().any(|read| read == name));
        let ends = self.nodes.iter().map(|node| node.name.as_str()).filter(|&name| unread(name));
        let mut needed: HashMap<&str, Range<usize>> = ends.map(|name| (name, 0..shapes[name].t)).collect();
        needed.insert(&self.output, result);
        for node in self.nodes.iter().rev() {
            let Some(range) = needed.get(node.name.as_str()).cloned() else { continue };
            let range = node.computes(range, shapes[node.name.as_str()].t);
            needed.insert(&node.name, range.clone());
            for (name, frames) in
                node.tensors().zip(node.reads(range)).filter(|(_, frames)| !frames.is_empty())
            {
                let last = shapes[name.as_str()].t as isize;
                let [start, end] = [frames.start, frames.end].map(|t| t.clamp(0, last) as usize);
                let known = needed.entry(name).or_insert(start..end);
                *known = known.start.min(start)..known.end.max(end);
            }
        }
        needed
    }

    /// Checks that the graph's output is a video: one value a pixel, for the result frames or the whole window.
    pub fn check_renders_video(&self) -> Result<(), NetworkError> {
        let [_, y, x] = self.granularity()?;
        let output = self.shapes(y, x)?[self.output.as_str()];
        let frames = [self.window.frames, self.window.hop];
        if output.y != y || output.x != x || output.c != 1 || !frames.contains(&output.t) {
            return Err(NetworkError::Graph(
                self.name.clone(),
                format!("output is {output}, not a video of {} or {} frames", frames[0], frames[1]),
            ));
        }
        Ok(())
    }
}

impl Node {
    pub(super) fn fail(&self, problem: String) -> NetworkError {
        NetworkError::Node { node: self.name.clone(), problem }
    }

    /// Frames that this node computes so as to give frames `range` of its `all`: those, but a transposed convolution
    /// in time is not cut.
    fn computes(&self, range: Range<usize>, all: usize) -> Range<usize> {
        let whole = matches!(&self.op, Op::ConvTranspose3d(conv) if conv.kernel[0] > 1);
        if whole { 0..all } else { range }
    }

    /// Frames of each tensor in [`Node::tensors`] that frames `range` of this node, as it computes them, depend on. They
    /// may lie outside of the tensor, in its padding; none are read of one with an empty range.
    pub(super) fn reads(&self, range: Range<usize>) -> Vec<Range<isize>> {
        let (start, end) = (range.start as isize, range.end as isize);
        let same = start..end;
        match &self.op {
            Op::Features { channels, neighbours, block } => {
                let (start, end) = (start * block[0] as isize, end * block[0] as isize);
                let offsets = || neighbours.iter().map(|&offset| offset as isize).chain([0]);
                let [first, last] = [offsets().min(), offsets().max()].map(Option::unwrap_or_default);
                let estimate = if channels.contains(&Feature::LogEstimate) { start..end } else { 0..0 };
                vec![start..end, estimate, start + first..end + last]
            }
            Op::Conv3d(conv) => {
                let [stride, kernel] = [conv.stride[0] as isize, conv.kernel[0] as isize];
                let first = |t: isize| t * stride - conv.padding(false)[0] as isize;
                vec![first(start)..first(end - 1) + kernel, same]
            }
            Op::ConvTranspose3d(conv) => vec![start..end / conv.stride[0] as isize, same],
            Op::Blend { taps, .. } => {
                let offsets = || taps.iter().map(|tap| tap[0] as isize).chain([0]);
                let [first, last] = [offsets().min(), offsets().max()].map(Option::unwrap_or_default);
                vec![same.clone(), start + first..end + last, same]
            }
            _ => vec![same; self.inputs.len()],
        }
    }

    /// Rows of each tensor in [`Node::tensors`] that rows `range` of one frame of this node depend on, as
    /// [`Node::reads`] for frames. `None` if they do not follow from rows of one frame, wherever those lie.
    pub(super) fn reads_rows(&self, range: Range<usize>) -> Option<Vec<Range<isize>>> {
        let (start, end) = (range.start as isize, range.end as isize);
        let same = start..end;
        match &self.op {
            Op::Conv3d(conv) if conv.kernel[0] == 1 => {
                let [stride, kernel] = [conv.stride[1] as isize, conv.kernel[1] as isize];
                let first = |y: isize| y * stride - conv.padding(false)[1] as isize;
                Some(vec![first(start)..first(end - 1) + kernel, same])
            }
            Op::ConvTranspose3d(conv) if conv.kernel[0] == 1 => {
                let [stride, kernel] = [conv.stride[1] as isize, conv.kernel[1] as isize];
                let padding = conv.padding(true)[1] as isize;
                // Input i adds to the results o = i·stride − padding + k.
                let last = (start + padding).div_euclid(stride);
                let first = last.min((start + padding - kernel).div_euclid(stride) + 1);
                Some(vec![first..(end - 1 + padding).div_euclid(stride) + 1, same])
            }
            // Its taps find their rows by themselves.
            Op::Blend { block, .. } => {
                let block = block[1] as isize;
                Some(vec![start / block..end / block, isize::MIN..isize::MAX, same])
            }
            Op::InverseResponse { .. } | Op::Fuse => Some(vec![same; self.inputs.len()]),
            _ => None,
        }
    }

    /// Names of all tensors that the node reads: its inputs, and what it adds.
    pub fn tensors(&self) -> impl Iterator<Item = &String> {
        self.inputs.iter().chain(self.convolution().and_then(|conv| conv.add.as_ref()))
    }

    /// The convolution of this node, if it is one.
    pub fn convolution(&self) -> Option<&Convolution> {
        match &self.op {
            Op::Conv3d(conv) | Op::ConvTranspose3d(conv) => Some(conv),
            _ => None,
        }
    }

    fn shape<'a>(
        &'a self,
        inputs: &[Shape],
        measurement: Shape,
        lookup: impl Fn(&'a str) -> Option<Shape>,
    ) -> Result<Shape, NetworkError> {
        let arity = |n: usize| {
            if inputs.len() == n {
                Ok(())
            } else {
                Err(self.fail(format!("wants {n} inputs, has {}", inputs.len())))
            }
        };
        let shape = match &self.op {
            Op::BoxEstimate | Op::LogIrradiance => {
                arity(1)?;
                inputs[0]
            }
            Op::Features { channels, neighbours, block } => {
                arity(if inputs.len() == 3 { 3 } else { 2 })?;
                if inputs.iter().any(|&s| s != measurement) {
                    return Err(self.fail("its inputs must have the measurement's size".into()));
                }
                if inputs.len() < 3 && !neighbours.is_empty() {
                    return Err(self.fail("neighbours are those of a third input, log irradiance".into()));
                }
                let per_pixel = channels.len() + neighbours.len();
                if channels.is_empty() || per_pixel > 16 {
                    return Err(self.fail(format!("{per_pixel} channels a pixel")));
                }
                if neighbours.iter().any(|offset| offset.unsigned_abs() as usize > MAX_FRAMES) {
                    return Err(self.fail(format!("neighbours {neighbours:?}")));
                }
                if !block.iter().all(|b| (1..=MAX_EXTENT).contains(b)) {
                    return Err(self.fail(format!("block {block:?}")));
                }
                let extent = measurement.extent();
                if (0..3).any(|i| !extent[i].is_multiple_of(block[i])) {
                    return Err(self.fail(format!("block {block:?} does not divide {measurement}")));
                }
                Shape::new(
                    std::array::from_fn(|i| extent[i] / block[i]),
                    per_pixel * block.iter().product::<usize>(),
                )
            }
            Op::Conv3d(conv) | Op::ConvTranspose3d(conv) => {
                arity(1)?;
                let transposed = matches!(self.op, Op::ConvTranspose3d(_));
                let shape = conv.shape(inputs[0], transposed).map_err(|problem| self.fail(problem))?;
                if let Some(add) = &conv.add {
                    match lookup(add) {
                        Some(added) if added == shape => {}
                        Some(added) => return Err(self.fail(format!("adds '{add}' of {added} to {shape}"))),
                        None => return Err(self.fail(format!("no tensor '{add}' before it"))),
                    }
                }
                shape
            }
            Op::Concat => {
                let [first, .., _] = inputs else {
                    return Err(self.fail("wants two inputs or more".into()));
                };
                if inputs.iter().any(|s| s.extent() != first.extent()) {
                    return Err(self.fail("its inputs differ in extent".into()));
                }
                if inputs[..inputs.len() - 1].iter().any(|s| s.c % 4 != 0) {
                    return Err(self.fail("all inputs but the last need a multiple of 4 channels".into()));
                }
                Shape { c: inputs.iter().map(|s| s.c).sum(), ..*first }
            }
            Op::InverseResponse { exposures } => {
                arity(1)?;
                if exposures.len() != inputs[0].c || !exposures.iter().all(|e| e.is_finite() && *e > 0.0) {
                    return Err(self.fail(format!("exposures {exposures:?} for {} channels", inputs[0].c)));
                }
                Shape { c: 2 * inputs[0].c, ..inputs[0] }
            }
            Op::Fuse => {
                arity(2)?;
                let [weights, rendered] = inputs else { unreachable!("two inputs") };
                if weights.extent() != rendered.extent() || 2 * weights.c != rendered.c {
                    return Err(self.fail(format!("weights {weights} do not fit {rendered}")));
                }
                Shape { c: 1, ..*weights }
            }
            Op::Blend { block, taps } => {
                arity(3)?;
                let [weights, logs, estimate] = inputs else { unreachable!("three inputs") };
                let per_pixel = taps.len() + 1;
                if block[0] != 1
                    || !block.iter().all(|b| (1..=MAX_EXTENT).contains(b))
                    || block.iter().product::<usize>() * per_pixel != weights.c
                {
                    return Err(self.fail(format!("block {block:?} for {} channels", weights.c)));
                }
                if taps.iter().flatten().any(|offset| offset.unsigned_abs() as usize > MAX_EXTENT) {
                    return Err(self.fail(format!("taps {taps:?}")));
                }
                let extent = weights.extent();
                let shape = Shape::new(std::array::from_fn(|i| extent[i] * block[i]), 1);
                if [logs, estimate].iter().any(|input| **input != shape) {
                    return Err(self.fail(format!("{shape} does not fit {logs} and {estimate}")));
                }
                shape
            }
        };
        if shape.c > MAX_CHANNELS {
            return Err(self.fail(format!("{} channels, more than {MAX_CHANNELS}", shape.c)));
        }
        let values = shape.extent().iter().try_fold(shape.c, |values, &extent| values.checked_mul(extent));
        if values.is_none_or(|values| values > MAX_VALUES) {
            return Err(self.fail(format!("{shape} are too many values")));
        }
        Ok(shape)
    }
}

impl Convolution {
    /// Shape of the result for an input of `input`.
    pub fn shape(&self, input: Shape, transposed: bool) -> Result<Shape, String> {
        let Self { kernel, stride, out_channels, .. } = self;
        if *out_channels == 0 || *out_channels > MAX_CHANNELS {
            return Err(format!("{out_channels} output channels"));
        }
        for axis in 0..3 {
            let (k, s) = (kernel[axis], stride[axis]);
            let fits = if transposed { k >= s && (k - s) % 2 == 0 } else { k % 2 == 1 };
            if k == 0 || k > 15 || s == 0 || s > 4 || !fits {
                return Err(format!("kernel {kernel:?} with stride {stride:?}"));
            }
        }
        if let Activation::LeakyRelu(number) | Activation::Softplus(number) = self.activation
            && !number.is_finite()
        {
            return Err(format!("an activation with {number}"));
        }
        let extent = input.extent();
        let out = |axis: usize| {
            if transposed {
                extent[axis].saturating_mul(stride[axis])
            } else {
                extent[axis].div_ceil(stride[axis])
            }
        };
        Ok(Shape::new(std::array::from_fn(out), *out_channels))
    }

    /// Zero padding in front along t, y, x.
    pub fn padding(&self, transposed: bool) -> [usize; 3] {
        std::array::from_fn(|i| {
            if transposed { (self.kernel[i] - self.stride[i]) / 2 } else { (self.kernel[i] - 1) / 2 }
        })
    }

    /// Results beyond its own, along an axis, in whose place stand the inputs that a result of the transposed
    /// convolution depends on.
    fn transposed_reach(&self, axis: usize) -> usize {
        let [kernel, stride, padding] =
            [self.kernel[axis], self.stride[axis], self.padding(true)[axis]].map(|n| n as isize);
        // Result r sums input i = (r + padding − tap)/stride, which stands in place of stride results from i·stride on.
        let reach = |r: isize, tap: isize| {
            let first = r + padding - tap;
            (first % stride == 0).then(|| (r - first).max(first + stride - 1 - r))
        };
        let all = (0..stride).flat_map(|r| (0..kernel).filter_map(move |tap| reach(r, tap)));
        all.max().unwrap_or(0).max(0) as usize
    }

    /// Number of taps.
    pub fn taps(&self) -> usize {
        self.kernel.iter().product()
    }
}

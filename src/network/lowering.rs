//! Lowering: how a model becomes the steps of a plan.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::sync::Arc;

use super::error::NetworkError;
use super::graph::{FRAMES, Graph, MEASUREMENT, Node, ROWS};
use super::kernel::{Activation, ConvolutionStep, Direction, Layer};
use super::model::Model;
use super::op::Kernel;
use super::op::operation::Parts;
use super::op::relation::Relation;
use super::pieces::{Group, Piece};
use super::plan::{Carry, Following, Footprint, Plan, Run, Step, TensorId, View};
use super::slots::{Allocation, Arrangement, indices};
use super::tensor::Shape;

/// Most weights of the convolutions that copy, which a file of a few bytes can ask for.
const MAX_IDENTITIES: usize = 1 << 24;

impl Plan {
    /// Lowers `model` for windows of `height` × `width` pixels, which must be multiples of the granularity.
    pub fn lower(model: &Model, height: usize, width: usize) -> Result<Self, NetworkError> {
        Self::in_pieces(model, height, width, usize::MAX)
    }

    /// As [`Plan::in_pieces`], for windows that mostly follow each other: where the net's frames do not depend on the
    /// window, what a window has computed stays known for the following one.
    pub fn streaming(model: &Model, height: usize, width: usize, bytes: usize) -> Result<Self, NetworkError> {
        check_size(&model.graph, height, width)?;
        Ok(Lowering::new(model, height, width, bytes, true)?.plan())
    }

    /// As [`Plan::lower`], with several steps for a node where neighbouring nodes are computed piece by piece, so that what
    /// one leaves for the next one takes about `bytes`, at 4 a value, but at least a frame, or a few rows where those can be
    /// computed by themselves. Results are the same.
    pub fn in_pieces(model: &Model, height: usize, width: usize, bytes: usize) -> Result<Self, NetworkError> {
        check_size(&model.graph, height, width)?;
        Ok(Lowering::new(model, height, width, bytes, false)?.plan())
    }

    /// As [`Plan::lower`], for any size that the operations accept: single operations, such as a strided
    /// convolution, are defined on odd sizes too.
    pub fn lower_unaligned(model: &Model, height: usize, width: usize) -> Result<Self, NetworkError> {
        Ok(Lowering::new(model, height, width, usize::MAX, false)?.plan())
    }

    /// What memory a plan of [`Plan::lower`], [`Plan::in_pieces`] or [`Plan::streaming`] would take, without the many steps
    /// of large frames.
    pub fn footprint(
        model: &Model,
        height: usize,
        width: usize,
        piece_bytes: usize,
        streams: bool,
    ) -> Result<Footprint, NetworkError> {
        check_size(&model.graph, height, width)?;
        let arrangement = Arrangement::new(&model.graph, height, width, piece_bytes, streams)?;
        let left = left(&model.graph, &arrangement);
        let state = left.iter().map(|left| left.carry.written.len()).sum();
        Ok(Footprint { state: arrangement.following.as_ref().map(|_| state), slots: arrangement.slots })
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

/// A model on its way to a plan.
pub(super) struct Lowering<'a> {
    model: &'a Model,
    arrangement: Arrangement<'a>,
    /// Number of each node.
    index_of: HashMap<&'a str, usize>,
    /// Whether the output has a frame for each one of the window.
    covers_window: bool,
    /// What a window leaves for the following one.
    left: Vec<Left>,
}

/// What a window leaves for the following one of a tensor.
struct Left {
    carry: Carry,
    /// The nodes that write the tensor, first and last.
    writers: [usize; 2],
}

/// Frames and rows of a tensor.
type Section = [Range<usize>; 2];

/// What a step reads of a tensor.
#[derive(Clone, Copy)]
struct Read {
    view: View,
    /// Where the step's results begin in the view, along t and y ([`Relation::origin`]).
    origin: [isize; 2],
}

impl<'a> Lowering<'a> {
    /// Arranges the tensors of `model` for windows of `height` × `width` pixels; see [`Plan::in_pieces`] and
    /// [`Plan::streaming`].
    pub fn new(
        model: &'a Model,
        height: usize,
        width: usize,
        piece_bytes: usize,
        streams: bool,
    ) -> Result<Self, NetworkError> {
        let graph = &model.graph;
        let arrangement = Arrangement::new(graph, height, width, piece_bytes, streams)?;
        let covers_window = graph.shapes(height, width)?[graph.output.as_str()].t == graph.window.frames;
        let left = left(graph, &arrangement);
        let lowering = Self { model, arrangement, index_of: indices(graph), covers_window, left };
        lowering.check_copies()?;
        Ok(lowering)
    }

    /// The plan.
    pub fn plan(self) -> Plan {
        let Arrangement { needed, following, .. } = &self.arrangement;
        let (steps, runs) = self.steps(needed);
        let following = following.as_ref().map(|frames| {
            let (steps, runs) = self.steps(&frames.computed);
            Following { steps, runs }
        });
        Plan {
            name: self.graph().name.clone(),
            steps,
            runs,
            following,
            measurement: self.view(MEASUREMENT),
            result: self.result(),
            window: self.graph().window,
            carries: self.left.into_iter().map(|left| left.carry).collect(),
            tensors: self.arrangement.tensors,
            slots: self.arrangement.slots,
        }
    }

    fn graph(&self) -> &'a Graph {
        &self.model.graph
    }

    /// The steps that compute the frames `computed`, in order and in runs.
    fn steps(&self, computed: &HashMap<&str, Range<usize>>) -> (Vec<Step>, Vec<Run>) {
        let mut steps = Vec::new();
        let groups = self.arrangement.groups.iter();
        let runs = groups.map(|group| self.run(group, computed, &mut steps)).collect();
        (steps, runs)
    }

    /// Adds the steps of a group of nodes to `steps`.
    fn run(&self, group: &Group<'_>, computed: &HashMap<&str, Range<usize>>, steps: &mut Vec<Step>) -> Run {
        let nodes = &self.graph().nodes[group.nodes.clone()];
        let nodes = || nodes.iter().filter(|node| computed.contains_key(node.name.as_str()));
        let mut pieces = Vec::new();
        for piece in group.pieces() {
            let first = steps.len();
            for node in nodes() {
                let all = &computed[node.name.as_str()];
                let frames = all.start.max(piece.frames.start)..all.end.min(piece.frames.end);
                if frames.is_empty() {
                    continue;
                }
                if node.is_concatenation() {
                    steps.extend(self.copies(node, &frames));
                } else {
                    steps.push(self.step(node, group, &piece, frames));
                }
            }
            if first < steps.len() {
                pieces.push(first..steps.len());
            }
        }
        let Arrangement { tensors, allocations, .. } = &self.arrangement;
        let inner = group.inner.iter().map(|&name| &tensors[allocations[name].tensor.0]);
        Run {
            pieces,
            inner: inner.map(|tensor| (tensor.slot, tensor.len)).collect(),
            restores: self.left_by(|[first, _]| group.nodes.contains(&first)),
            saves: self.left_by(|[_, last]| group.nodes.contains(&last)),
        }
    }

    /// The step that computes some `frames` of a node, and of them the rows of a piece.
    fn step(&self, node: &Node, group: &Group<'_>, piece: &Piece<'_>, frames: Range<usize>) -> Step {
        let operation = node.operation();
        let rows = piece.rows(self.index_of[node.name.as_str()]);
        let read = |(input, name): (usize, &String)| {
            let relation = operation.relation(input);
            operation.reads(input).then(|| self.read(name, relation, (&frames, rows.as_ref()), group, piece))
        };
        let reads: Vec<Option<Read>> = node.tensors().enumerate().map(read).collect();
        let first = reads[0].expect("every operation reads its first input");
        // The first input stands in for one that is not read.
        let reads: Vec<Read> = reads.into_iter().map(|read| read.unwrap_or(first)).collect();
        let origins: Vec<_> = reads.iter().map(|read| read.origin).collect();
        let inputs: Vec<_> = reads.iter().map(|read| read.view).collect();
        let layer = self.model.layers.get(&node.name);
        let parts = Parts { origins: &origins, channels: inputs[0].shape.c, layer };
        let kernel = node.op.kernel(&parts).expect("all but concatenations are computed by kernels");
        let first_frame = node.relation()[FRAMES].origin(frames.start, 0).unsigned_abs();
        let rows = rows.unwrap_or(0..self.arrangement.heights[node.name.as_str()]);
        let output = self.section(&node.name, &self.present(&node.name, group, piece), [frames, rows]);
        debug_assert!(inputs.iter().all(|input| input.slot != output.slot), "{}", node.name);
        let first_frame = if operation.sees_camera() { first_frame } else { 0 };
        Step { name: node.name.clone(), kernel, inputs, output, first_frame }
    }

    /// What results in some frames, and in some rows if it is not all of them, read of the tensor `name`.
    fn read(
        &self,
        name: &str,
        relation: [Relation; 3],
        (frames, rows): (&Range<usize>, Option<&Range<usize>>),
        group: &Group<'_>,
        piece: &Piece<'_>,
    ) -> Read {
        let present = self.present(name, group, piece);
        // What lies outside is padding.
        let there = |axis: usize, results: &Range<usize>| {
            let wanted = relation[axis].reads(results.clone());
            let Range { start, end } = present[axis];
            let inside = |at: isize| at.clamp(start as isize, end as isize) as usize;
            inside(wanted.start)..inside(wanted.end)
        };
        let read_frames = there(FRAMES, frames);
        let read_rows = match rows {
            Some(rows) if read_frames.len() == 1 => there(ROWS, rows),
            // Rows of several frames lie apart.
            _ => present[ROWS].clone(),
        };
        let origin = [
            relation[FRAMES].origin(frames.start, read_frames.start),
            relation[ROWS].origin(rows.map_or(0, |rows| rows.start), read_rows.start),
        ];
        Read { view: self.section(name, &present, [read_frames, read_rows]), origin }
    }

    /// All of a tensor that has its memory at once.
    fn view(&self, name: &str) -> View {
        let Arrangement { allocations, tensors, shapes, .. } = &self.arrangement;
        let Allocation { tensor, channel, stride } = allocations[name];
        View { tensor, slot: tensors[tensor.0].slot, offset: channel, stride, shape: shapes[name] }
    }

    /// Frames and rows of a tensor that are there while a group computes a piece.
    fn present(&self, name: &str, group: &Group<'_>, piece: &Piece<'_>) -> Section {
        let Range { start, end } = self.arrangement.needed[name].clone();
        let rows = 0..self.arrangement.heights[name];
        if !group.inner.contains(&name) {
            return [start..end, rows];
        }
        let frames = start.max(piece.frames.start)..end.min(piece.frames.end);
        [frames, piece.rows(self.index_of[name]).unwrap_or(rows)]
    }

    /// A section of a tensor of which another section is present.
    fn section(&self, name: &str, present: &Section, [frames, rows]: Section) -> View {
        let view = self.view(name);
        let whole = View { shape: Shape { y: present[ROWS].len(), ..view.shape }, ..view };
        let frames = whole.frames(frames.start - present[FRAMES].start, frames.len());
        frames.rows(rows.start - present[ROWS].start, rows.len())
    }

    /// Where the result frames are.
    fn result(&self) -> View {
        let Graph { output, window, .. } = self.graph();
        let view = self.view(output);
        if self.covers_window && view.shape.c == 1 {
            let first = self.arrangement.needed[output.as_str()].start;
            return view.frames(window.lead - first, window.hop);
        }
        view
    }

    /// Numbers of what is left of tensors whose first and last writer are such.
    fn left_by(&self, such: impl Fn([usize; 2]) -> bool) -> Vec<usize> {
        (0..self.left.len()).filter(|&index| such(self.left[index].writers)).collect()
    }

    /// The steps that copy into frames of a concatenation what is not written there straight away.
    fn copies(&self, concat: &Node, frames: &Range<usize>) -> Vec<Step> {
        let cut = |name: &str| {
            self.view(name).frames(frames.start - self.arrangement.needed[name].start, frames.len())
        };
        let copy = |(name, from, to): (&str, View, View)| Step {
            name: format!("{name} in {}", concat.name),
            kernel: identity(from.shape.c),
            inputs: vec![from],
            output: to,
            first_frame: 0,
        };
        parts_to_copy(concat, cut).into_iter().map(copy).collect()
    }

    /// A file of a few bytes must not make us write gigabytes of identities.
    fn check_copies(&self) -> Result<(), NetworkError> {
        let nodes = self.graph().nodes.iter();
        let computed = nodes.filter(|node| self.arrangement.needed.contains_key(node.name.as_str()));
        let copied = computed.filter(|node| node.is_concatenation()).flat_map(|node| {
            let parts = parts_to_copy(node, |name| self.view(name));
            parts.into_iter().map(|(_, from, _)| from.shape.c * from.shape.c)
        });
        if copied.sum::<usize>() > MAX_IDENTITIES {
            let problem = "its concatenations copy too many channels".into();
            return Err(NetworkError::Graph(self.graph().name.clone(), problem));
        }
        Ok(())
    }
}

/// What a window leaves for the following one: of each tensor the last frames that are read again.
fn left(graph: &Graph, arrangement: &Arrangement<'_>) -> Vec<Left> {
    let Arrangement { following, allocations, tensors, needed, .. } = arrangement;
    // Parts of a concatenation have as many frames as the whole.
    let mut tensors_left: BTreeMap<TensorId, (usize, usize)> = BTreeMap::new();
    for (&name, &count) in following.iter().flat_map(|frames| &frames.carried) {
        let (most, frames) = tensors_left.entry(allocations[name].tensor).or_default();
        (*most, *frames) = (count.max(*most), needed[name].len());
    }
    let left = |(tensor, (count, frames)): (TensorId, (usize, usize))| {
        let writes = |node: &Node| allocations.get(node.name.as_str()).is_some_and(|at| at.tensor == tensor);
        let writers = [graph.nodes.iter().position(writes), graph.nodes.iter().rposition(writes)];
        let frame = tensors[tensor.0].len / frames;
        let frames_from = |first: usize| first * frame..(first + count) * frame;
        let written = frames_from(frames - count);
        let wanted = frames_from(frames - graph.window.hop - count);
        let writers = writers.map(|node| node.expect("a tensor is the result of a node"));
        Left { carry: Carry { tensor, written, wanted }, writers }
    };
    tensors_left.into_iter().map(left).collect()
}

/// The inputs of a concatenation that do not lie in their place there, where they lie, and where they go.
fn parts_to_copy(concat: &Node, view: impl Fn(&str) -> View) -> Vec<(&str, View, View)> {
    let whole = view(&concat.name);
    let mut channel = 0;
    let mut parts = Vec::new();
    for name in &concat.inputs {
        let from = view(name);
        let to = View { offset: whole.offset + channel, shape: from.shape, ..whole };
        channel += from.shape.c;
        if from != to {
            parts.push((name.as_str(), from, to));
        }
    }
    parts
}

/// A 1×1×1 convolution that copies channels, which is exact at any precision.
fn identity(channels: usize) -> Kernel {
    let square = 0..channels * channels;
    let weight = square.map(|i| if i % (channels + 1) == 0 { 1.0 } else { 0.0 }).collect();
    Kernel::Conv3d(Arc::new(ConvolutionStep {
        direction: Direction::Forward,
        kernel: [1; 3],
        stride: [1; 3],
        padding: [0; 3],
        in_channels: channels,
        out_channels: channels,
        activation: Activation::None,
        layer: Arc::new(Layer { weight, bias: vec![0.0; channels], norm: None }),
    }))
}

//! Where tensors lie: which share a slot, and which frames and rows of them are there at once.

use std::collections::{HashMap, HashSet};
use std::ops::Range;

use super::error::NetworkError;
use super::following::{FollowingFrames, following_frames};
use super::graph::{Graph, MEASUREMENT, Node};
use super::op::operation::Kind;
use super::pieces::{Group, groups};
use super::plan::{PlannedTensor, TensorId};
use super::tensor::Shape;

/// Where the result of a node lies: in which tensor, from which channel on, and how many values between pixels.
#[derive(Clone, Copy)]
pub(super) struct Allocation {
    pub tensor: TensorId,
    pub channel: usize,
    pub stride: usize,
}

/// Where the result of every node of a graph lies, and what is computed of it when.
pub(super) struct Arrangement<'a> {
    /// Frames of each tensor that a window by itself computes; all of the measurement.
    pub needed: HashMap<&'a str, Range<usize>>,
    /// Extents of what is there of each tensor at once: of inner tensors of a group, the largest piece.
    pub shapes: HashMap<&'a str, Shape>,
    /// Rows of each tensor.
    pub heights: HashMap<&'a str, usize>,
    /// Nodes that are computed together.
    pub groups: Vec<Group<'a>>,
    /// Where the result of each node lies.
    pub allocations: HashMap<&'a str, Allocation>,
    /// All tensors, the measurement first.
    pub tensors: Vec<PlannedTensor>,
    /// Values in each slot.
    pub slots: Vec<usize>,
    /// What a window computes that follows another one, if that is less than the other one.
    pub following: Option<FollowingFrames<'a>>,
}

impl<'a> Arrangement<'a> {
    /// Arranges the tensors of `graph` for frames of `height` × `width` pixels and pieces of about `piece_bytes`, for
    /// windows that mostly follow each other if it is for `streams`.
    pub fn new(
        graph: &'a Graph,
        height: usize,
        width: usize,
        piece_bytes: usize,
        streams: bool,
    ) -> Result<Self, NetworkError> {
        let shapes = graph.shapes(height, width)?;
        // The whole measurement is given; of the other tensors, only the frames that count are computed.
        let mut needed = graph.needed_frames(&shapes);
        needed.insert(MEASUREMENT, 0..graph.window.frames);
        let mut shapes: HashMap<&str, Shape> =
            needed.iter().map(|(&name, frames)| (name, Shape { t: frames.len(), ..shapes[name] })).collect();
        let parts = parts(graph, &needed, &shapes);
        let groups = groups(graph, &needed, &shapes, piece_bytes, |name| parts.contains_key(name));
        let heights = shapes.iter().map(|(&name, shape)| (name, shape.y)).collect();
        let index_of = indices(graph);
        for group in &groups {
            for &name in &group.inner {
                if let Some(shape) = shapes.get_mut(name) {
                    shape.t = shape.t.min(group.most_frames());
                    shape.y = group.most_rows(index_of[name]).unwrap_or(shape.y);
                }
            }
        }
        let (allocations, mut tensors) = allocate(graph, &shapes, &parts);
        for group in groups.iter().filter(|group| group.is_cut()) {
            keep(group, graph, &allocations, &mut tensors);
        }
        let following = if streams { following_frames(graph, &needed, &groups)? } else { None };
        let slots = assign_slots(&mut tensors);
        Ok(Self { needed, shapes, heights, groups, allocations, tensors, slots, following })
    }
}

/// The place of each node in the graph.
pub(super) fn indices(graph: &Graph) -> HashMap<&str, usize> {
    graph.nodes.iter().enumerate().map(|(index, node)| (node.name.as_str(), index)).collect()
}

/// Which tensors are written straight into a concatenation: its node, and the first channel there.
///
/// Not those of which more frames are needed than of the concatenation, which would have to hold them.
fn parts<'a>(
    graph: &'a Graph,
    needed: &HashMap<&str, Range<usize>>,
    shapes: &HashMap<&str, Shape>,
) -> HashMap<&'a str, (usize, usize)> {
    let nodes: HashMap<&str, &Node> = graph.nodes.iter().map(|node| (node.name.as_str(), node)).collect();
    let reads = |name: &str, other: &str| nodes[name].tensors().any(|input| input == other);
    let mut part_of: HashMap<&str, (usize, usize)> = HashMap::new();
    for (index, concat) in graph.nodes.iter().enumerate() {
        if !concat.is_concatenation() || !shapes.contains_key(concat.name.as_str()) {
            continue;
        }
        let mut written: Vec<&str> = Vec::new();
        let mut channel = 0;
        for input in &concat.inputs {
            let alone = nodes[input.as_str()].is_concatenation()
                || part_of.contains_key(input.as_str())
                || needed[input.as_str()] != needed[concat.name.as_str()]
                || concat.inputs.iter().filter(|other| *other == input).count() > 1
                || written.iter().any(|part| reads(part, input) || reads(input, part));
            if !alone {
                part_of.insert(input, (index, channel));
                written.push(input);
            }
            channel += shapes[input.as_str()].c;
        }
    }
    part_of
}

/// Gives the result of every node a tensor, or a part of one, and every tensor its lifetime.
fn allocate<'a>(
    graph: &'a Graph,
    shapes: &HashMap<&str, Shape>,
    part_of: &HashMap<&str, (usize, usize)>,
) -> (HashMap<&'a str, Allocation>, Vec<PlannedTensor>) {
    let full = full_precision(graph);
    let tensor = |name: &str, len, lifetime| PlannedTensor {
        name: name.to_owned(),
        full_precision: full.contains(name),
        slot: 0,
        len,
        lifetime,
    };
    // The measurement keeps its slot, since executors write it from outside.
    let mut tensors = vec![tensor(MEASUREMENT, shapes[MEASUREMENT].len(), 0..=usize::MAX)];
    let measurement = Allocation { tensor: TensorId(0), channel: 0, stride: 1 };
    let mut allocations = HashMap::from([(MEASUREMENT, measurement)]);
    let mut concatenations: HashMap<usize, Allocation> = HashMap::new();
    // Nodes without a shape are not computed.
    let computed = |node: &Node| shapes.contains_key(node.name.as_str());
    for (index, node) in graph.nodes.iter().enumerate().filter(|(_, node)| computed(node)) {
        let mut whole_of = |node: &Node| {
            let shape = shapes[node.name.as_str()];
            let stride = match node.operation().gives() {
                Kind::Scalar => 1,
                Kind::Channels => shape.c.next_multiple_of(4),
            };
            tensors.push(tensor(&node.name, shape.pixels() * stride, index..=index));
            Allocation { tensor: TensorId(tensors.len() - 1), channel: 0, stride }
        };
        let allocation = if let Some(&allocation) = concatenations.get(&index) {
            allocation
        } else if let Some(&(concat, channel)) = part_of.get(node.name.as_str()) {
            let whole = *concatenations.entry(concat).or_insert_with(|| whole_of(&graph.nodes[concat]));
            Allocation { channel: whole.channel + channel, ..whole }
        } else {
            whole_of(node)
        };
        allocations.insert(&node.name, allocation);
        // Nobody computes what is not read.
        let known = node.tensors().chain([&node.name]).filter_map(|name| allocations.get(name.as_str()));
        for &Allocation { tensor, .. } in known {
            let lifetime = &mut tensors[tensor.0].lifetime;
            *lifetime = *lifetime.start()..=index.max(*lifetime.end());
        }
    }
    let lifetime = &mut tensors[allocations[graph.output.as_str()].tensor.0].lifetime;
    *lifetime = *lifetime.start()..=usize::MAX;
    (allocations, tensors)
}

/// The tensors that are f32 at any precision (design §7). f16 is for what lies between two convolutions and no further:
///
/// - what is no convolution's result: irradiance, its logarithms, and the features that everything is computed from;
/// - what is no convolution's input: the result, and what the kernels behind a net make of its last layers;
/// - what residuals are added to, and the sums: this trunk runs through all of a net, and would be rounded at each sum.
///
/// The tensors of a concatenation are stored alike, since they lie side by side.
fn full_precision(graph: &Graph) -> HashSet<&str> {
    let mut full = HashSet::from([MEASUREMENT, graph.output.as_str()]);
    for node in &graph.nodes {
        let name = node.name.as_str();
        if let Some(conv) = node.convolution() {
            if let Some(added) = &conv.add {
                full.extend([added.as_str(), name]);
            }
        } else if !node.is_concatenation() {
            full.extend(node.tensors().map(String::as_str).chain([name]));
        }
    }
    loop {
        let before = full.len();
        for concat in graph.nodes.iter().filter(|node| node.is_concatenation()) {
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

/// Keeps all that a group reads and writes until its last piece is done, and from its first one on.
fn keep(
    group: &Group<'_>,
    graph: &Graph,
    allocations: &HashMap<&str, Allocation>,
    tensors: &mut [PlannedTensor],
) {
    for node in &graph.nodes[group.nodes.clone()] {
        let known = node.tensors().chain([&node.name]).filter_map(|name| allocations.get(name.as_str()));
        for &Allocation { tensor, .. } in known {
            let lifetime = &mut tensors[tensor.0].lifetime;
            let first = group.nodes.start.min(*lifetime.start());
            *lifetime = first..=(group.nodes.end - 1).max(*lifetime.end());
        }
    }
}

/// Gives every tensor a slot, and returns how many values each slot has. First fit by size: a tensor takes the free slot
/// that wastes or grows least.
fn assign_slots(tensors: &mut [PlannedTensor]) -> Vec<usize> {
    let mut slots: Vec<usize> = Vec::new();
    let mut busy_until: Vec<usize> = Vec::new();
    // Tensors are in order of their first node already.
    for tensor in tensors {
        let free = (0..slots.len())
            .filter(|&slot| busy_until[slot] < *tensor.lifetime.start())
            .min_by_key(|&slot| slots[slot].abs_diff(tensor.len));
        tensor.slot = free.unwrap_or_else(|| {
            slots.push(0);
            busy_until.push(0);
            slots.len() - 1
        });
        slots[tensor.slot] = slots[tensor.slot].max(tensor.len);
        busy_until[tensor.slot] = *tensor.lifetime.end();
    }
    slots
}

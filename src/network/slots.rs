//! Where tensors lie: which share a slot, and which frames and rows of them are there at once.

use std::collections::HashMap;
use std::ops::Range;

use super::graph::MEASUREMENT;
use super::news::{News, news};
use super::pieces::{Group, groups};
use super::{Graph, NetworkError, Node, Op, Shape};

/// A buffer before it has a slot: tensors that lie side by side, and the steps between which it is needed.
pub(super) struct Buffer {
    /// Values.
    pub len: usize,
    first: usize,
    last: usize,
}

/// Where a tensor lies: buffer, first channel, values between pixels.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub buffer: usize,
    pub channel: usize,
    pub stride: usize,
}

/// The place of every tensor of a graph, and what is computed of it when.
pub(super) struct Arrangement<'a> {
    /// Frames of each tensor that a window by itself computes; all of the measurement.
    pub needed: HashMap<&'a str, Range<usize>>,
    /// Extents of what is there of each tensor at once: of inner tensors of a group, the largest piece.
    pub shapes: HashMap<&'a str, Shape>,
    /// Rows of each tensor.
    pub heights: HashMap<&'a str, usize>,
    /// Nodes that are computed together.
    pub groups: Vec<Group<'a>>,
    /// Where each tensor lies.
    pub places: HashMap<&'a str, Place>,
    /// Tensors that lie side by side.
    pub buffers: Vec<Buffer>,
    /// The slots of the buffers.
    pub slots: Slots,
    /// What a window computes that follows another one, if that is less than the other one.
    pub news: Option<News<'a>>,
    /// Where frames stay that the following window needs, of tensors that do not keep their slot.
    pub kept: HashMap<&'a str, Place>,
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
        let (places, mut buffers) = place(graph, &shapes, &parts);
        for group in groups.iter().filter(|group| group.is_cut()) {
            keep(group, graph, &places, &mut buffers);
        }
        let news = if streams { news(graph, &needed, &groups)? } else { None };
        let mut kept = HashMap::new();
        let end = buffers.iter().map(|buffer| buffer.last).filter(|&last| last < usize::MAX).max();
        for (&name, &count) in news.iter().flat_map(|news| &news.carried) {
            let buffer = &mut buffers[places[name].buffer];
            if Some(buffer.last) == end {
                // Nobody would get its slot any more.
                (buffer.first, buffer.last) = (0, usize::MAX);
            }
            if buffer.last == usize::MAX {
                continue;
            }
            let Shape { y, x, c, .. } = shapes[name];
            let stride = places[name].stride.min(c.next_multiple_of(4));
            kept.insert(name, Place { buffer: buffers.len(), channel: 0, stride });
            buffers.push(Buffer { len: count * y * x * stride, first: 0, last: usize::MAX });
        }
        let slots = assign_slots(&buffers);
        Ok(Self { needed, shapes, heights, groups, places, buffers, slots, news, kept })
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
        if !matches!(concat.op, Op::Concat) || !shapes.contains_key(concat.name.as_str()) {
            continue;
        }
        let mut written: Vec<&str> = Vec::new();
        let mut channel = 0;
        for input in &concat.inputs {
            let alone = matches!(nodes[input.as_str()].op, Op::Concat)
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

/// Gives every tensor a buffer, and every buffer its lifetime in steps.
fn place<'a>(
    graph: &'a Graph,
    shapes: &HashMap<&str, Shape>,
    part_of: &HashMap<&str, (usize, usize)>,
) -> (HashMap<&'a str, Place>, Vec<Buffer>) {
    let mut buffers: Vec<Buffer> = Vec::new();
    let mut places: HashMap<&str, Place> = HashMap::new();
    let mut concat_places: HashMap<usize, Place> = HashMap::new();
    // The measurement keeps its slot, since executors write it from outside.
    buffers.push(Buffer { len: shapes[MEASUREMENT].len(), first: 0, last: usize::MAX });
    places.insert(MEASUREMENT, Place { buffer: 0, channel: 0, stride: 1 });
    // Nodes without a shape are not computed.
    let computed = |node: &Node| shapes.contains_key(node.name.as_str());
    for (index, node) in graph.nodes.iter().enumerate().filter(|(_, node)| computed(node)) {
        let mut whole_of = |node: &Node| {
            let shape = shapes[node.name.as_str()];
            let stride = if node.op.is_video() { 1 } else { shape.c.next_multiple_of(4) };
            buffers.push(Buffer { len: shape.pixels() * stride, first: index, last: index });
            Place { buffer: buffers.len() - 1, channel: 0, stride }
        };
        let place = if let Some(&place) = concat_places.get(&index) {
            place
        } else if let Some(&(concat, channel)) = part_of.get(node.name.as_str()) {
            let whole = *concat_places.entry(concat).or_insert_with(|| whole_of(&graph.nodes[concat]));
            Place { channel: whole.channel + channel, ..whole }
        } else {
            whole_of(node)
        };
        for place in node.tensors().filter_map(|name| places.get(name.as_str())) {
            let buffer = &mut buffers[place.buffer];
            buffer.last = buffer.last.max(index);
        }
        buffers[place.buffer].last = buffers[place.buffer].last.max(index);
        places.insert(&node.name, place);
    }
    buffers[places[graph.output.as_str()].buffer].last = usize::MAX;
    (places, buffers)
}

/// Keeps all that a group reads and writes until its last piece is done, and from its first one on.
fn keep(group: &Group<'_>, graph: &Graph, places: &HashMap<&str, Place>, buffers: &mut [Buffer]) {
    for node in &graph.nodes[group.nodes.clone()] {
        for name in node.tensors().chain([&node.name]) {
            let buffer = &mut buffers[places[name.as_str()].buffer];
            buffer.first = buffer.first.min(group.nodes.start);
            buffer.last = buffer.last.max(group.nodes.end - 1);
        }
    }
}

/// Sizes of the slots, and the slot of each buffer.
pub(super) struct Slots {
    /// Values in each slot.
    pub len: Vec<usize>,
    /// The slot of each buffer.
    pub of: Vec<usize>,
}

/// First fit by size: a buffer takes the free slot that wastes or grows least.
fn assign_slots(buffers: &[Buffer]) -> Slots {
    let mut slots = Slots { len: Vec::new(), of: vec![0; buffers.len()] };
    let mut busy_until: Vec<usize> = Vec::new();
    // Buffers are in order of their first step already.
    for (index, buffer) in buffers.iter().enumerate() {
        let free = (0..slots.len.len())
            .filter(|&slot| busy_until[slot] < buffer.first)
            .min_by_key(|&slot| slots.len[slot].abs_diff(buffer.len));
        let slot = free.unwrap_or_else(|| {
            slots.len.push(0);
            busy_until.push(0);
            slots.len.len() - 1
        });
        slots.len[slot] = slots.len[slot].max(buffer.len);
        busy_until[slot] = buffer.last;
        slots.of[index] = slot;
    }
    slots
}

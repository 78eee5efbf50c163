//! Which nodes are computed together, piece of time by piece of time.
//!
//! The last layers of a net write tensors that are many times as large as its result. A few frames of them fit into a
//! cache, and are best read again before the next ones are computed: that saves memory, and the way there and back.

use std::collections::HashMap;
use std::ops::Range;

use super::{Graph, Node, Op, Shape};

/// Neighbouring nodes of a graph, all of which compute one piece before any computes the next one.
#[derive(Debug)]
pub(super) struct Group<'a> {
    /// The nodes.
    pub nodes: Range<usize>,
    /// Frames of each piece.
    pub pieces: Vec<Range<usize>>,
    /// Tensors that nothing but the group reads: of them, only the piece is there.
    pub inner: Vec<&'a str>,
}

impl Group<'_> {
    /// Nodes by themselves, computed whole.
    fn whole(nodes: Range<usize>) -> Self {
        Self { nodes, pieces: std::iter::once(0..usize::MAX).collect(), inner: Vec::new() }
    }

    /// Frames of the longest piece.
    pub fn longest(&self) -> usize {
        self.pieces.iter().map(ExactSizeIterator::len).max().unwrap_or(0)
    }
}

/// Divides the nodes of `graph` into groups whose inner tensors take at most `bytes` a piece, at 4 a value, or a frame.
/// Only what is larger as a whole is cut. Nodes compute the frames `needed` of tensors of `shapes`; what is `part` of a
/// concatenation stays whole.
pub(super) fn groups<'a>(
    graph: &'a Graph,
    needed: &HashMap<&str, Range<usize>>,
    shapes: &HashMap<&str, Shape>,
    bytes: usize,
    part: impl Fn(&str) -> bool,
) -> Vec<Group<'a>> {
    let frame_bytes = |name: &str| {
        let Shape { y, x, c, .. } = shapes[name];
        4 * y * x * c
    };
    let may = |node: &Node| by_frames(node) && !part(&node.name) && needed.contains_key(node.name.as_str());
    let joins = |group: &Range<usize>, node: &Node| {
        if !may(node) {
            return false;
        }
        let first = needed[node.name.as_str()].start;
        let reads = node.tensors().zip(node.reads(first..first + 1));
        let mut inner = reads
            .filter(|(name, _)| graph.nodes[group.clone()].iter().any(|node| node.name == **name))
            .peekable();
        let now = first as isize..first as isize + 1;
        inner.peek().is_some()
            && inner.all(|(name, read)| {
                let large = frame_bytes(name).saturating_mul(needed[name.as_str()].len()) > bytes;
                large && (read == now || read.is_empty())
            })
    };
    let mut groups = Vec::new();
    let mut begin = 0;
    while begin < graph.nodes.len() {
        let mut nodes = begin..begin + 1;
        let first = &graph.nodes[begin];
        while may(first) && graph.nodes.get(nodes.end).is_some_and(|node| joins(&nodes, node)) {
            nodes.end += 1;
        }
        begin = nodes.end;
        let read_elsewhere = |name: &str| {
            let others = graph.nodes.iter().enumerate().filter(|(index, _)| !nodes.contains(index));
            name == graph.output
                || others.into_iter().any(|(_, node)| node.tensors().any(|read| read == name))
        };
        let members = graph.nodes[nodes.clone()].iter().map(|node| node.name.as_str());
        let inner: Vec<&str> = members.clone().filter(|name| !read_elsewhere(name)).collect();
        let frames = members.map(|name| needed.get(name).cloned().unwrap_or_default());
        let frames = frames.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or_default();
        let piece = (bytes / inner.iter().map(|name| frame_bytes(name)).sum::<usize>().max(1)).max(1);
        let count = frames.len().div_ceil(piece);
        if inner.is_empty() || count < 2 {
            groups.push(Group::whole(nodes));
            continue;
        }
        let cut = |i: usize| frames.start + frames.len() * i / count;
        groups.push(Group { nodes, pieces: (0..count).map(|i| cut(i)..cut(i + 1)).collect(), inner });
    }
    groups
}

/// Whether each frame of a node's result follows from its own frames of other tensors, so that it may be in a group.
fn by_frames(node: &Node) -> bool {
    match &node.op {
        Op::Concat => false,
        Op::Features { block, .. } | Op::Blend { block, .. } => block[0] == 1,
        Op::ConvTranspose3d(conv) => conv.kernel[0] == 1 && conv.stride[0] == 1,
        Op::Conv3d(conv) => conv.stride[0] == 1,
        _ => true,
    }
}

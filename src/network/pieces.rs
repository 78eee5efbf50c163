//! Which nodes are computed together, piece by piece.
//!
//! The last layers of a net write tensors that are many times as large as its result. A few frames of them, or a few rows
//! of a large frame, fit into a cache, and are best read again before the next ones are computed: that saves memory, and
//! the way there and back.

use std::collections::HashMap;
use std::ops::Range;

use super::graph::{FRAMES, Graph, Node, ROWS};
use super::op::relation::Relation;
use super::tensor::Shape;

/// Neighbouring nodes of a graph, all of which compute one piece before any computes the next one.
#[derive(Debug)]
pub(super) struct Group<'a> {
    /// The nodes.
    pub nodes: Range<usize>,
    /// Tensors that nothing but the group reads: of them, only the piece is there.
    pub inner: Vec<&'a str>,
    /// Frames of the pieces.
    frames: Vec<Range<usize>>,
    /// Of each of them, the rows of the pieces: those of each node, or none for all rows.
    strips: Vec<Vec<Range<usize>>>,
}

/// What the nodes of a group compute at a time.
#[derive(Clone, Debug)]
pub(super) struct Piece<'g> {
    /// Frames.
    pub frames: Range<usize>,
    /// The first node of the group.
    first: usize,
    rows: &'g [Range<usize>],
}

impl Piece<'_> {
    /// Rows of the node with this index, which are a part of a single frame; `None`: all.
    pub fn rows(&self, index: usize) -> Option<Range<usize>> {
        self.rows.get(index.checked_sub(self.first)?).cloned()
    }
}

impl Group<'_> {
    /// A node by itself, computed whole.
    fn whole(node: usize) -> Self {
        Self {
            nodes: node..node + 1,
            inner: Vec::new(),
            frames: std::iter::once(0..usize::MAX).collect(),
            strips: vec![Vec::new()],
        }
    }

    /// The pieces, in order of what they write.
    pub fn pieces(&self) -> impl Iterator<Item = Piece<'_>> {
        let first = self.nodes.start;
        let strips = move |frames: &Range<usize>| {
            let frames = frames.clone();
            self.strips.iter().map(move |rows| Piece { frames: frames.clone(), first, rows })
        };
        self.frames.iter().flat_map(strips)
    }

    /// Whether it is computed in several pieces.
    pub fn is_cut(&self) -> bool {
        self.frames.len() * self.strips.len() > 1
    }

    /// Most frames of a piece.
    pub fn most_frames(&self) -> usize {
        self.frames.iter().map(ExactSizeIterator::len).max().unwrap_or(0)
    }

    /// Most rows that a piece computes of the node with this index; `None`: all.
    pub fn most_rows(&self, index: usize) -> Option<usize> {
        let node = index.checked_sub(self.nodes.start)?;
        self.strips.iter().map(|rows| Some(rows.get(node)?.len())).max().flatten()
    }
}

/// How much more may be computed where pieces of rows overlap.
const OVERLAP: f64 = 1.1;

/// Divides the nodes of `graph` into groups whose inner tensors take about `bytes` a piece, at 4 a value: at most that, or
/// a frame; or at most twice that, or a row, where rows follow from a few rows. Only what is larger as a whole is cut.
/// Nodes compute the frames `needed` of tensors of `shapes`; what is `part` of a concatenation stays whole.
pub(super) fn groups<'a>(
    graph: &'a Graph,
    needed: &HashMap<&str, Range<usize>>,
    shapes: &HashMap<&str, Shape>,
    bytes: usize,
    part: impl Fn(&str) -> bool,
) -> Vec<Group<'a>> {
    let net = Net { graph, needed, shapes, bytes };
    let mut groups = Vec::new();
    let mut begin = 0;
    while begin < graph.nodes.len() {
        let nodes = net.neighbours(begin, &part);
        begin = nodes.end;
        // As many as can be computed row by row; those before them frame by frame.
        let strips = nodes.clone().find_map(|first| net.by_rows(first..nodes.end));
        let before = nodes.start..strips.as_ref().map_or(nodes.end, |group| group.nodes.start);
        groups.extend(net.by_frames(before));
        groups.extend(strips);
    }
    groups
}

/// What groups are made from.
struct Net<'a, 'n> {
    graph: &'a Graph,
    needed: &'n HashMap<&'n str, Range<usize>>,
    shapes: &'n HashMap<&'n str, Shape>,
    bytes: usize,
}

impl<'a> Net<'a, '_> {
    /// Nodes from `begin` on each of whose frames follows from the same frames of those before it.
    fn neighbours(&self, begin: usize, part: impl Fn(&str) -> bool) -> Range<usize> {
        let may = |node: &Node| {
            node.goes_by_frames() && !part(&node.name) && self.needed.contains_key(node.name.as_str())
        };
        let joins = |group: &Range<usize>, node: &Node| {
            if !may(node) {
                return false;
            }
            let first = self.needed[node.name.as_str()].start;
            let is_inner = |name: &str| self.graph.nodes[group.clone()].iter().any(|node| node.name == name);
            let reads = node.reads(FRAMES, first..first + 1);
            let mut inner = reads.filter(|(name, _)| is_inner(name)).peekable();
            let now = first as isize..first as isize + 1;
            inner.peek().is_some()
                && inner.all(|(name, read)| {
                    let large = self.frame_bytes(name).saturating_mul(self.needed[name].len()) > self.bytes;
                    large && read == now
                })
        };
        let mut nodes = begin..begin + 1;
        if may(&self.graph.nodes[begin]) {
            while self.graph.nodes.get(nodes.end).is_some_and(|node| joins(&nodes, node)) {
                nodes.end += 1;
            }
        }
        nodes
    }

    /// Nodes in pieces of whole frames, or each one whole.
    fn by_frames(&self, nodes: Range<usize>) -> Vec<Group<'a>> {
        let inner = self.inner(&nodes);
        let frame = inner.iter().map(|name| self.frame_bytes(name)).sum::<usize>();
        let frames = self.frames(&nodes);
        let count = frames.len().div_ceil((self.bytes / frame.max(1)).max(1));
        // A node by itself has inner tensors only if nothing reads it.
        if nodes.len() < 2 || inner.is_empty() || count < 2 {
            return nodes.map(Group::whole).collect();
        }
        vec![Group { nodes, inner, frames: cuts(frames, count).collect(), strips: vec![Vec::new()] }]
    }

    /// Nodes in pieces of rows of a frame; `None` if a frame is small enough, or if rows do not follow from a few rows.
    fn by_rows(&self, nodes: Range<usize>) -> Option<Group<'a>> {
        let inner = self.inner(&nodes);
        let frame = inner.iter().map(|name| self.frame_bytes(name)).sum::<usize>();
        let most = self.bytes.saturating_mul(2);
        // Pieces overlap, so that only one tensor, the last, may be there for others.
        if frame <= most || inner.len() + 1 != nodes.len() {
            return None;
        }
        let members = &self.graph.nodes[nodes.clone()];
        let last = members.last()?;
        // The last one's rows are cut where no piece needs more than its own of them.
        let unit = last.relation()[ROWS].unit();
        let height = self.shapes[last.name.as_str()].y;
        let units = height.div_ceil(unit);
        let parts = cuts(0..units, frame.div_ceil(most).min(units));
        let strips: Option<Vec<_>> = parts
            .map(|part| rows_of(members, self.shapes, part.start * unit..(part.end * unit).min(height)))
            .collect();
        let strips = strips.filter(|strips| strips.len() > 1)?;
        let work = |rows: &[Range<usize>]| {
            members.iter().zip(rows).map(|(node, rows)| self.row_work(node) * rows.len() as f64).sum::<f64>()
        };
        let heights: Vec<_> = members.iter().map(|node| 0..self.shapes[node.name.as_str()].y).collect();
        if strips.iter().map(|rows| work(rows)).sum::<f64>() > OVERLAP * work(&heights) {
            return None;
        }
        let frames = self.frames(&nodes).map(|t| t..t + 1).collect();
        Some(Group { nodes, inner, frames, strips })
    }

    /// Tensors of nodes that nobody else reads.
    fn inner(&self, nodes: &Range<usize>) -> Vec<&'a str> {
        let read_elsewhere = |name: &str| {
            let mut others = self.graph.nodes.iter().enumerate().filter(|(index, _)| !nodes.contains(index));
            name == self.graph.output || others.any(|(_, node)| node.tensors().any(|read| read == name))
        };
        let names = self.graph.nodes[nodes.clone()].iter().map(|node| node.name.as_str());
        names.filter(|name| self.needed.contains_key(name) && !read_elsewhere(name)).collect()
    }

    /// Frames that any of the nodes computes.
    fn frames(&self, nodes: &Range<usize>) -> Range<usize> {
        let names = self.graph.nodes[nodes.clone()].iter().map(|node| node.name.as_str());
        let frames = names.filter_map(|name| self.needed.get(name)).cloned();
        frames.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or_default()
    }

    fn frame_bytes(&self, name: &str) -> usize {
        let Shape { y, x, c, .. } = self.shapes[name];
        4 * y * x * c
    }

    /// Multiplications for a row of a convolution; 0 for other nodes.
    fn row_work(&self, node: &Node) -> f64 {
        let Some(conv) = node.convolution() else { return 0.0 };
        let taps = conv.taps() as f64;
        // A transposed convolution has a tap for each input, not for each result.
        let share: usize = node.relation().map(Relation::unit).iter().product();
        let channels = self.shapes[node.inputs[0].as_str()].c * conv.out_channels;
        (self.shapes[node.name.as_str()].x * channels) as f64 * taps / share as f64
    }
}

/// A range in `count` nearly equal parts.
fn cuts(range: Range<usize>, count: usize) -> impl Iterator<Item = Range<usize>> {
    let cut = move |i: usize| range.start + range.len() * i / count;
    (0..count).map(move |i| cut(i)..cut(i + 1))
}

/// The rows of each of `nodes` that rows `last` of the last one follow from.
fn rows_of(nodes: &[Node], shapes: &HashMap<&str, Shape>, last: Range<usize>) -> Option<Vec<Range<usize>>> {
    let mut rows = vec![0..0; nodes.len()];
    *rows.last_mut()? = last;
    for (index, node) in nodes.iter().enumerate().rev() {
        if !node.goes_by_rows() {
            return None;
        }
        // All pieces begin in the same phase of a stride, so that they share packed weights.
        rows[index].start -= rows[index].start % node.relation()[ROWS].unit();
        for (name, read) in node.reads(ROWS, rows[index].clone()) {
            let Some(source) = nodes[..index].iter().position(|node| node.name == name) else { continue };
            let height = shapes[name].y as isize;
            let [start, end] = [read.start, read.end].map(|y| y.clamp(0, height) as usize);
            let known = &mut rows[source];
            *known = if known.start == known.end {
                start..end
            } else {
                known.start.min(start)..known.end.max(end)
            };
        }
    }
    Some(rows)
}

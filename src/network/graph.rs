//! The layer graph: which operations a net consists of, as data (`weights-format/README.md`).

use std::collections::HashMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::error::NetworkError;
use super::kernel::Convolution;
use super::op::Op;
use super::op::operation::{Kind, MAX_CHANNELS, MAX_EXTENT, MAX_FRAMES, Operation};
use super::op::relation::Relation;
use super::tensor::Shape;
use crate::math::lcm;

/// Name of the tensor that every graph is given.
pub(super) const MEASUREMENT: &str = "measurement";

/// Axes of what [`Node::reads`] says.
pub(super) const FRAMES: usize = 0;
pub(super) const ROWS: usize = 1;

/// Most nodes of a graph that a file may declare.
const MAX_NODES: usize = 1024;
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
            let input = node.inputs.first().and_then(|name| spans.get(name.as_str())).copied();
            let span = node.span(input.unwrap_or([1; 3]));
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

    /// Whether a window may give any number of result frames without changing them: it has the net's reach in time before
    /// and behind.
    pub fn stretches(&self) -> Result<bool, NetworkError> {
        let Window { frames, lead, hop } = self.window;
        let [reach, ..] = self.reach()?;
        Ok(lead >= reach && frames - hop - lead >= reach)
    }

    /// Pixels beyond its own that the output depends on, to each side along t, y, x: the halo that a tile needs
    /// to give the same result as the whole.
    pub fn reach(&self) -> Result<[usize; 3], NetworkError> {
        self.granularity()?;
        // Span and reach of each node, in measurement pixels.
        let mut known: HashMap<&str, ([usize; 3], [usize; 3])> =
            HashMap::from([(MEASUREMENT, ([1; 3], [0; 3]))]);
        for node in &self.nodes {
            let before = |name: &str| known.get(name).copied().unwrap_or(([1; 3], [0; 3]));
            let mut reach = [0; 3];
            for (input, name) in node.tensors().enumerate() {
                let (span, input_reach) = before(name);
                for (axis, relation) in node.operation().relation(input).into_iter().enumerate() {
                    let more = relation.reach(span[axis]).ok_or_else(|| {
                        node.fail("is finer than the pixels, so its reach is not known".into())
                    })?;
                    reach[axis] = reach[axis].max(input_reach[axis] + more);
                }
            }
            let (first, _) = before(node.inputs.first().map_or(MEASUREMENT, String::as_str));
            known.insert(&node.name, (node.span(first), reach));
        }
        Ok(known.get(self.output.as_str()).map_or([0; 3], |(_, reach)| *reach))
    }

    /// Shapes of all tensors for measurements of `height` × `width` pixels, in the order of the nodes and with
    /// the measurement first.
    pub fn shapes(&self, height: usize, width: usize) -> Result<HashMap<&str, Shape>, NetworkError> {
        let measurement = Shape { t: self.window.frames, y: height, x: width, c: 1 };
        let mut shapes: HashMap<&str, Shape> = HashMap::from([(MEASUREMENT, measurement)]);
        let mut kinds = HashMap::from([(MEASUREMENT, Kind::Scalar)]);
        for node in &self.nodes {
            let mut inputs = Vec::with_capacity(node.inputs.len());
            for (i, name) in node.inputs.iter().enumerate() {
                let &shape = shapes
                    .get(name.as_str())
                    .ok_or_else(|| node.fail(format!("no tensor '{name}' before it")))?;
                let wanted = node.operation().wants(i);
                if wanted != kinds[name.as_str()] {
                    let kind = match wanted {
                        Kind::Scalar => "one value a pixel",
                        Kind::Channels => "feature channels",
                    };
                    return Err(node.fail(format!("input '{name}' does not hold {kind}")));
                }
                inputs.push(shape);
            }
            let shape = node.shape(&inputs, measurement, |name| shapes.get(name).copied())?;
            kinds.insert(&node.name, node.operation().gives());
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
            for (name, frames) in node.reads(FRAMES, range) {
                let last = shapes[name].t as isize;
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

    /// What is known of its operation.
    pub(super) fn operation(&self) -> &dyn Operation {
        self.op.operation()
    }

    /// Names of all tensors that the node has to do with: its inputs, and what it adds.
    pub fn tensors(&self) -> impl Iterator<Item = &String> {
        self.inputs.iter().chain(self.convolution().and_then(|conv| conv.add.as_ref()))
    }

    /// The convolution of this node, if it is one.
    pub fn convolution(&self) -> Option<&Convolution> {
        self.operation().convolution().map(|(conv, _)| conv)
    }

    /// How its results stand to its first input.
    pub(super) fn relation(&self) -> [Relation; 3] {
        self.operation().relation(0)
    }

    /// Pixels of the measurement that a result spans along each axis, where an input spans `input`.
    fn span(&self, input: [usize; 3]) -> [usize; 3] {
        let relation = self.relation();
        std::array::from_fn(|axis| relation[axis].span(input[axis]))
    }

    /// Frames that this node computes so as to give frames `range` of its `all`.
    fn computes(&self, range: Range<usize>, all: usize) -> Range<usize> {
        if self.relation()[FRAMES].begins_anywhere() { range } else { 0..all }
    }

    /// The tensors that are read, and which frames or rows of them (axis [`FRAMES`] or [`ROWS`]) `results` of this node,
    /// as it computes them, depend on. They may lie outside of the tensor, in its padding.
    pub(super) fn reads(
        &self,
        axis: usize,
        results: Range<usize>,
    ) -> impl Iterator<Item = (&str, Range<isize>)> {
        let operation = self.operation();
        let tensors = self.tensors().enumerate().filter(move |(input, _)| operation.reads(*input));
        tensors
            .map(move |(input, name)| (name.as_str(), operation.relation(input)[axis].reads(results.clone())))
    }

    /// Whether each frame of the result is computed by itself, and stands where a frame of the inputs does.
    pub(super) fn goes_by_frames(&self) -> bool {
        let relation = self.relation()[FRAMES];
        !self.is_concatenation() && relation.is_one_to_one() && relation.begins_anywhere()
    }

    /// Whether rows of one frame of the result follow from rows of one frame of the first input, wherever those lie.
    pub(super) fn goes_by_rows(&self) -> bool {
        let Relation { before, after, .. } = self.relation()[FRAMES];
        !self.is_concatenation() && !self.operation().sees_camera() && before == 0 && after == 0
    }

    /// Whether nothing is computed, but inputs are put side by side.
    pub(super) fn is_concatenation(&self) -> bool {
        matches!(self.op, Op::Concat(_))
    }

    fn shape<'a>(
        &'a self,
        inputs: &[Shape],
        measurement: Shape,
        lookup: impl Fn(&'a str) -> Option<Shape>,
    ) -> Result<Shape, NetworkError> {
        let shape = self.operation().shape(inputs, measurement).map_err(|problem| self.fail(problem))?;
        if let Some(add) = self.convolution().and_then(|conv| conv.add.as_ref()) {
            match lookup(add) {
                Some(added) if added == shape => {}
                Some(added) => return Err(self.fail(format!("adds '{add}' of {added} to {shape}"))),
                None => return Err(self.fail(format!("no tensor '{add}' before it"))),
            }
        }
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

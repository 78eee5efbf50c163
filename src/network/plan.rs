//! Plans: a model as an ordered list of steps over a few buffers that are reused.
//!
//! Every tensor lives in a *slot*, a buffer of its own. Tensors whose lifetimes do not overlap share a slot.
//! The inputs of a concatenation are written straight into the channels of the result, so it costs nothing. A
//! step never reads the slot that it writes: safe Rust wants that on the CPU, and resource tracking on the
//! GPU. Where that keeps a tensor out of a concatenation, it is copied there.

use std::ops::{Range, RangeInclusive};

use super::graph::Window;
use super::kernel::Direction;
use super::op::Kernel;
use super::tensor::Shape;

/// Number of a tensor in [`Plan::tensors`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TensorId(pub usize);

/// A tensor of a plan: what is stored, whole, in one slot. The parts of a concatenation are views of one tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedTensor {
    /// Name of the node that it is the result of.
    pub name: String,
    /// Whether it is f32 at any precision of an executor (design §7).
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
    pub(super) fn rows(self, start: usize, rows: usize) -> Self {
        debug_assert!(self.shape.t == 1 || rows == self.shape.y, "rows of several frames lie apart");
        let shape = Shape { y: rows, ..self.shape };
        Self { offset: self.offset + start * self.shape.x * self.stride, shape, ..self }
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
    /// Frame of the window in which the output begins of a kernel that sees the camera's tables; 0 of others.
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
    /// What the window before has left of tensors that the run writes, by number in [`Plan::carries`]: it has to be there
    /// before the run, in a window that follows.
    pub restores: Vec<usize>,
    /// What the run has written of what the following window needs.
    pub saves: Vec<usize>,
}

/// Frames of a tensor that a window leaves for the following one, as values of the tensor's slot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Carry {
    /// The tensor.
    pub tensor: TensorId,
    /// Where they are when they were computed: the last ones.
    pub written: Range<usize>,
    /// Where they are in the following window.
    pub wanted: Range<usize>,
}

/// What memory a plan takes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Footprint {
    /// Values in each slot.
    pub slots: Vec<usize>,
    /// Values of a [`State`](super::State), where windows that follow each other compute only what is new.
    pub state: Option<usize>,
}

/// The steps of a window right behind another one, which compute only frames that the other one has not.
#[derive(Clone, Debug)]
pub struct Following {
    /// Steps in order.
    pub steps: Vec<Step>,
    /// The same steps in runs.
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
    /// What a window leaves for the following one.
    pub carries: Vec<Carry>,
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

impl Plan {
    /// Operations of all convolutions, two per multiplication and addition, for one window: one of many, where the plan is
    /// for streams.
    pub fn flop(&self) -> f64 {
        self.usual_steps().iter().map(Step::flop).sum()
    }

    /// All steps: those of a window by itself, then those of one that follows another one.
    pub fn all_steps(&self) -> impl Iterator<Item = &Step> {
        self.steps.iter().chain(self.following.iter().flat_map(|following| &following.steps))
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

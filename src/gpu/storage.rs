//! How tensors are stored in slots.
//!
//! Tensors of one value a pixel are f32 always. Tensors of feature channels are stored as f32, or as pairs of f16 in
//! u32, which every adapter can read and write; all arithmetic is f32. The plan says which tensors are f32 at any
//! precision ([`Step::full_precision`]).
//!
//! What f16 cannot hold is stored in other units, powers of two, which changes no digit: weights to an output channel
//! share a unit from the beginning (`weights.rs`), and a tensor gets one when a value that it cannot hold is met
//! (`executor/units.rs`).

use crate::network::{Kernel, Plan, Precision, Step, View};

/// The largest finite f16.
pub(super) const LARGEST_F16: f32 = 65504.0;

/// How a vector of four feature channels is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Four f32.
    F32,
    /// Four f16.
    F16,
}

impl Format {
    /// What feature channels and weights are stored in.
    pub fn of(precision: Precision) -> Self {
        match precision {
            Precision::F32 => Self::F32,
            Precision::F16 => Self::F16,
        }
    }

    /// Bytes of one value.
    pub fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F16 => 2,
        }
    }
}

/// How all tensors of a plan are stored.
#[derive(Debug)]
pub struct Storage {
    /// Formats of the inputs and of the output, by step.
    pub steps: Vec<StepFormats>,
    /// Bytes of the values of each slot, a multiple of 16.
    pub slot_bytes: Vec<usize>,
    /// How many tensors there are.
    pub tensors: usize,
}

/// How the tensors of one step are stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StepFormats {
    /// Inputs, in the order of the step.
    pub inputs: Vec<Format>,
    /// Output.
    pub output: Format,
    /// Weights, where there are some.
    pub weights: Format,
    /// Numbers of the tensors that the inputs are. Those that lie side by side, the parts of a concatenation and the
    /// whole, are one.
    pub input_tensors: Vec<usize>,
    /// Number of the tensor that the output is.
    pub output_tensor: usize,
}

/// What lies in a slot.
#[derive(Clone, Default)]
struct Held {
    /// Number of the tensor.
    tensor: usize,
    /// Values between its pixels, if it is a concatenation.
    stride: Option<usize>,
    /// First channels of its parts that were written. A part that is written again belongs to another concatenation, of the
    /// same stride.
    parts: Vec<usize>,
}

impl Storage {
    /// Decides the format of each tensor of `plan`.
    pub fn new(plan: &Plan, precision: Precision) -> Self {
        let reduced = Format::of(precision);
        // Formats by tensor; the first one is the measurement.
        let mut formats = vec![Format::F32];
        let mut holds: Vec<Held> = vec![Held::default(); plan.slots.len()];
        let mut slot_bytes = vec![0; plan.slots.len()];
        slot_bytes[plan.measurement.slot] = plan.slots[plan.measurement.slot] * Format::F32.bytes();
        let steps = plan.usual_steps().iter().map(|step| {
            let View { slot, offset, stride, shape } = step.output;
            let whole = (stride > shape.c.next_multiple_of(4)).then_some(stride);
            let channel = offset % stride;
            let held = &mut holds[slot];
            if whole.is_some() && held.stride == whole && !held.parts.contains(&channel) {
                held.parts.push(channel);
            } else {
                formats.push(if step.full_precision { Format::F32 } else { reduced });
                *held = Held { tensor: formats.len() - 1, stride: whole, parts: vec![channel] };
            }
            let output_tensor = held.tensor;
            let input_tensors: Vec<usize> = step.inputs.iter().map(|view| holds[view.slot].tensor).collect();
            let output = formats[output_tensor];
            slot_bytes[slot] = (plan.slots[slot] * output.bytes()).max(slot_bytes[slot]);
            let inputs = input_tensors.iter().map(|&tensor| formats[tensor]).collect();
            StepFormats { inputs, output, weights: reduced, input_tensors, output_tensor }
        });
        let steps = steps.collect();
        // A slot that nothing is written to is still bound.
        for (bytes, &len) in slot_bytes.iter_mut().zip(&plan.slots) {
            *bytes = if *bytes == 0 { len * Format::F32.bytes() } else { *bytes }.next_multiple_of(16);
        }
        Self { steps, slot_bytes, tensors: formats.len() }
    }

    /// Bytes of the zeros that have to stand behind the values of the slot that `step` reads, in place of one pixel of
    /// padding.
    pub fn zeros_bytes(step: &Step) -> usize {
        match step.kernel {
            Kernel::Conv3d(_) | Kernel::ConvTranspose3d(_) => {
                step.inputs[0].shape.c.next_multiple_of(4) * Format::F32.bytes()
            }
            _ => 0,
        }
    }
}

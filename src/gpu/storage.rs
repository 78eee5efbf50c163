//! How tensors are stored in slots.
//!
//! Tensors of one value a pixel are f32 always. Tensors of feature channels are stored as f32, or as pairs of f16 in
//! u32, which every adapter can read and write; all arithmetic is f32. Results of the inverse response, weights of the
//! fusion and residuals in the log domain stay f32 at any precision (design §7).

use crate::network::{ConvolutionStep, Kernel, Plan, Precision, Step, View};

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
    /// Format of the result.
    pub result: Format,
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
}

impl Storage {
    /// Decides the format of each tensor of `plan`.
    pub fn new(plan: &Plan, precision: Precision) -> Self {
        // The tensors that lie side by side in a slot have one format: the parts of a concatenation and the whole.
        let mut formats: Vec<Format> = Vec::new();
        let mut fresh = |format| {
            formats.push(format);
            formats.len() - 1
        };
        // What lies in each slot: number of its format, and the stride of a concatenation that is being written.
        let measurement = fresh(Format::F32);
        let mut holds: Vec<(usize, Option<usize>)> = vec![(measurement, None); plan.slots.len()];
        let reduced = Format::of(precision);
        let mut places = Vec::with_capacity(plan.steps.len());
        for step in &plan.steps {
            let View { slot, stride, shape, .. } = step.output;
            let part = (stride > shape.c.next_multiple_of(4)).then_some(stride);
            let output = match holds[slot] {
                (format, whole) if part.is_some() && whole == part => format,
                _ => fresh(if stride == 1 { Format::F32 } else { reduced }),
            };
            holds[slot] = (output, part);
            let inputs: Vec<usize> = step.inputs.iter().map(|view| holds[view.slot].0).collect();
            places.push((inputs, output));
        }
        for (step, (inputs, output)) in plan.steps.iter().zip(&places) {
            if !step.kernel.follows_precision() {
                for &place in inputs.iter().chain([output]) {
                    formats[place] = Format::F32;
                }
            }
        }
        let mut slot_bytes = vec![0; plan.slots.len()];
        slot_bytes[plan.measurement.slot] = plan.slots[plan.measurement.slot] * Format::F32.bytes();
        let steps = plan.steps.iter().zip(places).map(|(step, (inputs, output))| {
            let formats = StepFormats {
                inputs: inputs.iter().map(|&place| formats[place]).collect(),
                output: formats[output],
                weights: reduced,
            };
            let bytes = &mut slot_bytes[step.output.slot];
            *bytes = (plan.slots[step.output.slot] * formats.output.bytes()).max(*bytes);
            formats
        });
        let steps = steps.collect();
        // A slot that nothing is written to is still bound.
        for (bytes, &len) in slot_bytes.iter_mut().zip(&plan.slots) {
            *bytes = if *bytes == 0 { len * Format::F32.bytes() } else { *bytes }.next_multiple_of(16);
        }
        Self { steps, slot_bytes, result: formats[holds[plan.result.slot].0] }
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

/// The first weight that f16 cannot hold.
pub(super) fn overflowing_weight(step: &ConvolutionStep) -> Option<f32> {
    step.layer.weight.iter().copied().find(|weight| weight.abs() > LARGEST_F16)
}

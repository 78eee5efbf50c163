//! How tensors are stored in slots.
//!
//! Tensors of one value a pixel are f32 always. Tensors of feature channels are stored as f32, or as pairs of f16 in
//! u32, which every adapter can read and write; all arithmetic is f32. The plan says which tensors are f32 at any
//! precision ([`PlannedTensor::full_precision`](crate::network::PlannedTensor)).
//!
//! What f16 cannot hold is stored in other units, powers of two, which changes no digit: weights to an output channel
//! share a unit from the beginning (`weights.rs`), and a tensor gets one when a value that it cannot hold is met
//! (`executor/units.rs`).

use crate::network::{Plan, Precision, Step, TensorId, View};

/// The largest finite f16.
pub(super) const LARGEST_F16: f32 = 65504.0;

/// How a vector of four feature channels is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TensorFormat {
    /// Four f32.
    F32,
    /// Four f16.
    F16,
}

impl TensorFormat {
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
pub struct TensorFormats {
    /// By tensor.
    tensors: Vec<TensorFormat>,
    /// Of weights.
    pub weights: TensorFormat,
    /// Bytes of the values of each slot, a multiple of 16.
    pub slot_bytes: Vec<usize>,
}

impl TensorFormats {
    /// Decides the format of each tensor of `plan`.
    pub fn new(plan: &Plan, precision: Precision) -> Self {
        let weights = TensorFormat::of(precision);
        let format = |full_precision| if full_precision { TensorFormat::F32 } else { weights };
        let tensors: Vec<_> = plan.tensors.iter().map(|tensor| format(tensor.full_precision)).collect();
        let mut slot_bytes = vec![0; plan.slots.len()];
        for (tensor, format) in plan.tensors.iter().zip(&tensors) {
            let bytes = (plan.slots[tensor.slot] * format.bytes()).next_multiple_of(16);
            slot_bytes[tensor.slot] = bytes.max(slot_bytes[tensor.slot]);
        }
        // A slot of no tensor is still bound.
        for (bytes, &len) in slot_bytes.iter_mut().zip(&plan.slots).filter(|(bytes, _)| **bytes == 0) {
            *bytes = (len * TensorFormat::F32.bytes()).next_multiple_of(16);
        }
        Self { tensors, weights, slot_bytes }
    }

    /// The format of the tensor that `view` shows.
    pub fn of(&self, view: &View) -> TensorFormat {
        self.of_tensor(view.tensor)
    }

    /// The format of a tensor.
    pub fn of_tensor(&self, TensorId(tensor): TensorId) -> TensorFormat {
        self.tensors[tensor]
    }

    /// Bytes of the zeros that have to stand behind the values of the slot that `step` reads, in place of one pixel of
    /// padding.
    pub fn zeros_bytes(step: &Step) -> usize {
        let convolution = step.kernel.convolution();
        convolution.map_or(0, |conv| conv.in_channels.next_multiple_of(4) * TensorFormat::F32.bytes())
    }
}

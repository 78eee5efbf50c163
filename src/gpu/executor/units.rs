//! The units in which tensors are stored at f16.
//!
//! A tensor begins in units of 1. When a window meets a value that f16 cannot hold, its tensor goes over to a power of two
//! that leaves room, and stays there: the convolution that writes it divides by the unit, those that read it multiply. That
//! changes no digit, except of values below 2⁻¹⁴ units, which f16 holds to 2⁻²⁵ units.

use super::record::Recorded;
use crate::gpu::storage::LARGEST_F16;
use crate::gpu::weights::unit_of;
use crate::gpu::{Gpu, GpuError};
use crate::network::{Plan, Step, TensorId};

/// The power of two in which each tensor is stored.
#[derive(Debug)]
pub(super) struct Units {
    of_tensors: Vec<f32>,
    /// How often one has changed: what a window leaves is of use only in the units that it was computed in.
    pub(super) rescalings: usize,
}

impl Units {
    /// Units of 1 for so many tensors.
    pub(super) fn new(tensors: usize) -> Self {
        Self { of_tensors: vec![1.0; tensors], rescalings: 0 }
    }

    /// The unit of a tensor.
    pub(super) fn of(&self, TensorId(tensor): TensorId) -> f32 {
        self.of_tensors[tensor]
    }

    /// Makes room for `magnitude`, the largest result of a step of `plan`, and says so. A window that was submitted before
    /// may report what there is room for already.
    pub(super) fn make_room(
        &mut self,
        gpu: &Gpu,
        plan: &Plan,
        steps: &[Recorded],
        (step, magnitude): (usize, f32),
    ) -> Result<(), GpuError> {
        let Some(Step { name, output, .. }) = plan.all_steps().nth(step) else { return Ok(()) };
        let rescaled = output.tensor;
        if magnitude <= LARGEST_F16 * self.of(rescaled) {
            return Ok(());
        }
        let unit = unit_of(magnitude);
        if !magnitude.is_finite() || unit <= self.of(rescaled) {
            return Err(GpuError::Overflow { step: name.clone(), value: format!("{magnitude:e}") });
        }
        tracing::warn!(
            "f16 cannot hold {magnitude:e} of '{name}': from here on it is stored in units of {unit}, and what it \
             spoiled is computed again"
        );
        self.of_tensors[rescaled.0] = unit;
        self.rescalings += 1;
        for (recorded, step) in steps.iter().zip(plan.all_steps()) {
            let [input, output] = [step.inputs[0], step.output].map(|view| view.tensor);
            let Some((terms, buffer)) = &recorded.terms else { continue };
            if input == rescaled || output == rescaled {
                let values = terms.in_units(self.of(input), self.of(output));
                // Windows that were submitted before are not affected.
                gpu.queue.write_buffer(buffer, 0, bytemuck::cast_slice(&values));
            }
        }
        Ok(())
    }
}

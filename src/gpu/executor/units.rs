//! The units in which tensors are stored at f16.
//!
//! A tensor begins in units of 1. When a window meets a value that f16 cannot hold, its tensor goes over to a power of two
//! that leaves room, and stays there: the convolution that writes it divides by the unit, those that read it multiply. That
//! changes no digit, except of values below 2⁻¹⁴ units, which f16 holds to 2⁻²⁵ units.

use super::GpuExecutor;
use crate::gpu::GpuError;
use crate::gpu::storage::LARGEST_F16;
use crate::gpu::weights::unit_of;
use crate::network::{Step, TensorId};

impl GpuExecutor {
    /// Makes room for `magnitude`, the largest result of a step, and says so. A window that was submitted before may
    /// report what there is room for already.
    pub(super) fn make_room(&mut self, (step, magnitude): (usize, f32)) -> Result<(), GpuError> {
        let Some(Step { name, output, .. }) = self.plan.all_steps().nth(step) else { return Ok(()) };
        let TensorId(tensor) = output.tensor;
        if magnitude <= LARGEST_F16 * self.units[tensor] {
            return Ok(());
        }
        let unit = unit_of(magnitude);
        if !magnitude.is_finite() || unit <= self.units[tensor] {
            return Err(GpuError::Overflow { step: name.clone(), value: format!("{magnitude:e}") });
        }
        tracing::warn!(
            "f16 cannot hold {magnitude:e} of '{name}': from here on it is stored in units of {unit}, and what it \
             spoiled is computed again"
        );
        self.units[tensor] = unit;
        self.rescalings += 1;
        for (recorded, step) in self.steps.iter().zip(self.plan.all_steps()) {
            let [input, output] = [step.inputs[0], step.output].map(|view| view.tensor.0);
            let Some((terms, buffer)) = &recorded.terms else { continue };
            if input == tensor || output == tensor {
                let values = terms.in_units(self.units[input], self.units[output]);
                // Windows that were submitted before are not affected.
                self.gpu.queue.write_buffer(buffer, 0, bytemuck::cast_slice(&values));
            }
        }
        Ok(())
    }
}

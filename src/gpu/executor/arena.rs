//! The tensors of a plan in the memory of a GPU.

use wgpu::BufferUsages;

use super::units::Units;
use crate::gpu::storage::TensorFormats;
use crate::gpu::{Gpu, GpuError};
use crate::network::{Plan, Precision};

/// The slots of a plan, and how tensors are stored in them.
#[derive(Debug)]
pub(super) struct Arena {
    pub(super) gpu: Gpu,
    pub(super) formats: TensorFormats,
    pub(super) slots: Vec<wgpu::Buffer>,
    pub(super) units: Units,
}

impl Arena {
    /// Slots for `plan`, whose values are zero.
    pub(super) fn new(gpu: &Gpu, plan: &Plan, precision: Precision) -> Result<Self, GpuError> {
        let formats = TensorFormats::new(plan, precision);
        // Padding is read from zeros behind each slot's values, which nothing writes.
        let mut zeros = vec![0; plan.slots.len()];
        for step in plan.all_steps() {
            let slot = step.inputs[0].slot;
            zeros[slot] = TensorFormats::zeros_bytes(step).max(zeros[slot]);
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let slots = formats.slot_bytes.iter().zip(zeros).enumerate().map(|(index, (&bytes, zeros))| {
            gpu.buffer(&format!("slot {index} of '{}'", plan.name), (bytes + zeros).max(16) as u64, usage)
        });
        let slots = slots.collect::<Result<Vec<_>, _>>()?;
        Ok(Self { gpu: gpu.clone(), formats, slots, units: Units::new(plan.tensors.len()) })
    }
}

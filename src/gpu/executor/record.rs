//! How a step becomes a pipeline with its buffers bound.

use std::num::NonZero;

use wgpu::{BindGroupEntry, BindGroupLayoutEntry, BindingResource, BufferBinding, BufferBindingType};

use super::options::Edit;
use crate::gpu::dispatch::Dispatch;
use crate::gpu::shader::bindings::{KernelShader, Resource};
use crate::gpu::shader::{Shader, dump};
use crate::gpu::storage::TensorFormats;
use crate::gpu::variant::Variant;
use crate::gpu::weights::Terms;
use crate::gpu::{Gpu, GpuError};
use crate::network::{Plan, Step};
use crate::sensor::Calibration;

/// Bytes between what two steps have in one buffer: bindings may begin at any multiple of it on every adapter.
pub(super) const BINDING_STRIDE: u64 = 256;

/// A step with all that recording it needs.
#[derive(Debug)]
pub(super) struct Recorded {
    pipeline: wgpu::ComputePipeline,
    /// What all steps share, and what belongs to this one.
    groups: [wgpu::BindGroup; 2],
    workgroups: [u32; 2],
    /// Terms of a convolution, and where they lie.
    pub(super) terms: Option<(Terms, wgpu::Buffer)>,
}

/// Records steps into a pass.
pub(super) fn record(pass: &mut wgpu::ComputePass<'_>, steps: &[Recorded]) {
    for step in steps {
        pass.set_pipeline(&step.pipeline);
        for (index, group) in (0..).zip(&step.groups) {
            pass.set_bind_group(index, group, &[]);
        }
        pass.dispatch_workgroups(step.workgroups[0], step.workgroups[1], 1);
    }
}

/// Records steps as a pass of their own.
pub(super) fn encode(steps: &[Recorded], encoder: &mut wgpu::CommandEncoder) {
    record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()), steps);
}

/// Buffers that the steps of a plan share.
pub(super) struct Buffers<'a> {
    /// The plan's slots.
    pub(super) slots: &'a [wgpu::Buffer],
    /// The schedule time of the window, a uniform.
    pub(super) schedule: &'a wgpu::Buffer,
    /// What f16 could not hold, by step.
    pub(super) overflow: &'a wgpu::Buffer,
}

/// What steps are made from.
pub(super) struct Builder<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) formats: &'a TensorFormats,
    pub(super) buffers: Buffers<'a>,
    calibration: &'a Calibration,
    /// Bindings that all steps share.
    common: wgpu::BindGroup,
    /// Geometry, by step.
    geometry: wgpu::Buffer,
    /// Name of the plan and its window, for people.
    window: String,
}

impl<'a> Builder<'a> {
    /// For the steps of a plan that is stored so.
    pub(super) fn new(
        gpu: &'a Gpu,
        plan: &Plan,
        formats: &'a TensorFormats,
        buffers: Buffers<'a>,
        calibration: &'a Calibration,
    ) -> Result<Self, GpuError> {
        let inverse_response = gpu.storage("table of the inverse response", &calibration.inverse_response)?;
        let exposures = gpu.storage("table of exposures", &calibration.exposures)?;
        let tables = [&inverse_response, &exposures, buffers.schedule];
        let common = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("calibration"),
            layout: &common_layout(&gpu.device),
            entries: &entries(tables.map(wgpu::Buffer::as_entire_binding)),
        });
        let bytes = plan.all_steps().count().max(1) as u64 * BINDING_STRIDE;
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let geometry = gpu.buffer("geometry", bytes, usage)?;
        let [frames, height, width] = plan.measurement.shape.extent();
        let window = format!("{}-{frames}×{height}×{width}", plan.name);
        Ok(Self { gpu, formats, buffers, calibration, common, geometry, window })
    }

    /// Compiles a step in this variant, or in the one that its size suggests.
    pub(super) fn record(
        &self,
        index: usize,
        step: &Step,
        variant: Option<Variant>,
        edit: Option<Edit<'_>>,
    ) -> Result<Recorded, GpuError> {
        let mut dispatch = self.dispatch(step, variant)?;
        if let Some(edit) = edit {
            dispatch.shader.text = edit(step, &dispatch.shader.text);
        }
        let name = format!("{index:02}-{}-{}", step.name, dispatch.kernel.name);
        dump(&[&self.window, &name], &dispatch.shader);
        self.bind(index, step, &dispatch)
    }

    pub(super) fn dispatch(&self, step: &Step, variant: Option<Variant>) -> Result<Dispatch, GpuError> {
        Dispatch::new(step, self.formats, self.calibration, self.gpu.abilities(), variant)
    }

    /// Compiles a dispatch and binds its buffers.
    pub(super) fn bind(&self, index: usize, step: &Step, dispatch: &Dispatch) -> Result<Recorded, GpuError> {
        let gpu = self.gpu;
        let Dispatch { kernel, shader, .. } = dispatch;
        let pipeline = gpu.pipeline(&step.name, &shader.text, |device| layouts(device, kernel))?;
        let name = |what: &str| format!("{what} of '{}'", step.name);
        let stored = |terms: &Terms| gpu.storage(&name("terms"), &terms.in_units(1.0, 1.0));
        let terms = dispatch.terms.as_ref().map(|terms| Ok::<_, GpuError>((terms.clone(), stored(terms)?)));
        let terms = terms.transpose()?;
        let owned = |resource: &Resource| {
            Ok(match resource {
                Resource::Weights => gpu.storage(&name("weights"), &dispatch.weights)?,
                Resource::Terms => terms.as_ref().expect("convolutions have terms").1.clone(),
                Resource::Overflow => self.buffers.overflow.clone(),
            })
        };
        let owned = kernel.resources.iter().map(owned).collect::<Result<Vec<_>, GpuError>>()?;
        let of_step = |buffer, bytes: usize| {
            let (offset, size) = (index as u64 * BINDING_STRIDE, NonZero::new(bytes as u64));
            BindingResource::Buffer(BufferBinding { buffer, offset, size })
        };
        let resources = kernel.resources.iter().zip(&owned).map(|(resource, buffer)| match resource {
            Resource::Overflow => of_step(buffer, size_of::<f32>()),
            _ => buffer.as_entire_binding(),
        });
        let slots = dispatch.inputs.iter().chain([&step.output]);
        let slots = slots.map(|view| self.buffers.slots[view.slot].as_entire_binding());
        let bindings = [self.geometry(index, shader, of_step)].into_iter().chain(slots).chain(resources);
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(&step.name),
            layout: &pipeline.get_bind_group_layout(1),
            entries: &entries(bindings),
        });
        Ok(Recorded {
            pipeline,
            groups: [self.common.clone(), group],
            workgroups: dispatch.workgroups,
            terms,
        })
    }

    /// Uploads the geometry of a step.
    fn geometry<'b>(
        &'b self,
        index: usize,
        shader: &Shader,
        of_step: impl Fn(&'b wgpu::Buffer, usize) -> BindingResource<'b>,
    ) -> BindingResource<'b> {
        let values = shader.uniform();
        let bytes: &[u8] = bytemuck::cast_slice(&values);
        assert!(bytes.len() as u64 <= BINDING_STRIDE, "a geometry of {} values is too large", values.len());
        self.gpu.queue.write_buffer(&self.geometry, index as u64 * BINDING_STRIDE, bytes);
        of_step(&self.geometry, bytes.len())
    }
}

/// Bindings in order.
fn entries<'a>(resources: impl IntoIterator<Item = BindingResource<'a>>) -> Vec<BindGroupEntry<'a>> {
    (0..).zip(resources).map(|(binding, resource)| BindGroupEntry { binding, resource }).collect()
}

/// A layout of buffers in order.
fn layout(
    device: &wgpu::Device,
    label: &str,
    types: impl IntoIterator<Item = BufferBindingType>,
) -> wgpu::BindGroupLayout {
    let entry = |(binding, ty)| BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    };
    let entries: Vec<_> = (0..).zip(types).map(entry).collect();
    device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}

const READ: BufferBindingType = BufferBindingType::Storage { read_only: true };
const WRITTEN: BufferBindingType = BufferBindingType::Storage { read_only: false };

/// Group 0: `common/calibration.wgsl`.
fn common_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    layout(device, "calibration", [READ, READ, BufferBindingType::Uniform])
}

/// Layout of all bindings of a kernel: what all of them share; then geometry, inputs, output, resources.
fn layouts(device: &wgpu::Device, kernel: &KernelShader) -> wgpu::PipelineLayout {
    let inputs = kernel.inputs.iter().map(|_| READ);
    let resources = kernel.resources.iter().map(|resource| match resource {
        Resource::Overflow => WRITTEN,
        _ => READ,
    });
    let types = [BufferBindingType::Uniform].into_iter().chain(inputs).chain([WRITTEN]).chain(resources);
    let groups = [common_layout(device), layout(device, kernel.name, types)];
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(kernel.name),
        bind_group_layouts: &groups.each_ref().map(Some),
        immediate_size: 0,
    })
}

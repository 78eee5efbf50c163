//! How a step becomes a pipeline with its buffers bound.

use std::collections::HashMap;
use std::num::NonZero;

use super::{OVERFLOW_STRIDE, Options};
use crate::gpu::kernels::{Call, Resource, Target};
use crate::gpu::storage::Formats;
use crate::gpu::tune::Tuning;
use crate::gpu::variant::Variant;
use crate::gpu::weights::Terms;
use crate::gpu::{Gpu, GpuError};
use crate::network::Step;
use crate::sensor::Calibration;

/// Operations from which on a convolution is worth measuring.
const WORTH_TUNING: f64 = 2e7;

/// A step with all that recording it needs.
#[derive(Debug)]
pub(super) struct Recorded {
    pub(super) pipeline: wgpu::ComputePipeline,
    pub(super) bind_group: wgpu::BindGroup,
    pub(super) workgroups: [u32; 2],
    /// Terms of a convolution, and where they lie.
    pub(super) terms: Option<(Terms, wgpu::Buffer)>,
}

/// Records steps into a pass.
pub(super) fn record(pass: &mut wgpu::ComputePass<'_>, steps: &[Recorded]) {
    for step in steps {
        pass.set_pipeline(&step.pipeline);
        pass.set_bind_group(0, &step.bind_group, &[]);
        pass.dispatch_workgroups(step.workgroups[0], step.workgroups[1], 1);
    }
}

/// What steps are made from.
pub(super) struct Builder<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) formats: &'a Formats,
    pub(super) slots: &'a [wgpu::Buffer],
    overflow: &'a wgpu::Buffer,
    calibration: &'a Calibration,
    pub(super) target: Target,
    inverse_response: wgpu::Buffer,
    exposures: wgpu::Buffer,
    schedule: &'a wgpu::Buffer,
    /// Layouts by shader.
    layouts: HashMap<&'static str, (wgpu::BindGroupLayout, wgpu::PipelineLayout)>,
    /// Pipelines by text: many layers of a net differ in their weights only.
    pipelines: HashMap<String, wgpu::ComputePipeline>,
}

impl<'a> Builder<'a> {
    /// For steps of a plan that is stored so, with the buffers that all of them share.
    pub(super) fn new(
        gpu: &'a Gpu,
        formats: &'a Formats,
        slots: &'a [wgpu::Buffer],
        [overflow, schedule]: [&'a wgpu::Buffer; 2],
        calibration: &'a Calibration,
        variant: Option<Variant>,
    ) -> Result<Self, GpuError> {
        let max_workgroups = gpu.device.limits().max_compute_workgroups_per_dimension;
        Ok(Self {
            gpu,
            formats,
            slots,
            overflow,
            calibration,
            target: Target { max_workgroups, abilities: gpu.abilities(), variant },
            inverse_response: gpu.storage("table of the inverse response", &calibration.inverse_response)?,
            exposures: gpu.storage("table of exposures", &calibration.exposures)?,
            schedule,
            layouts: HashMap::new(),
            pipelines: HashMap::new(),
        })
    }

    /// Compiles a step, as the options say.
    pub(super) fn record(
        &mut self,
        index: usize,
        step: &Step,
        options: &Options<'_>,
        tuning: Option<&mut Tuning>,
    ) -> Result<Recorded, GpuError> {
        let variant = match (options.variant, tuning) {
            (None, Some(tuning)) if step.flop() >= WORTH_TUNING => self.tune(index, step, tuning)?,
            (variant, _) => variant,
        };
        let mut call = self.call(step, variant)?;
        if let Some(edit) = options.edit {
            call.text = edit(step, &call.text);
        }
        self.bind(index, step, &call)
    }

    pub(super) fn call(&self, step: &Step, variant: Option<Variant>) -> Result<Call, GpuError> {
        let target = Target { variant, ..self.target };
        Call::new(step, self.formats, self.calibration, target)
    }

    /// Compiles a call and binds its buffers.
    pub(super) fn bind(&mut self, index: usize, step: &Step, call: &Call) -> Result<Recorded, GpuError> {
        let device = &self.gpu.device;
        let (layout, pipeline_layout) =
            self.layouts.entry(call.shader.name).or_insert_with(|| layouts(device, call));
        if !self.pipelines.contains_key(&call.text) {
            let pipeline = self.gpu.pipeline(&step.name, &call.text, pipeline_layout)?;
            self.pipelines.insert(call.text.clone(), pipeline);
        }
        let name = |what: &str| format!("{what} of '{}'", step.name);
        let stored = |terms: &Terms| self.gpu.storage(&name("terms"), &terms.in_units(1.0, 1.0));
        let terms = call.terms.as_ref().map(|terms| Ok::<_, GpuError>((terms.clone(), stored(terms)?)));
        let terms = terms.transpose()?;
        let resources = call.shader.resources.iter().map(|resource| {
            Ok(match resource {
                Resource::Weights => self.gpu.storage(&name("weights"), &call.weights)?,
                Resource::Terms => terms.as_ref().expect("convolutions have terms").1.clone(),
                Resource::Overflow => self.overflow.clone(),
                Resource::RenderedExposures => {
                    self.gpu.storage(&name("exposures"), &call.rendered_exposures)?
                }
                Resource::InverseResponse => self.inverse_response.clone(),
                Resource::Exposures => self.exposures.clone(),
                Resource::Schedule => self.schedule.clone(),
            })
        });
        let resources = resources.collect::<Result<Vec<_>, GpuError>>()?;
        let slots = call.inputs.iter().chain([&step.output]).map(|view| &self.slots[view.slot]);
        let report = wgpu::BufferBinding {
            buffer: self.overflow,
            offset: index as u64 * OVERFLOW_STRIDE,
            size: NonZero::new(4),
        };
        let resources =
            resources.iter().zip(call.shader.resources).map(|(buffer, resource)| match resource {
                Resource::Overflow => wgpu::BindingResource::Buffer(report.clone()),
                _ => buffer.as_entire_binding(),
            });
        let entries: Vec<_> = slots
            .map(wgpu::Buffer::as_entire_binding)
            .chain(resources)
            .enumerate()
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding: binding as u32, resource })
            .collect();
        let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(&step.name),
            layout,
            entries: &entries,
        });
        let pipeline = self.pipelines[&call.text].clone();
        Ok(Recorded { pipeline, bind_group, workgroups: call.workgroups, terms })
    }
}

/// Layouts of a shader's bindings: inputs, output, resources.
fn layouts(device: &wgpu::Device, call: &Call) -> (wgpu::BindGroupLayout, wgpu::PipelineLayout) {
    let storage = |read_only| wgpu::BufferBindingType::Storage { read_only };
    let inputs = call.inputs.iter().map(|_| storage(true));
    let resources = call.shader.resources.iter().map(|resource| match resource {
        Resource::Schedule => wgpu::BufferBindingType::Uniform,
        Resource::Overflow => storage(false),
        _ => storage(true),
    });
    let entries: Vec<_> = inputs
        .chain([storage(false)])
        .chain(resources)
        .enumerate()
        .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
            binding: binding as u32,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        })
        .collect();
    let label = Some(call.shader.name);
    let layout =
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries: &entries });
    let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label,
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    });
    (layout, pipeline_layout)
}

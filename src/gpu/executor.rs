//! Runs a plan on a GPU.

mod timing;

use std::collections::{HashMap, VecDeque};
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use wgpu::{BufferUsages, MapMode};

use super::kernels::{Call, Resource, Target, zeros_begin, zeros_len};
use super::{Gpu, GpuError};
use crate::network::{Executor, Plan, Step, Tensor, View, WindowTime};
use crate::sensor::Calibration;
use crate::{Error, Result};

/// Bytes of a value in a slot.
const VALUE: usize = size_of::<f32>();

/// Runs one plan on a GPU.
///
/// Pipelines, weights and slots are made once. A window is one command buffer: upload, all steps, and a copy of the
/// result to memory that the CPU can map. [`GpuExecutor::submit`] and [`GpuExecutor::collect`] let a caller prepare
/// the next window while the GPU computes this one.
#[derive(Debug)]
pub struct GpuExecutor {
    gpu: Gpu,
    plan: Plan,
    slots: Vec<wgpu::Buffer>,
    steps: Vec<Recorded>,
    /// Uniform buffer with the schedule time in the pattern's period.
    schedule: wgpu::Buffer,
    period: usize,
    /// The measurement as it is uploaded.
    upload: Vec<f32>,
    /// Buffers for results that nobody waits for.
    free: Vec<wgpu::Buffer>,
    in_flight: VecDeque<InFlight>,
}

/// Changes the specialised text of a step's shader.
pub type Edit<'a> = &'a dyn Fn(&Step, &str) -> String;

/// Choices that tests and measurements make in place of the executor.
#[derive(Clone, Copy, Default)]
pub struct Overrides<'a> {
    /// Pixels along x, and vectors of four output channels, that one invocation of a convolution computes.
    pub block: Option<[usize; 2]>,
    /// What is compiled instead of a step's specialised shader, such as a shader that is broken on purpose.
    pub edit: Option<Edit<'a>>,
}

/// A step with all that recording it needs.
#[derive(Debug)]
struct Recorded {
    pipeline: wgpu::ComputePipeline,
    bind_group: wgpu::BindGroup,
    workgroups: [u32; 2],
}

/// A window that the GPU works on.
#[derive(Debug)]
struct InFlight {
    download: Download,
    submission: wgpu::SubmissionIndex,
}

/// Values on their way from a slot to the CPU.
#[derive(Debug)]
struct Download {
    buffer: wgpu::Buffer,
    view: View,
    mapped: Receiver<Result<(), wgpu::BufferAsyncError>>,
}

impl GpuExecutor {
    /// Windows that can be in flight at once.
    pub const IN_FLIGHT: usize = 2;

    /// Prepares to run `plan` on what the calibrated camera measured.
    pub fn new(gpu: &Gpu, plan: Plan, calibration: &Calibration) -> Result<Self, GpuError> {
        Self::with_overrides(gpu, plan, calibration, &Overrides::default())
    }

    /// As [`GpuExecutor::new`], with some choices overridden.
    pub fn with_overrides(
        gpu: &Gpu,
        plan: Plan,
        calibration: &Calibration,
        overrides: &Overrides<'_>,
    ) -> Result<Self, GpuError> {
        // Padding is read from zeros behind each slot's values, which nothing writes.
        let mut zeros = vec![0; plan.slots.len()];
        for step in &plan.steps {
            let slot = step.inputs[0].slot;
            zeros[slot] = zeros_len(step).max(zeros[slot]);
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let slots = plan.slots.iter().zip(zeros).enumerate().map(|(index, (&len, zeros))| {
            let values = (zeros_begin(len) + zeros).max(4);
            gpu.buffer(&format!("slot {index} of '{}'", plan.name), (values * VALUE) as u64, usage)
        });
        let slots = slots.collect::<Result<Vec<_>, _>>()?;
        let schedule = gpu.buffer("schedule", 16, BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        let mut builder = Builder {
            gpu,
            plan: &plan,
            slots: &slots,
            calibration,
            target: Target {
                max_workgroups: gpu.device.limits().max_compute_workgroups_per_dimension,
                software: gpu.adapter().is_software(),
                block: overrides.block,
            },
            inverse_response: gpu.storage("table of the inverse response", &calibration.inverse_response)?,
            exposures: gpu.storage("table of exposures", &calibration.exposures)?,
            schedule: &schedule,
            layouts: HashMap::new(),
            pipelines: HashMap::new(),
        };
        let steps = plan
            .steps
            .iter()
            .map(|step| builder.record(step, overrides.edit))
            .collect::<Result<Vec<_>, _>>()?;
        gpu.check()?;
        Ok(Self {
            gpu: gpu.clone(),
            slots,
            steps,
            schedule,
            period: calibration.period,
            upload: Vec::new(),
            free: Vec::new(),
            in_flight: VecDeque::new(),
            plan,
        })
    }

    /// The plan that is run.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Starts to compute a window: as [`Executor::run`], but returns while the GPU works. At most
    /// [`GpuExecutor::IN_FLIGHT`] windows can be in flight.
    pub fn submit(&mut self, measurement: &[f32], schedule: i64) -> Result<()> {
        if self.in_flight.len() == Self::IN_FLIGHT {
            return Err(Error::Usage(format!(
                "{} windows are in flight; collect one first",
                Self::IN_FLIGHT
            )));
        }
        self.upload(measurement, schedule)?;
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        Self::encode(&self.steps, &mut encoder);
        let view = self.plan.result;
        let buffer = match self.free.pop() {
            Some(buffer) => buffer,
            None => self.staging(&view)?,
        };
        let (download, submission) = self.download(view, buffer, encoder);
        self.in_flight.push_back(InFlight { download, submission });
        Ok(())
    }

    /// Waits for the window that was submitted first, and writes its irradiance [hop, H, W] to `result`.
    pub fn collect(&mut self, result: &mut [f32]) -> Result<()> {
        check_len("the result", result.len(), self.plan.result.shape.len())?;
        let Some(InFlight { download, submission }) = self.in_flight.pop_front() else {
            return Err(Error::Usage("no window is in flight".into()));
        };
        self.gpu.wait(submission)?;
        download.read(&self.gpu, |values| {
            for (result, value) in result.iter_mut().zip(values) {
                // Only a net whose weights overflow gets here with anything else than a finite number.
                *result = if value.is_finite() { value } else { 0.0 };
            }
        })?;
        self.free.push(download.buffer);
        Ok(())
    }

    /// Uploads the measurement and the schedule. What is not finite counts as 0, so that no kernel meets NaN.
    fn upload(&mut self, measurement: &[f32], schedule: i64) -> Result<()> {
        let View { slot, offset, shape, .. } = self.plan.measurement;
        check_len("the measurement", measurement.len(), shape.len())?;
        self.gpu.check()?;
        self.upload.clear();
        self.upload.extend(measurement.iter().map(|&y| if y.is_finite() { y.clamp(0.0, 1.0) } else { 0.0 }));
        let queue = &self.gpu.queue;
        queue.write_buffer(&self.slots[slot], (offset * VALUE) as u64, bytemuck::cast_slice(&self.upload));
        let phase = schedule.rem_euclid(self.period as i64) as u32;
        queue.write_buffer(&self.schedule, 0, bytemuck::cast_slice(&[phase, 0, 0, 0]));
        Ok(())
    }

    fn encode(steps: &[Recorded], encoder: &mut wgpu::CommandEncoder) {
        record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()), steps);
    }

    /// A buffer that the values of `view` can be copied to.
    fn staging(&self, view: &View) -> Result<wgpu::Buffer, GpuError> {
        let bytes = (span(view) * VALUE) as u64;
        self.gpu.buffer("result", bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST)
    }

    /// Submits what is recorded, followed by a copy of `view`.
    fn download(
        &self,
        view: View,
        buffer: wgpu::Buffer,
        mut encoder: wgpu::CommandEncoder,
    ) -> (Download, wgpu::SubmissionIndex) {
        let (offset, bytes) = (view.offset * VALUE, span(&view) * VALUE);
        encoder.copy_buffer_to_buffer(&self.slots[view.slot], offset as u64, &buffer, 0, bytes as u64);
        let submission = self.gpu.queue.submit([encoder.finish()]);
        let (sender, mapped) = mpsc::channel();
        buffer.map_async(MapMode::Read, .., move |outcome| {
            // Nobody listens if the executor is gone.
            let _ = sender.send(outcome);
        });
        (Download { buffer, view, mapped }, submission)
    }

    /// Runs one step.
    fn step(&self, index: usize) {
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        Self::encode(&self.steps[index..=index], &mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// The tensor that a view shows.
    fn tensor(&self, view: &View) -> Result<Tensor, GpuError> {
        let encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let (download, submission) = self.download(*view, self.staging(view)?, encoder);
        self.gpu.wait(submission)?;
        let mut data = Vec::with_capacity(view.shape.len());
        download.read(&self.gpu, |values| data.extend(values))?;
        Ok(Tensor { shape: view.shape, data })
    }
}

impl Executor for GpuExecutor {
    fn run(&mut self, measurement: &[f32], schedule: i64, result: &mut [f32]) -> Result<()> {
        check_len("the result", result.len(), self.plan.result.shape.len())?;
        if !self.in_flight.is_empty() {
            return Err(Error::Usage("a window is in flight; collect it first".into()));
        }
        self.submit(measurement, schedule)?;
        self.collect(result)
    }

    fn submit(&mut self, measurement: &[f32], schedule: i64) -> Result<()> {
        Self::submit(self, measurement, schedule)
    }

    fn collect(&mut self, result: &mut [f32]) -> Result<()> {
        Self::collect(self, result)
    }

    fn in_flight(&self) -> usize {
        Self::IN_FLIGHT
    }

    fn trace(
        &mut self,
        measurement: &[f32],
        schedule: i64,
        visit: &mut dyn FnMut(&Step, &[Tensor], &Tensor),
    ) -> Result<()> {
        self.upload(measurement, schedule)?;
        for (index, step) in self.plan.steps.iter().enumerate() {
            self.step(index);
            // A step does not write what it reads, so the inputs are still there.
            let inputs = step.inputs.iter().map(|view| self.tensor(view)).collect::<Result<Vec<_>, _>>()?;
            visit(step, &inputs, &self.tensor(&step.output)?);
        }
        Ok(())
    }

    fn time_windows(&mut self, measurement: &[f32], schedule: i64, windows: usize) -> Result<WindowTime> {
        self.arrive(measurement, schedule)?;
        Ok(self.time_passes(windows)?)
    }

    fn time_steps(&mut self, measurement: &[f32], schedule: i64) -> Result<Vec<Duration>> {
        self.arrive(measurement, schedule)?;
        Ok(self.time_each()?)
    }

    fn describe(&self) -> String {
        format!("{}, f32", self.gpu.name())
    }
}

/// How long another thread may take to report a finished map before it counts as failed.
const CALLBACK_TIME: Duration = Duration::from_secs(10);

impl Download {
    /// Shows the values without padding channels. The submission must be done.
    fn read(&self, gpu: &Gpu, visit: impl FnOnce(&mut dyn Iterator<Item = f32>)) -> Result<(), GpuError> {
        // Where several threads wait on one device, another one may be about to make the call that reports this map.
        match self.mapped.recv_timeout(CALLBACK_TIME) {
            Ok(Ok(())) => {}
            outcome => {
                gpu.check()?;
                return Err(GpuError::Failed(format!("the result cannot be mapped: {outcome:?}")));
            }
        }
        {
            let bytes =
                self.buffer.get_mapped_range(..).map_err(|error| GpuError::Failed(error.to_string()))?;
            let values: &[f32] = bytemuck::cast_slice(&bytes);
            let channels = self.view.shape.c;
            visit(&mut values.chunks(self.view.stride).flat_map(|pixel| &pixel[..channels]).copied());
        }
        self.buffer.unmap();
        Ok(())
    }
}

/// Records steps into a pass.
fn record(pass: &mut wgpu::ComputePass<'_>, steps: &[Recorded]) {
    for step in steps {
        pass.set_pipeline(&step.pipeline);
        pass.set_bind_group(0, &step.bind_group, &[]);
        pass.dispatch_workgroups(step.workgroups[0], step.workgroups[1], 1);
    }
}

/// What steps are made from.
struct Builder<'a> {
    gpu: &'a Gpu,
    plan: &'a Plan,
    slots: &'a [wgpu::Buffer],
    calibration: &'a Calibration,
    target: Target,
    inverse_response: wgpu::Buffer,
    exposures: wgpu::Buffer,
    schedule: &'a wgpu::Buffer,
    /// Layouts by shader.
    layouts: HashMap<&'static str, (wgpu::BindGroupLayout, wgpu::PipelineLayout)>,
    /// Pipelines by text: many layers of a net differ in their weights only.
    pipelines: HashMap<String, wgpu::ComputePipeline>,
}

impl Builder<'_> {
    fn record(&mut self, step: &Step, edit: Option<Edit<'_>>) -> Result<Recorded, GpuError> {
        let device = &self.gpu.device;
        let mut call = Call::new(step, &self.plan.slots, self.calibration, self.target)?;
        if let Some(edit) = edit {
            call.text = edit(step, &call.text);
        }
        let (layout, pipeline_layout) =
            self.layouts.entry(call.shader.name).or_insert_with(|| layouts(device, &call));
        if !self.pipelines.contains_key(&call.text) {
            let pipeline = self.gpu.pipeline(&step.name, &call.text, pipeline_layout)?;
            self.pipelines.insert(call.text.clone(), pipeline);
        }
        let own =
            |what: &str, values: &[f32]| self.gpu.storage(&format!("{what} of '{}'", step.name), values);
        let resources = call.shader.resources.iter().map(|resource| {
            Ok(match resource {
                Resource::Weights => own("weights", &call.weights)?,
                Resource::Terms => own("terms", &call.terms)?,
                Resource::RenderedExposures => own("exposures", &call.rendered_exposures)?,
                Resource::InverseResponse => self.inverse_response.clone(),
                Resource::Exposures => self.exposures.clone(),
                Resource::Schedule => self.schedule.clone(),
            })
        });
        let resources = resources.collect::<Result<Vec<_>, GpuError>>()?;
        let slots = call.inputs.iter().chain([&step.output]).map(|view| &self.slots[view.slot]);
        let entries: Vec<_> = slots
            .chain(&resources)
            .enumerate()
            .map(|(binding, buffer)| wgpu::BindGroupEntry {
                binding: binding as u32,
                resource: buffer.as_entire_binding(),
            })
            .collect();
        let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(&step.name),
            layout,
            entries: &entries,
        });
        Ok(Recorded { pipeline: self.pipelines[&call.text].clone(), bind_group, workgroups: call.workgroups })
    }
}

/// Layouts of a shader's bindings: inputs, output, resources.
fn layouts(device: &wgpu::Device, call: &Call) -> (wgpu::BindGroupLayout, wgpu::PipelineLayout) {
    let storage = |read_only| wgpu::BufferBindingType::Storage { read_only };
    let inputs = call.inputs.iter().map(|_| storage(true));
    let resources = call.shader.resources.iter().map(|resource| match resource {
        Resource::Schedule => wgpu::BufferBindingType::Uniform,
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

/// Values from the first pixel's first channel to the last pixel's last one.
fn span(view: &View) -> usize {
    view.shape.pixels().checked_sub(1).map_or(0, |last| last * view.stride + view.shape.c)
}

fn check_len(what: &str, len: usize, wanted: usize) -> Result<()> {
    if len == wanted {
        return Ok(());
    }
    Err(Error::Usage(format!("{what} has {len} values, the plan wants {wanted}")))
}

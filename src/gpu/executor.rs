//! Runs a plan on a GPU.

mod timing;
mod units;

use std::collections::{HashMap, VecDeque};
use std::num::NonZero;
use std::ops::Range;
use std::path::Path;
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use wgpu::{BufferUsages, MapMode};

use super::kernels::{Call, Resource, Target};
use super::storage::{Format, Storage};
use super::tune::Tuning;
use super::variant::Variant;
use super::weights::{Terms, loaded, stored};
use super::{Gpu, GpuError};
use crate::network::{Executor, Plan, Precision, Step, Tensor, View, WindowTime};
use crate::sensor::Calibration;
use crate::{Error, Result};

/// Operations from which on a convolution is worth measuring.
const WORTH_TUNING: f64 = 2e7;

/// Bytes of its output in which variants of a convolution have to agree.
const COMPARED_BYTES: usize = 1 << 22;

/// Bytes between the reports of overflow of two steps: bindings may begin at any multiple of it on every adapter.
const OVERFLOW_STRIDE: u64 = 256;

/// Runs one plan on a GPU.
///
/// Pipelines, weights and slots are made once. A window is one command buffer: upload, all steps, and a copy of the
/// result to memory that the CPU can map. [`GpuExecutor::submit`] and [`GpuExecutor::collect`] let a caller prepare
/// the next window while the GPU computes this one.
#[derive(Debug)]
pub struct GpuExecutor {
    gpu: Gpu,
    plan: Plan,
    precision: Precision,
    storage: Storage,
    slots: Vec<wgpu::Buffer>,
    steps: Vec<Recorded>,
    /// What f16 could not hold, by step.
    overflow: wgpu::Buffer,
    /// The power of two in which each tensor is stored, by its number in `storage`.
    units: Vec<f32>,
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

/// How a plan is run.
#[derive(Clone, Copy, Default)]
pub struct Options<'a> {
    /// How feature channels and weights are stored.
    pub precision: Precision,
    /// How convolutions are divided among invocations, instead of what the executor chooses.
    pub variant: Option<Variant>,
    /// Folder in which measured variants are kept; without one, nothing is measured.
    pub tuned_in: Option<&'a Path>,
    /// What is compiled instead of a step's specialised shader, such as a shader that is broken on purpose.
    pub edit: Option<Edit<'a>>,
}

/// A step with all that recording it needs.
#[derive(Debug)]
struct Recorded {
    pipeline: wgpu::ComputePipeline,
    bind_group: wgpu::BindGroup,
    workgroups: [u32; 2],
    /// Terms of a convolution, and where they lie.
    terms: Option<(Terms, wgpu::Buffer)>,
}

/// A window that the GPU works on.
#[derive(Debug)]
struct InFlight {
    download: Download,
    submission: wgpu::SubmissionIndex,
    /// The measurement and its schedule time, where the window may have to be computed again.
    window: Option<(Vec<f32>, i64)>,
}

/// Values on their way from a slot to the CPU.
#[derive(Debug)]
struct Download {
    buffer: wgpu::Buffer,
    view: View,
    format: Format,
    /// What the values are stored in.
    unit: f32,
    mapped: Receiver<Result<(), wgpu::BufferAsyncError>>,
}

impl GpuExecutor {
    /// Windows that can be in flight at once.
    pub const IN_FLIGHT: usize = 2;

    /// Prepares to run `plan` at f32 on what the calibrated camera measured.
    pub fn new(gpu: &Gpu, plan: Plan, calibration: &Calibration) -> Result<Self, GpuError> {
        Self::with_options(gpu, plan, calibration, &Options::default())
    }

    /// As [`GpuExecutor::new`], with options.
    pub fn with_options(
        gpu: &Gpu,
        plan: Plan,
        calibration: &Calibration,
        options: &Options<'_>,
    ) -> Result<Self, GpuError> {
        if let Some(variant) = options.variant.filter(|&variant| !gpu.supports(variant)) {
            return Err(GpuError::Failed(format!("{} cannot run {variant:?}", gpu.name())));
        }
        let storage = Storage::new(&plan, options.precision);
        // Padding is read from zeros behind each slot's values, which nothing writes.
        let mut zeros = vec![0; plan.slots.len()];
        for step in &plan.steps {
            let slot = step.inputs[0].slot;
            zeros[slot] = Storage::zeros_bytes(step).max(zeros[slot]);
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let slots = storage.slot_bytes.iter().zip(zeros).enumerate().map(|(index, (&bytes, zeros))| {
            gpu.buffer(&format!("slot {index} of '{}'", plan.name), (bytes + zeros).max(16) as u64, usage)
        });
        let slots = slots.collect::<Result<Vec<_>, _>>()?;
        let overflow =
            gpu.buffer("reports of overflow", plan.steps.len().max(1) as u64 * OVERFLOW_STRIDE, usage)?;
        let schedule = gpu.buffer("schedule", 16, BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        let mut builder = Builder {
            gpu,
            storage: &storage,
            slots: &slots,
            overflow: &overflow,
            calibration,
            target: Target {
                max_workgroups: gpu.device.limits().max_compute_workgroups_per_dimension,
                abilities: gpu.abilities(),
                variant: options.variant,
            },
            inverse_response: gpu.storage("table of the inverse response", &calibration.inverse_response)?,
            exposures: gpu.storage("table of exposures", &calibration.exposures)?,
            schedule: &schedule,
            layouts: HashMap::new(),
            pipelines: HashMap::new(),
        };
        let mut tuning = options.tuned_in.and_then(|folder| Tuning::open(gpu, folder));
        let steps = plan
            .steps
            .iter()
            .enumerate()
            .map(|(index, step)| builder.record(index, step, options, tuning.as_mut()))
            .collect::<Result<Vec<_>, _>>()?;
        if let Some(tuning) = tuning {
            tuning.save();
        }
        gpu.check()?;
        Ok(Self {
            gpu: gpu.clone(),
            precision: options.precision,
            units: vec![1.0; storage.tensors],
            storage,
            slots,
            steps,
            overflow,
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
        let window = self.start(measurement, schedule)?;
        self.in_flight.push_back(window);
        Ok(())
    }

    /// Waits for the window that was submitted first, and writes its irradiance [hop, H, W] to `result`. Where it met
    /// a value that f16 cannot hold, it is computed again in units that can.
    pub fn collect(&mut self, result: &mut [f32]) -> Result<()> {
        check_len("the result", result.len(), self.plan.result.shape.len())?;
        let Some(InFlight { download, submission, window }) = self.in_flight.pop_front() else {
            return Err(Error::Usage("no window is in flight".into()));
        };
        let mut overflow = self.finish(download, submission, result)?;
        while let (Some(overflowed), Some((measurement, schedule))) = (overflow, &window) {
            self.make_room(overflowed)?;
            let again = self.start(measurement, *schedule)?;
            overflow = self.finish(again.download, again.submission, result)?;
        }
        Ok(())
    }

    /// Submits a window.
    fn start(&mut self, measurement: &[f32], schedule: i64) -> Result<InFlight> {
        self.upload(measurement, schedule)?;
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.clear_buffer(&self.overflow, 0, None);
        Self::encode(&self.steps, &mut encoder);
        let view = self.plan.result;
        let reports = self.overflow.size();
        if let Some(results) = self.gpu.results() {
            let first = schedule + self.plan.window.lead as i64;
            results.keep(&self.gpu, (&self.slots[view.slot], &view), first, &mut encoder);
        }
        let buffer = match self.free.pop() {
            Some(buffer) => buffer,
            None => self.staging(&view, Format::F32, reports)?,
        };
        encoder.copy_buffer_to_buffer(&self.overflow, 0, &buffer, buffer.size() - reports, reports);
        let (download, submission) = self.download(view, Format::F32, 1.0, buffer, encoder);
        let limited = self.storage.steps.iter().any(|step| step.output == Format::F16);
        let window = limited.then(|| (self.upload.clone(), schedule));
        Ok(InFlight { download, submission, window })
    }

    /// Waits for a window and writes its irradiance to `result`. Returns the first step whose result f16 could not hold,
    /// and its largest magnitude.
    fn finish(
        &mut self,
        download: Download,
        submission: wgpu::SubmissionIndex,
        result: &mut [f32],
    ) -> Result<Option<(usize, f32)>> {
        self.gpu.wait(submission)?;
        let mut overflow = None;
        download.read(&self.gpu, |values, reports| {
            for (result, value) in result.iter_mut().zip(values) {
                // Only a net whose weights overflow gets here with anything else than a finite number.
                *result = if value.is_finite() { value } else { 0.0 };
            }
            let magnitudes =
                reports.chunks(OVERFLOW_STRIDE as usize).map(|report| loaded(&report[..4], Format::F32)[0]);
            overflow = magnitudes.enumerate().find(|(_, magnitude)| *magnitude != 0.0);
        })?;
        self.free.push(download.buffer);
        Ok(overflow)
    }

    /// Uploads the measurement and the schedule. What is not finite counts as 0, so that no kernel meets NaN.
    fn upload(&mut self, measurement: &[f32], schedule: i64) -> Result<()> {
        let View { slot, offset, shape, .. } = self.plan.measurement;
        check_len("the measurement", measurement.len(), shape.len())?;
        self.gpu.check()?;
        self.upload.clear();
        self.upload.extend(measurement.iter().map(|&y| if y.is_finite() { y.clamp(0.0, 1.0) } else { 0.0 }));
        let queue = &self.gpu.queue;
        queue.write_buffer(
            &self.slots[slot],
            (offset * Format::F32.bytes()) as u64,
            bytemuck::cast_slice(&self.upload),
        );
        let phase = schedule.rem_euclid(self.period as i64) as u32;
        queue.write_buffer(&self.schedule, 0, bytemuck::cast_slice(&[phase, 0, 0, 0]));
        Ok(())
    }

    fn encode(steps: &[Recorded], encoder: &mut wgpu::CommandEncoder) {
        record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()), steps);
    }

    /// A buffer that the values of `view`, and `more` bytes behind them, can be copied to.
    fn staging(&self, view: &View, format: Format, more: u64) -> Result<wgpu::Buffer, GpuError> {
        let bytes = copied_bytes(view, format) + more;
        self.gpu.buffer("result", bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST)
    }

    /// Submits what is recorded, followed by a copy of `view`.
    fn download(
        &self,
        view: View,
        format: Format,
        unit: f32,
        buffer: wgpu::Buffer,
        mut encoder: wgpu::CommandEncoder,
    ) -> (Download, wgpu::SubmissionIndex) {
        let offset = (view.offset * format.bytes()) as u64;
        encoder.copy_buffer_to_buffer(
            &self.slots[view.slot],
            offset,
            &buffer,
            0,
            copied_bytes(&view, format),
        );
        let submission = self.gpu.queue.submit([encoder.finish()]);
        let (sender, mapped) = mpsc::channel();
        buffer.map_async(MapMode::Read, .., move |outcome| {
            // Nobody listens if the executor is gone.
            let _ = sender.send(outcome);
        });
        (Download { buffer, view, format, unit, mapped }, submission)
    }

    /// Runs one step.
    fn step(&self, index: usize) {
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        Self::encode(&self.steps[index..=index], &mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// The tensor that a view shows.
    fn tensor(&self, view: &View, format: Format, number: usize) -> Result<Tensor, GpuError> {
        let encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let buffer = self.staging(view, format, 0)?;
        let (download, submission) = self.download(*view, format, self.units[number], buffer, encoder);
        self.gpu.wait(submission)?;
        let mut data = Vec::with_capacity(view.shape.len());
        download.read(&self.gpu, |values, _| data.extend(values))?;
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
            let formats = &self.storage.steps[index];
            let inputs = step.inputs.iter().zip(&formats.inputs).zip(&formats.input_tensors);
            let inputs = inputs
                .map(|((view, &format), &number)| self.tensor(view, format, number))
                .collect::<Result<Vec<_>, _>>()?;
            visit(step, &inputs, &self.tensor(&step.output, formats.output, formats.output_tensor)?);
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
        format!("{}, {}", self.gpu.name(), self.precision.name())
    }

    fn rescaled(&self) -> Vec<(String, f32)> {
        let steps = self.plan.steps.iter().zip(&self.storage.steps);
        let units = steps.map(|(step, formats)| (step.name.clone(), self.units[formats.output_tensor]));
        units.filter(|(_, unit)| *unit > 1.0).collect()
    }
}

/// How long another thread may take to report a finished map before it counts as failed.
const CALLBACK_TIME: Duration = Duration::from_secs(10);

impl Download {
    /// Shows the values without padding channels, and the bytes behind them. The submission must be done.
    fn read(
        &self,
        gpu: &Gpu,
        visit: impl FnOnce(&mut dyn Iterator<Item = f32>, &[u8]),
    ) -> Result<(), GpuError> {
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
            let (values, more) = bytes.split_at(copied_bytes(&self.view, self.format) as usize);
            let values = loaded(&values[..span(&self.view) * self.format.bytes()], self.format);
            let channels = self.view.shape.c;
            let pixels = values.chunks(self.view.stride);
            visit(&mut pixels.flat_map(|pixel| &pixel[..channels]).map(|value| value * self.unit), more);
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
    storage: &'a Storage,
    slots: &'a [wgpu::Buffer],
    overflow: &'a wgpu::Buffer,
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
    fn record(
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
        let mut call = self.call(index, step, variant)?;
        if let Some(edit) = options.edit {
            call.text = edit(step, &call.text);
        }
        self.bind(index, step, &call)
    }

    fn call(&self, index: usize, step: &Step, variant: Option<Variant>) -> Result<Call, GpuError> {
        let target = Target { variant, ..self.target };
        let Storage { steps, slot_bytes, .. } = self.storage;
        Call::new(step, &steps[index], slot_bytes, self.calibration, target)
    }

    /// The fastest variant of a convolution, if there was time to find it.
    fn tune(&mut self, index: usize, step: &Step, tuning: &mut Tuning) -> Result<Option<Variant>, GpuError> {
        let gpu = self.gpu.clone();
        let call = self.call(index, step, None)?;
        let Some(extent) = call.extent else { return Ok(None) };
        let candidates = Variant::candidates(extent, self.target.abilities);
        let formats = &self.storage.steps[index];
        let (input, output) = (step.inputs[0].slot, step.output.slot);
        let mut expected: Option<Vec<f32>> = None;
        let variant = tuning.variant(&gpu, &call.text, &candidates, |variant| {
            if expected.is_none() {
                let count = self.storage.slot_bytes[input] / formats.inputs[0].bytes();
                let values: Vec<f32> = (0..count).map(|i| (i * 7 % 31) as f32 / 31.0 - 0.5).collect();
                gpu.queue.write_buffer(&self.slots[input], 0, &stored(&values, formats.inputs[0]));
            }
            let recorded = self.bind(index, step, &self.call(index, step, Some(variant))?)?;
            // Or a variant that writes nothing would show what the one before it wrote.
            clear(&gpu, [&self.slots[output]]);
            let time = time(&gpu, &recorded)?;
            // Not every driver may number the invocations of a subgroup as teams want it.
            let begin = step.output.offset * formats.output.bytes();
            let end = self.storage.slot_bytes[output].min(begin + COMPARED_BYTES);
            let result = loaded(&read(&gpu, &self.slots[output], begin..end)?, formats.output);
            let same = expected.as_ref().is_none_or(|expected| agree(expected, &result));
            expected.get_or_insert(result);
            Ok::<_, GpuError>(same.then_some(time))
        })?;
        if expected.is_some() {
            clear(&gpu, [&self.slots[input], &self.slots[output]]);
        }
        Ok(variant)
    }

    /// Compiles a call and binds its buffers.
    fn bind(&mut self, index: usize, step: &Step, call: &Call) -> Result<Recorded, GpuError> {
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

/// Time of one dispatch of a step: the shortest of several runs, each of them long enough to be measured.
fn time(gpu: &Gpu, step: &Recorded) -> Result<Duration, GpuError> {
    const LONG_ENOUGH: Duration = Duration::from_millis(3);
    let run = |count: u32| {
        let begun = Instant::now();
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for _ in 0..count {
            GpuExecutor::encode(std::slice::from_ref(step), &mut encoder);
        }
        gpu.wait(gpu.queue.submit([encoder.finish()]))?;
        Ok(begun.elapsed())
    };
    run(1)?;
    let once = run(1)?.max(Duration::from_micros(10));
    let count = (LONG_ENOUGH.as_secs_f64() / once.as_secs_f64()).ceil() as u32;
    let mut shortest = Duration::MAX;
    for _ in 0..3 {
        shortest = run(count)?.min(shortest);
    }
    Ok(shortest / count)
}

/// Fills buffers with zeros.
fn clear<const N: usize>(gpu: &Gpu, buffers: [&wgpu::Buffer; N]) {
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    for buffer in buffers {
        encoder.clear_buffer(buffer, 0, None);
    }
    gpu.queue.submit([encoder.finish()]);
}

/// Some bytes of a buffer, from a multiple of 4 to another.
fn read(gpu: &Gpu, buffer: &wgpu::Buffer, range: Range<usize>) -> Result<Vec<u8>, GpuError> {
    let bytes = range.len() as u64;
    let copy = gpu.buffer("result", bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, range.start as u64, &copy, 0, bytes);
    let submission = gpu.queue.submit([encoder.finish()]);
    copy.map_async(MapMode::Read, .., |_| {});
    gpu.wait(submission)?;
    let values = copy.get_mapped_range(..).map_err(|error| GpuError::Failed(error.to_string()))?;
    Ok(values.to_vec())
}

/// Whether two variants computed the same, but for rounding.
fn agree(a: &[f32], b: &[f32]) -> bool {
    const TOLERANCE: f32 = 2e-3;
    let scale = a.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= TOLERANCE * scale)
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

/// Values from the first pixel's first channel to the last pixel's last one.
fn span(view: &View) -> usize {
    view.shape.pixels().checked_sub(1).map_or(0, |last| last * view.stride + view.shape.c)
}

/// Bytes that are copied to read the values of `view`: copies are made in units of four bytes.
fn copied_bytes(view: &View, format: Format) -> u64 {
    (span(view) * format.bytes()).next_multiple_of(4) as u64
}

fn check_len(what: &str, len: usize, wanted: usize) -> Result<()> {
    if len == wanted {
        return Ok(());
    }
    Err(Error::Usage(format!("{what} has {len} values, the plan wants {wanted}")))
}

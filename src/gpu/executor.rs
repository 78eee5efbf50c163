//! Runs a plan on a GPU.

mod download;
mod measure;
mod record;
mod timing;
mod units;

use std::collections::VecDeque;
use std::path::Path;
use std::time::Duration;

use wgpu::BufferUsages;

use self::download::Download;
use self::record::{Buffers, Builder, Recorded, record};
use super::storage::{Format, Formats};
use super::tune::Tuning;
use super::variant::Variant;
use super::weights::loaded;
use super::{Gpu, GpuError};
use crate::network::{
    Carry, Executor, Inspect, Plan, Precision, State, Step, Tensor, View, WindowTime, check_len,
};
use crate::sensor::Calibration;
use crate::{Error, Result};

/// Bytes between what two steps have in one buffer: bindings may begin at any multiple of it on every adapter.
const BINDING_STRIDE: u64 = 256;

/// Runs one plan on a GPU.
///
/// Pipelines, weights and slots are made once. A window is one command buffer: upload, all steps, and a copy of the
/// result to memory that the CPU can map. [`Executor::submit`] and [`Executor::collect`] let a caller prepare
/// the next window while the GPU computes this one.
#[derive(Debug)]
pub struct GpuExecutor {
    gpu: Gpu,
    plan: Plan,
    precision: Precision,
    formats: Formats,
    slots: Vec<wgpu::Buffer>,
    /// All steps: those of a window by itself, then those of one that follows another one.
    steps: Vec<Recorded>,
    /// What f16 could not hold, by step.
    overflow: wgpu::Buffer,
    /// The power of two in which each tensor is stored.
    units: Vec<f32>,
    /// How often a unit has changed: what a window leaves is of use only in the units that it was computed in.
    rescalings: usize,
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

/// A window that the GPU works on.
#[derive(Debug)]
struct InFlight {
    download: Download,
    submission: wgpu::SubmissionIndex,
    /// The measurement and its schedule time, where the window may have to be computed again.
    window: Option<(Vec<f32>, i64)>,
    /// If it follows another window: how often units had changed when that left what it took over.
    follows: Option<usize>,
}

/// What the windows of a sequence leave for each other.
struct Left {
    /// By [`Plan::carries`].
    buffers: Vec<wgpu::Buffer>,
    /// How often units had changed when a window left this.
    rescalings: usize,
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
        let formats = Formats::new(&plan, options.precision);
        // Padding is read from zeros behind each slot's values, which nothing writes.
        let mut zeros = vec![0; plan.slots.len()];
        for step in plan.all_steps() {
            let slot = step.inputs[0].slot;
            zeros[slot] = Formats::zeros_bytes(step).max(zeros[slot]);
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let slots = formats.slot_bytes.iter().zip(zeros).enumerate().map(|(index, (&bytes, zeros))| {
            gpu.buffer(&format!("slot {index} of '{}'", plan.name), (bytes + zeros).max(16) as u64, usage)
        });
        let slots = slots.collect::<Result<Vec<_>, _>>()?;
        let reports = plan.all_steps().count().max(1) as u64 * BINDING_STRIDE;
        let overflow = gpu.buffer("reports of overflow", reports, usage)?;
        let schedule = gpu.buffer("schedule", 16, BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        let buffers = Buffers { slots: &slots, schedule: &schedule, overflow: &overflow };
        let builder = Builder::new(gpu, &plan, &formats, buffers, calibration)?;
        let mut tuning = options.tuned_in.and_then(|folder| Tuning::open(gpu, folder));
        let steps = plan
            .all_steps()
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
            units: vec![1.0; plan.tensors.len()],
            rescalings: 0,
            formats,
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

    /// Submits a window, which takes over what is `left` of the one before if it `follows` that.
    fn start(
        &mut self,
        measurement: &[f32],
        schedule: i64,
        left: Option<&Left>,
        follows: bool,
    ) -> Result<InFlight> {
        self.upload(measurement, schedule)?;
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.clear_buffer(&self.overflow, 0, None);
        self.encode_window(left, follows, &mut encoder);
        let view = self.plan.result;
        let reports = self.overflow.size();
        if let Some(results) = self.gpu.results() {
            let first = schedule + self.plan.window.lead as i64;
            results.keep(&self.gpu, (&self.slots[view.slot], &view), first, &mut encoder);
        }
        let buffer = match self.free.pop() {
            Some(buffer) => buffer,
            None => self.staging(&view, reports)?,
        };
        encoder.copy_buffer_to_buffer(&self.overflow, 0, &buffer, buffer.size() - reports, reports);
        let (download, submission) = self.download(view, buffer, encoder);
        let limited = self.plan.all_steps().any(|step| self.formats.of(&step.output) == Format::F16);
        let window = limited.then(|| (self.upload.clone(), schedule));
        let follows = left.filter(|_| follows).map(|left| left.rescalings);
        Ok(InFlight { download, submission, window, follows })
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
                reports.chunks(BINDING_STRIDE as usize).map(|report| loaded(&report[..4], Format::F32)[0]);
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

    /// The steps of a window by itself, or of one that follows another one.
    fn steps(&self, follows: bool) -> &[Recorded] {
        let (own, following) = self.steps.split_at(self.plan.steps.len());
        if follows { following } else { own }
    }

    /// Records a window, and around its steps the copies of what windows leave for each other.
    fn encode_window(&self, left: Option<&Left>, follows: bool, encoder: &mut wgpu::CommandEncoder) {
        let steps = self.steps(follows);
        let Some(left) = left else { return Self::encode(steps, encoder) };
        let Plan { runs, following, carries, tensors, .. } = &self.plan;
        let runs = following.as_ref().filter(|_| follows).map_or(runs, |following| &following.runs);
        // A pass ends where something has to be copied.
        let (mut begin, mut end) = (0, 0);
        let pass = |begin: &mut usize, end: usize, encoder: &mut wgpu::CommandEncoder| {
            if *begin < end {
                Self::encode(&steps[*begin..end], encoder);
            }
            *begin = end;
        };
        for run in runs {
            for &index in run.restores.iter().filter(|_| follows) {
                pass(&mut begin, end, encoder);
                let Carry { tensor, wanted, .. } = &carries[index];
                let (buffer, slot) = (&left.buffers[index], &self.slots[tensors[tensor.0].slot]);
                let at = (wanted.start * self.formats.of_tensor(*tensor).bytes()) as u64;
                encoder.copy_buffer_to_buffer(buffer, 0, slot, at, buffer.size());
            }
            end = run.pieces.last().map_or(end, |steps| steps.end);
            for &index in &run.saves {
                pass(&mut begin, end, encoder);
                let Carry { tensor, written, .. } = &carries[index];
                let (buffer, slot) = (&left.buffers[index], &self.slots[tensors[tensor.0].slot]);
                let at = (written.start * self.formats.of_tensor(*tensor).bytes()) as u64;
                encoder.copy_buffer_to_buffer(slot, at, buffer, 0, buffer.size());
            }
        }
        pass(&mut begin, end, encoder);
    }

    fn encode(steps: &[Recorded], encoder: &mut wgpu::CommandEncoder) {
        record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()), steps);
    }

    /// Runs one step.
    fn step(&self, index: usize) {
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        Self::encode(&self.steps[index..=index], &mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
    }
}

impl Executor for GpuExecutor {
    fn plan(&self) -> &Plan {
        &self.plan
    }

    fn state(&self) -> Result<State> {
        let usage = BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let buffer = |Carry { tensor, written, .. }: &Carry| {
            let bytes = (written.len() * self.formats.of_tensor(*tensor).bytes()) as u64;
            self.gpu.buffer("what a window leaves", bytes, usage)
        };
        let buffers = self.plan.carries.iter().map(buffer).collect::<Result<_, _>>()?;
        Ok(State::new(Left { buffers, rescalings: self.rescalings }))
    }

    /// Returns while the GPU works.
    fn submit(&mut self, measurement: &[f32], schedule: i64, state: Option<&mut State>) -> Result<()> {
        if self.in_flight.len() == Self::IN_FLIGHT {
            return Err(Error::Misuse(format!(
                "{} windows are in flight; collect one first",
                Self::IN_FLIGHT
            )));
        }
        let (mut follows, mut left) = (false, None);
        if let Some(state) = state {
            let is_next = state.advance(schedule, self.plan.window.hop);
            let known: &mut Left = state.left()?;
            if known.buffers.len() != self.plan.carries.len() {
                return Err(Error::Misuse("a state of another plan".into()));
            }
            follows = is_next && self.plan.following.is_some() && known.rescalings == self.rescalings;
            known.rescalings = self.rescalings;
            left = Some(&*known);
        }
        let window = self.start(measurement, schedule, left, follows)?;
        self.in_flight.push_back(window);
        Ok(())
    }

    /// Where the window met a value that f16 cannot hold, it is computed again in units that can.
    fn collect(&mut self, result: &mut [f32]) -> Result<()> {
        check_len("the result", result.len(), self.plan.result.shape.len())?;
        let Some(InFlight { download, submission, window, follows }) = self.in_flight.pop_front() else {
            return Err(Error::Misuse("no window is in flight".into()));
        };
        let mut overflow = self.finish(download, submission, result)?;
        let Some((measurement, schedule)) = &window else { return Ok(()) };
        // What it took over may be what f16 could not hold, if that came to light behind its submission.
        let mut spoiled = follows.is_some_and(|rescalings| rescalings != self.rescalings);
        while overflow.is_some() || spoiled {
            overflow.map_or(Ok(()), |overflowed| self.make_room(overflowed))?;
            spoiled = false;
            let again = self.start(measurement, *schedule, None, false)?;
            overflow = self.finish(again.download, again.submission, result)?;
        }
        Ok(())
    }

    fn in_flight(&self) -> usize {
        Self::IN_FLIGHT
    }

    fn waiting(&self) -> usize {
        self.in_flight.len()
    }

    fn describe(&self) -> String {
        format!("{}, {}", self.gpu.name(), self.precision.name())
    }
}

impl Inspect for GpuExecutor {
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

    fn rescaled(&self) -> Vec<(String, f32)> {
        let units = self.plan.steps.iter().map(|step| (step.name.clone(), self.units[step.output.tensor.0]));
        units.filter(|(_, unit)| *unit > 1.0).collect()
    }
}

//! Runs a plan on a GPU.

mod arena;
mod download;
mod measure;
mod options;
mod record;
mod timing;
mod units;

use std::collections::VecDeque;
use std::time::Duration;

use wgpu::BufferUsages;

use self::arena::Arena;
use self::download::Download;
pub use self::options::{Edit, ExecutorOptions};
use self::record::{BINDING_STRIDE, Buffers, Builder, Recorded, encode};
use super::storage::TensorFormat;
use super::tune::Tuning;
use super::weights::loaded;
use super::{Gpu, GpuError};
use crate::network::{
    Carry, Executor, Inspect, Plan, Precision, State, Step, Tensor, View, WindowTime, check_len,
};
use crate::sensor::Calibration;
use crate::{Error, Result};

/// Runs one plan on a GPU.
///
/// Pipelines, weights and slots are made once. A window is one command buffer: upload, all steps, and a copy of the
/// result to memory that the CPU can map. [`Executor::submit`] and [`Executor::collect`] let a caller prepare
/// the next window while the GPU computes this one.
#[derive(Debug)]
pub struct GpuExecutor {
    plan: Plan,
    precision: Precision,
    arena: Arena,
    /// All steps: those of a window by itself, then those of one that follows another one.
    steps: Vec<Recorded>,
    /// What f16 could not hold, by step.
    overflow: wgpu::Buffer,
    /// Uniform buffer with the schedule time in the pattern's period.
    schedule: wgpu::Buffer,
    period: usize,
    /// The measurement as it is uploaded.
    upload: Vec<f32>,
    /// Buffers for results that nobody waits for.
    free: Vec<wgpu::Buffer>,
    in_flight: VecDeque<InFlight>,
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
        Self::with_options(gpu, plan, calibration, &ExecutorOptions::default())
    }

    /// As [`GpuExecutor::new`], with options.
    pub fn with_options(
        gpu: &Gpu,
        plan: Plan,
        calibration: &Calibration,
        options: &ExecutorOptions<'_>,
    ) -> Result<Self, GpuError> {
        if let Some(variant) = options.variant.filter(|&variant| !gpu.supports(variant)) {
            return Err(GpuError::Failed(format!("{} cannot run {variant:?}", gpu.name())));
        }
        let arena = Arena::new(gpu, &plan, options.precision)?;
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let reports = plan.all_steps().count().max(1) as u64 * BINDING_STRIDE;
        let overflow = gpu.buffer("reports of overflow", reports, usage)?;
        let schedule = gpu.buffer("schedule", 16, BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        let buffers = Buffers { slots: &arena.slots, schedule: &schedule, overflow: &overflow };
        let builder = Builder::new(gpu, &plan, &arena.formats, buffers, calibration)?;
        let mut tuning = options.tuned_in.and_then(|folder| Tuning::open(gpu, folder));
        let steps = plan
            .all_steps()
            .enumerate()
            .map(|(index, step)| {
                let variant = measure::variant(&builder, index, step, options, tuning.as_mut())?;
                builder.record(index, step, variant, options.edit)
            })
            .collect::<Result<Vec<_>, GpuError>>()?;
        if let Some(tuning) = tuning {
            tuning.save();
        }
        gpu.check()?;
        Ok(Self {
            precision: options.precision,
            arena,
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
        let mut encoder =
            self.arena.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.clear_buffer(&self.overflow, 0, None);
        self.encode_window(left, follows, &mut encoder);
        let view = self.plan.result;
        let reports = self.overflow.size();
        if let Some(results) = self.arena.gpu.results() {
            let first = schedule + self.plan.window.lead as i64;
            let kept = (&self.arena.slots[view.slot], &view);
            results.keep(kept, first, &mut encoder, |bytes, usage| {
                self.arena.gpu.buffer("kept result", bytes, usage)
            });
        }
        let buffer = match self.free.pop() {
            Some(buffer) => buffer,
            None => self.arena.staging(&view, reports)?,
        };
        encoder.copy_buffer_to_buffer(&self.overflow, 0, &buffer, buffer.size() - reports, reports);
        let (download, submission) = self.arena.download(view, buffer, encoder);
        let limited =
            self.plan.all_steps().any(|step| self.arena.formats.of(&step.output) == TensorFormat::F16);
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
        self.arena.gpu.wait(submission)?;
        let mut overflow = None;
        download.read(&self.arena.gpu, |values, reports| {
            for (result, value) in result.iter_mut().zip(values) {
                // Only a net whose weights overflow gets here with anything else than a finite number.
                *result = if value.is_finite() { value } else { 0.0 };
            }
            let magnitudes = reports
                .chunks(BINDING_STRIDE as usize)
                .map(|report| loaded(&report[..4], TensorFormat::F32)[0]);
            overflow = magnitudes.enumerate().find(|(_, magnitude)| *magnitude != 0.0);
        })?;
        self.free.push(download.buffer);
        Ok(overflow)
    }

    /// Uploads the measurement and the schedule. What is not finite counts as 0, so that no kernel meets NaN.
    fn upload(&mut self, measurement: &[f32], schedule: i64) -> Result<()> {
        let View { slot, offset, shape, .. } = self.plan.measurement;
        check_len("the measurement", measurement.len(), shape.len())?;
        self.arena.gpu.check()?;
        self.upload.clear();
        self.upload.extend(measurement.iter().map(|&y| if y.is_finite() { y.clamp(0.0, 1.0) } else { 0.0 }));
        let queue = &self.arena.gpu.queue;
        queue.write_buffer(
            &self.arena.slots[slot],
            (offset * TensorFormat::F32.bytes()) as u64,
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
        let Some(left) = left else { return encode(steps, encoder) };
        let Plan { runs, following, carries, tensors, .. } = &self.plan;
        let runs = following.as_ref().filter(|_| follows).map_or(runs, |following| &following.runs);
        // A pass ends where something has to be copied.
        let (mut begin, mut end) = (0, 0);
        let pass = |begin: &mut usize, end: usize, encoder: &mut wgpu::CommandEncoder| {
            if *begin < end {
                encode(&steps[*begin..end], encoder);
            }
            *begin = end;
        };
        for run in runs {
            for &index in run.restores.iter().filter(|_| follows) {
                pass(&mut begin, end, encoder);
                let Carry { tensor, wanted, .. } = &carries[index];
                let (buffer, slot) = (&left.buffers[index], &self.arena.slots[tensors[tensor.0].slot]);
                let at = (wanted.start * self.arena.formats.of_tensor(*tensor).bytes()) as u64;
                encoder.copy_buffer_to_buffer(buffer, 0, slot, at, buffer.size());
            }
            end = run.pieces.last().map_or(end, |steps| steps.end);
            for &index in &run.saves {
                pass(&mut begin, end, encoder);
                let Carry { tensor, written, .. } = &carries[index];
                let (buffer, slot) = (&left.buffers[index], &self.arena.slots[tensors[tensor.0].slot]);
                let at = (written.start * self.arena.formats.of_tensor(*tensor).bytes()) as u64;
                encoder.copy_buffer_to_buffer(slot, at, buffer, 0, buffer.size());
            }
        }
        pass(&mut begin, end, encoder);
    }

    /// The steps of most windows.
    fn usual_steps(&self) -> &[Recorded] {
        self.steps(self.plan.following.is_some())
    }

    /// Uploads a measurement and waits until it is there.
    fn arrive(&mut self, measurement: &[f32], schedule: i64) -> Result<()> {
        self.upload(measurement, schedule)?;
        let submission = self.arena.gpu.queue.submit([]);
        Ok(self.arena.gpu.wait(submission)?)
    }

    /// Runs one step.
    fn step(&self, index: usize) {
        let mut encoder =
            self.arena.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encode(&self.steps[index..=index], &mut encoder);
        self.arena.gpu.queue.submit([encoder.finish()]);
    }
}

impl Executor for GpuExecutor {
    fn plan(&self) -> &Plan {
        &self.plan
    }

    fn state(&self) -> Result<State> {
        let usage = BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let buffer = |Carry { tensor, written, .. }: &Carry| {
            let bytes = (written.len() * self.arena.formats.of_tensor(*tensor).bytes()) as u64;
            self.arena.gpu.buffer("what a window leaves", bytes, usage)
        };
        let buffers = self.plan.carries.iter().map(buffer).collect::<Result<_, _>>()?;
        Ok(State::new(Left { buffers, rescalings: self.arena.units.rescalings }))
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
            follows =
                is_next && self.plan.following.is_some() && known.rescalings == self.arena.units.rescalings;
            known.rescalings = self.arena.units.rescalings;
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
        let mut spoiled = follows.is_some_and(|rescalings| rescalings != self.arena.units.rescalings);
        while overflow.is_some() || spoiled {
            if let Some(overflowed) = overflow {
                let Arena { gpu, units, .. } = &mut self.arena;
                units.make_room(gpu, &self.plan, &self.steps, overflowed)?;
            }
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
        format!("{}, {}", self.arena.gpu.name(), self.precision.name())
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
            let inputs =
                step.inputs.iter().map(|view| self.arena.tensor(view)).collect::<Result<Vec<_>, _>>()?;
            visit(step, &inputs, &self.arena.tensor(&step.output)?);
        }
        Ok(())
    }

    fn time_windows(&mut self, measurement: &[f32], schedule: i64, windows: usize) -> Result<WindowTime> {
        self.arrive(measurement, schedule)?;
        Ok(timing::time_windows(&self.arena.gpu, self.usual_steps(), windows)?)
    }

    fn time_steps(&mut self, measurement: &[f32], schedule: i64) -> Result<Vec<Duration>> {
        self.arrive(measurement, schedule)?;
        Ok(timing::time_steps(&self.arena.gpu, self.usual_steps())?)
    }

    fn rescaled(&self) -> Vec<(String, f32)> {
        let unit = |step: &Step| self.arena.units.of(step.output.tensor);
        let units = self.plan.steps.iter().map(|step| (step.name.clone(), unit(step)));
        units.filter(|(_, unit)| *unit > 1.0).collect()
    }
}

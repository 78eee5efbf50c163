//! Runs a plan on the CPU.

use std::time::{Duration, Instant};

use super::convolution::Packed;
use super::view::{ScratchPool, TensorView, TensorViewMut};
use super::{Call, Real, Simd, pack};
use crate::network::{Executor, Plan, Step, Tensor, View, WindowTime};
use crate::sensor::Calibration;
use crate::{Error, Result};

/// Runs one plan with the CPU kernels, on all threads of the `rayon` pool that it is called from.
///
/// Weights are packed and all tensors are allocated once, when it is made. Results do not depend on the
/// number of threads.
#[derive(Debug)]
pub struct CpuExecutor<R> {
    plan: Plan,
    calibration: Calibration,
    simd: Simd,
    /// Packed weights of each step that has some.
    packed: Vec<Option<Packed<R>>>,
    /// Padding channels are never written and stay zero, or what another tensor left there.
    slots: Vec<Vec<R>>,
    scratch: ScratchPool<R>,
    /// Whether the result's slot holds a window that nobody has collected.
    done: bool,
}

impl<R: Real> CpuExecutor<R> {
    /// Prepares to run `plan` on what the calibrated camera measured, with the widest vectors.
    pub fn new(plan: Plan, calibration: Calibration) -> Self {
        Self::with_simd(plan, calibration, Simd::widest())
    }

    /// As [`new`](Self::new), with convolutions in these vector instructions. Results differ only between
    /// instructions with and without fused multiply-add.
    pub fn with_simd(plan: Plan, calibration: Calibration, simd: Simd) -> Self {
        Self {
            simd,
            packed: plan.steps.iter().map(|step| pack(&step.kernel, simd)).collect(),
            slots: plan.slots.iter().map(|&len| vec![R::ZERO; len]).collect(),
            scratch: ScratchPool::default(),
            done: false,
            plan,
            calibration,
        }
    }

    /// Writes the measurement into its slot. What is not finite counts as 0, so that no kernel meets NaN.
    fn load(&mut self, measurement: &[f32]) -> Result<()> {
        let View { slot, offset, shape, .. } = self.plan.measurement;
        check_len("the measurement", measurement.len(), shape.len())?;
        for (value, &y) in self.slots[slot][offset..].iter_mut().zip(measurement) {
            *value = if y.is_finite() { R::from_f32(y.clamp(0.0, 1.0)) } else { R::ZERO };
        }
        Ok(())
    }

    fn step(&mut self, index: usize, schedule: i64) {
        let step = &self.plan.steps[index];
        // A step never reads the slot that it writes.
        let mut written = std::mem::take(&mut self.slots[step.output.slot]);
        let call = Call {
            kernel: &step.kernel,
            packed: &self.packed[index],
            calibration: &self.calibration,
            schedule: step.schedule(schedule),
            scratch: &self.scratch,
        };
        let input = |i: usize| step.inputs.get(i).map(|view| TensorView::new(&self.slots[view.slot], view));
        call.run(input, TensorViewMut::new(&mut written, &step.output));
        self.slots[step.output.slot] = written;
    }

    fn tensor(&self, view: &View) -> Tensor {
        let pixels = TensorView::new(&self.slots[view.slot], view).pixels();
        Tensor { shape: view.shape, data: pixels.flatten().map(|v| v.to_f32()).collect() }
    }
}

impl<R: Real> Executor for CpuExecutor<R> {
    fn run(&mut self, measurement: &[f32], schedule: i64, result: &mut [f32]) -> Result<()> {
        check_len("the result", result.len(), self.plan.result.shape.len())?;
        self.submit(measurement, schedule)?;
        self.collect(result)
    }

    fn submit(&mut self, measurement: &[f32], schedule: i64) -> Result<()> {
        if self.done {
            return Err(Error::Usage("a window is computed; collect it first".into()));
        }
        self.load(measurement)?;
        for index in 0..self.plan.steps.len() {
            self.step(index, schedule);
        }
        self.done = true;
        Ok(())
    }

    fn collect(&mut self, result: &mut [f32]) -> Result<()> {
        let view = self.plan.result;
        check_len("the result", result.len(), view.shape.len())?;
        if !std::mem::take(&mut self.done) {
            return Err(Error::Usage("no window was submitted".into()));
        }
        let pixels = TensorView::new(&self.slots[view.slot], &view).pixels();
        for (result, value) in result.iter_mut().zip(pixels.flatten()) {
            let value = value.to_f32();
            // Only a net whose weights overflow gets here with anything else than a finite number.
            *result = if value.is_finite() { value } else { 0.0 };
        }
        Ok(())
    }

    fn in_flight(&self) -> usize {
        1
    }

    fn trace(
        &mut self,
        measurement: &[f32],
        schedule: i64,
        visit: &mut dyn FnMut(&Step, &[Tensor], &Tensor),
    ) -> Result<()> {
        self.load(measurement)?;
        for index in 0..self.plan.steps.len() {
            let inputs: Vec<Tensor> =
                self.plan.steps[index].inputs.iter().map(|view| self.tensor(view)).collect();
            self.step(index, schedule);
            let step = &self.plan.steps[index];
            visit(step, &inputs, &self.tensor(&step.output));
        }
        Ok(())
    }

    fn time_windows(&mut self, measurement: &[f32], schedule: i64, windows: usize) -> Result<WindowTime> {
        self.load(measurement)?;
        let begun = Instant::now();
        for _ in 0..windows {
            for index in 0..self.plan.steps.len() {
                self.step(index, schedule);
            }
        }
        Ok(WindowTime { wall: begun.elapsed(), device: None })
    }

    fn time_steps(&mut self, measurement: &[f32], schedule: i64) -> Result<Vec<Duration>> {
        self.load(measurement)?;
        let steps = 0..self.plan.steps.len();
        let time = |index| {
            let begun = Instant::now();
            self.step(index, schedule);
            begun.elapsed()
        };
        Ok(steps.map(time).collect())
    }

    fn describe(&self) -> String {
        format!("cpu, {} threads, {}, {}", rayon::current_num_threads(), R::NAME, self.simd.name())
    }
}

fn check_len(what: &str, len: usize, wanted: usize) -> Result<()> {
    if len == wanted {
        return Ok(());
    }
    Err(Error::Usage(format!("{what} has {len} values, the plan wants {wanted}")))
}

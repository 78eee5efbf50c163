//! Runs a plan on the CPU.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::call::KernelCall;
use super::convolution::Packed;
use super::convolution_twin::pack;
use super::view::{ScratchPool, Spare, TensorView, TensorViewMut};
use super::{Real, Simd};
use crate::network::{
    Carry, ConvolutionStep, Executor, Following, Inspect, Plan, Run, State, Step, Tensor, View, WindowTime,
    check_len,
};
use crate::sensor::Calibration;
use crate::{Error, Result};

/// Bytes of inner slots up to which each piece of a run gets its own. Larger ones would fit into no cache anyway.
const SIDE_BY_SIDE: usize = 16 << 20;

/// Pixel values that a task takes over.
const LOADED: usize = 1 << 14;

/// Runs one plan with the CPU kernels, on all threads of the `rayon` pool that it is called from.
///
/// Weights are packed once, and tensors stay allocated. Results do not depend on the number of threads.
#[derive(Debug)]
pub struct CpuExecutor<R> {
    plan: Plan,
    calibration: Calibration,
    simd: Simd,
    /// Packed weights of each step that has some: of a window by itself, and of one that follows another one.
    packed: [Vec<Option<Arc<Packed<R>>>>; 2],
    shared: Shared<R>,
    /// What the window that was submitted last came to, until it is collected.
    result: Option<Vec<f32>>,
}

/// What executors of one net for windows of different sizes share: packed weights, and an arena.
#[derive(Clone, Debug)]
pub struct Shared<R> {
    weights: Arc<Mutex<PackedWeights<R>>>,
    arena: Arc<Mutex<Arena<R>>>,
}

/// Packed weights by the name of the step and its padding, in which pieces differ, with what they were packed from.
type PackedWeights<R> = HashMap<(String, [usize; 3]), (Arc<ConvolutionStep>, Arc<Packed<R>>)>;

/// What one window is computed in. Slots are as long as the largest plan needs. No result depends on what another
/// tensor or window left there, all of which is finite.
#[derive(Debug)]
struct Arena<R> {
    slots: Vec<Vec<R>>,
    /// Results that were collected.
    free: Vec<Vec<f32>>,
    /// The inner slots of pieces that are computed at the same time.
    inner: Spare<Vec<Vec<R>>>,
    scratch: ScratchPool<R>,
}

impl<R> Default for Shared<R> {
    fn default() -> Self {
        let arena = Arena {
            slots: Vec::new(),
            free: Vec::new(),
            inner: Spare::default(),
            scratch: ScratchPool::default(),
        };
        Self { weights: Arc::default(), arena: Arc::new(Mutex::new(arena)) }
    }
}

impl<R: Real> Shared<R> {
    /// The packed weights of a step that has some.
    fn packed(&self, step: &Step, simd: Simd) -> Option<Arc<Packed<R>>> {
        let conv = step.kernel.convolution()?;
        let key = (step.name.clone(), conv.padding);
        let mut weights = self.weights.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((known, packed)) = weights.get(&key)
            && packed.simd() == simd
            && known.is_same(conv)
        {
            return Some(Arc::clone(packed));
        }
        let packed = Arc::new(pack(conv, simd));
        weights.insert(key, (Arc::clone(conv), Arc::clone(&packed)));
        Some(packed)
    }

    fn arena(&self) -> MutexGuard<'_, Arena<R>> {
        self.arena.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<R: Real> CpuExecutor<R> {
    /// Prepares to run `plan` on what the calibrated camera measured, with the widest vectors.
    pub fn new(plan: Plan, calibration: Calibration) -> Self {
        Self::sharing(plan, calibration, &Shared::default())
    }

    /// As [`new`](Self::new), sharing what can be shared. Executors that share compute one after the other.
    pub fn sharing(plan: Plan, calibration: Calibration, shared: &Shared<R>) -> Self {
        Self::with(plan, calibration, shared.clone(), Simd::widest())
    }

    /// As [`new`](Self::new), with convolutions in these vector instructions. Results differ only between
    /// instructions with and without fused multiply-add.
    pub fn with_simd(plan: Plan, calibration: Calibration, simd: Simd) -> Self {
        Self::with(plan, calibration, Shared::default(), simd)
    }

    fn with(plan: Plan, calibration: Calibration, shared: Shared<R>, simd: Simd) -> Self {
        let following = plan.following.as_ref().map_or(&[][..], |following| &following.steps);
        let packed = [&plan.steps, following]
            .map(|steps| steps.iter().map(|step| shared.packed(step, simd)).collect());
        Self { plan, calibration, simd, packed, shared, result: None }
    }

    /// The arena with the measurement in its slot. What is not finite counts as 0, so that no kernel meets NaN.
    fn load(&self, measurement: &[f32]) -> Result<MutexGuard<'_, Arena<R>>> {
        let View { slot, offset, shape, .. } = self.plan.measurement;
        check_len("the measurement", measurement.len(), shape.len())?;
        let mut arena = self.shared.arena();
        if arena.slots.len() < self.plan.slots.len() {
            arena.slots.resize_with(self.plan.slots.len(), Vec::new);
        }
        for (slot, &len) in arena.slots.iter_mut().zip(&self.plan.slots) {
            if slot.len() < len {
                // Fresh zeros cost nothing until they are touched, a copy would.
                *slot = vec![R::ZERO; len];
            }
        }
        let values = &mut arena.slots[slot][offset..][..measurement.len()];
        values.par_chunks_mut(LOADED).zip(measurement.par_chunks(LOADED)).for_each(|(values, measured)| {
            for (value, &y) in values.iter_mut().zip(measured) {
                *value = if y.is_finite() { R::from_f32(y.clamp(0.0, 1.0)) } else { R::ZERO };
            }
        });
        Ok(arena)
    }

    /// The steps of a window by itself, or of one that follows another one.
    fn program(&self, follows: bool) -> Program<'_, R> {
        let [own, other] = &self.packed;
        let Plan { steps, runs, following, .. } = &self.plan;
        if let Some(Following { steps, runs }) = following.as_ref().filter(|_| follows) {
            return Program { executor: self, steps, runs, packed: other, follows };
        }
        Program { executor: self, steps, runs, packed: own, follows: false }
    }

    /// Where a sequence keeps what its windows leave.
    fn left(&self) -> Left<R> {
        self.plan.carries.iter().map(|carry| vec![R::ZERO; carry.written.len()]).collect()
    }
}

/// What windows leave for the following one, by [`Plan::carries`].
type Left<R> = Vec<Vec<R>>;

/// Steps, with what they need.
struct Program<'a, R> {
    executor: &'a CpuExecutor<R>,
    steps: &'a [Step],
    runs: &'a [Run],
    packed: &'a [Option<Arc<Packed<R>>>],
    /// Whether it computes only what the window before has not.
    follows: bool,
}

impl<R: Real> Program<'_, R> {
    /// Computes a window; with what the one before has `left`, and leaves there what the next one needs.
    fn run(&self, arena: &mut Arena<R>, schedule: i64, left: &mut [Vec<R>]) {
        for run in self.runs {
            for &index in run.restores.iter().filter(|_| self.follows) {
                let Carry { tensor, wanted, .. } = &self.executor.plan.carries[index];
                let slot = self.executor.plan.tensors[tensor.0].slot;
                copy(&mut arena.slots[slot][wanted.clone()], &left[index]);
            }
            let bytes = run.inner.iter().map(|(_, len)| len * size_of::<R>()).sum::<usize>();
            if run.pieces.len() > 1 && bytes <= SIDE_BY_SIDE {
                self.side_by_side(arena, run, schedule);
            } else {
                run.pieces.iter().cloned().flatten().for_each(|index| self.step(arena, index, schedule));
            }
            for &index in &run.saves {
                // A window by itself leaves nothing.
                let Some(left) = left.get_mut(index) else { continue };
                let Carry { tensor, written, .. } = &self.executor.plan.carries[index];
                let slot = self.executor.plan.tensors[tensor.0].slot;
                copy(left, &arena.slots[slot][written.clone()]);
            }
        }
    }

    /// Runs one step by itself.
    fn step(&self, arena: &mut Arena<R>, index: usize, schedule: i64) {
        let slot = self.steps[index].output.slot;
        // A step never reads the slot that it writes.
        let mut written = std::mem::take(&mut arena.slots[slot]);
        let mut parts = [SlotPart { slot, begin: 0, values: &mut written }];
        self.piece(index..index + 1, schedule, &arena.slots, &mut parts, &arena.scratch);
        arena.slots[slot] = written;
    }

    /// Runs the pieces of a run at the same time: each writes its own part of what is read later, and has what it leaves
    /// for itself to itself. So threads wait for each other once a run, not once a step.
    fn side_by_side(&self, arena: &mut Arena<R>, run: &Run, schedule: i64) {
        let Arena { slots, scratch, inner, .. } = arena;
        let inner = &*inner;
        let mut pieces: Vec<_> = run.pieces.iter().map(|steps| (steps.clone(), Vec::new())).collect();
        let written = |steps: &Range<usize>, slot: usize| {
            let step = self.steps[steps.clone()].iter().find(|step| step.output.slot == slot)?;
            let View { offset, stride, shape, .. } = step.output;
            Some((offset, shape.pixels() * stride))
        };
        let mut outputs: Vec<(usize, Vec<R>)> = Vec::new();
        for step in run.pieces.iter().flat_map(|steps| &self.steps[steps.clone()]) {
            let slot = step.output.slot;
            if run.inner.iter().all(|(inner, _)| *inner != slot)
                && outputs.iter().all(|(known, _)| *known != slot)
            {
                outputs.push((slot, std::mem::take(&mut slots[slot])));
            }
        }
        for (slot, values) in &mut outputs {
            let (mut rest, mut at) = (&mut values[..], 0);
            for (steps, parts) in &mut pieces {
                let Some((begin, len)) = written(steps, *slot) else { continue };
                let (part, behind) = rest.split_at_mut(begin - at).1.split_at_mut(len);
                parts.push(SlotPart { slot: *slot, begin, values: part });
                (rest, at) = (behind, begin + len);
            }
        }
        pieces.into_par_iter().with_max_len(1).for_each(|(steps, parts)| {
            inner.with(|own| {
                let mut parts = parts;
                own.resize_with(own.len().max(run.inner.len()), Vec::new);
                for (values, &(slot, len)) in own.iter_mut().zip(&run.inner) {
                    values.resize(len.max(values.len()), R::ZERO);
                    parts.push(SlotPart { slot, begin: 0, values });
                }
                self.piece(steps, schedule, slots, &mut parts, scratch);
            });
        });
        for (slot, values) in outputs {
            slots[slot] = values;
        }
    }

    /// Runs steps that write to `parts`, and read from there too.
    fn piece(
        &self,
        steps: Range<usize>,
        schedule: i64,
        slots: &[Vec<R>],
        parts: &mut [SlotPart<'_, R>],
        scratch: &ScratchPool<R>,
    ) {
        for index in steps {
            let step = &self.steps[index];
            let own = parts.iter().position(|part| part.slot == step.output.slot);
            let own = own.expect("a piece has a part of each slot that it writes");
            let written = std::mem::take(&mut parts[own].values);
            let call = KernelCall {
                kernel: &step.kernel,
                packed: self.packed[index].as_deref(),
                calibration: &self.executor.calibration,
                schedule: step.schedule(schedule),
                scratch,
            };
            let input = |i: usize| {
                step.inputs.get(i).map(|view| match parts.iter().find(|part| part.slot == view.slot) {
                    Some(part) => TensorView::new(part.values, &part.place(view)),
                    None => TensorView::new(&slots[view.slot], view),
                })
            };
            call.run(input, TensorViewMut::new(written, &parts[own].place(&step.output)));
            parts[own].values = written;
        }
    }
}

/// A part of a slot, which one piece of a run has for itself.
struct SlotPart<'a, R> {
    slot: usize,
    /// Where it begins in the slot.
    begin: usize,
    values: &'a mut [R],
}

impl<R> SlotPart<'_, R> {
    /// Where a view of the slot lies in it.
    fn place(&self, view: &View) -> View {
        View { offset: view.offset - self.begin, ..*view }
    }
}

impl<R: Real> Arena<R> {
    fn tensor(&self, view: &View) -> Tensor {
        let pixels = TensorView::new(&self.slots[view.slot], view).pixels();
        Tensor { shape: view.shape, data: pixels.flatten().map(|v| v.to_f32()).collect() }
    }
}

/// Copies values, on all threads.
fn copy<R: Real>(to: &mut [R], from: &[R]) {
    to.par_chunks_mut(LOADED).zip(from.par_chunks(LOADED)).for_each(|(to, from)| to.copy_from_slice(from));
}

impl<R: Real> Executor for CpuExecutor<R> {
    fn plan(&self) -> &Plan {
        &self.plan
    }

    fn state(&self) -> Result<State> {
        Ok(State::new(self.left()))
    }

    fn submit(&mut self, measurement: &[f32], schedule: i64, state: Option<&mut State>) -> Result<()> {
        if self.result.is_some() {
            return Err(Error::Misuse("a window is computed; collect it first".into()));
        }
        let mut arena = self.load(measurement)?;
        let (mut follows, mut left) = (false, &mut Left::new());
        if let Some(state) = state {
            follows = state.advance(schedule, self.plan.window.hop);
            left = state.left()?;
            let fits =
                left.iter().map(Vec::len).eq(self.plan.carries.iter().map(|carry| carry.written.len()));
            if !fits {
                return Err(Error::Misuse("a state of another plan".into()));
            }
        }
        self.program(follows).run(&mut arena, schedule, left);
        let mut result = arena.free.pop().unwrap_or_default();
        let view = self.plan.result;
        let pixels = TensorView::new(&arena.slots[view.slot], &view).pixels();
        result.clear();
        // Only a net whose weights overflow gets here with anything else than a finite number.
        let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
        result.extend(pixels.flatten().map(|v| finite(v.to_f32())));
        drop(arena);
        self.result = Some(result);
        Ok(())
    }

    fn collect(&mut self, result: &mut [f32]) -> Result<()> {
        check_len("the result", result.len(), self.plan.result.shape.len())?;
        let Some(values) = self.result.take() else {
            return Err(Error::Misuse("no window was submitted".into()));
        };
        result.copy_from_slice(&values);
        self.shared.arena().free.push(values);
        Ok(())
    }

    fn in_flight(&self) -> usize {
        1
    }

    fn waiting(&self) -> usize {
        usize::from(self.result.is_some())
    }

    fn describe(&self) -> String {
        format!("cpu, {} threads, {}, {}", rayon::current_num_threads(), R::NAME, self.simd.name())
    }
}

impl<R: Real> Inspect for CpuExecutor<R> {
    fn trace(
        &mut self,
        measurement: &[f32],
        schedule: i64,
        visit: &mut dyn FnMut(&Step, &[Tensor], &Tensor),
    ) -> Result<()> {
        let mut arena = self.load(measurement)?;
        let program = self.program(false);
        for (index, step) in program.steps.iter().enumerate() {
            let inputs: Vec<Tensor> = step.inputs.iter().map(|view| arena.tensor(view)).collect();
            program.step(&mut arena, index, schedule);
            visit(step, &inputs, &arena.tensor(&step.output));
        }
        Ok(())
    }

    fn time_windows(&mut self, measurement: &[f32], schedule: i64, windows: usize) -> Result<WindowTime> {
        let mut arena = self.load(measurement)?;
        let program = self.program(true);
        let mut left = self.left();
        let begun = Instant::now();
        for _ in 0..windows {
            program.run(&mut arena, schedule, &mut left);
        }
        Ok(WindowTime { wall: begun.elapsed(), device: None })
    }

    fn time_steps(&mut self, measurement: &[f32], schedule: i64) -> Result<Vec<Duration>> {
        let mut arena = self.load(measurement)?;
        let program = self.program(true);
        let time = |index| {
            let begun = Instant::now();
            program.step(&mut arena, index, schedule);
            begun.elapsed()
        };
        Ok((0..program.steps.len()).map(time).collect())
    }

    /// Nothing is too large for f32, or for f64, that a net can compute.
    fn rescaled(&self) -> Vec<(String, f32)> {
        Vec::new()
    }
}

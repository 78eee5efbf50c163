//! Executors by the size of window that they are for.

use std::collections::HashMap;
use std::collections::hash_map::Entry::{Occupied, Vacant};

use super::Backend;
use super::ensemble::Ensemble;
use super::tiles::Limits;
use crate::cpu::Shared;
use crate::gpu::GpuError;
use crate::network::{Executor, Model, State, Window};
use crate::sensor::{Calibration, Symmetry};
use crate::{Error, Result};

/// Result frames, rows and columns of a window.
pub type WindowExtent = [usize; 3];

/// Executors of one model, made when they are first asked for. Those that were not used for longest go when all
/// together take too much memory.
pub struct Pool {
    backend: Backend,
    model: Model,
    calibration: Calibration,
    entries: HashMap<WindowExtent, Entry>,
    /// Counts uses.
    clock: u64,
    /// The most frequent size.
    described: Option<WindowExtent>,
    limits: Limits,
    /// The size of windows that follow each other at each place of the frame.
    streams: Option<WindowExtent>,
    /// What those windows leave for each other, by their place (row, column) in the frame.
    states: HashMap<[usize; 2], State>,
    /// Poses of a window of which the mean is taken; one: the window as it is.
    poses: Vec<Symmetry>,
    /// What CPU executors have in common.
    shared: Shared<f32>,
}

struct Entry {
    executor: Box<dyn Executor>,
    bytes: u64,
    /// Operations of most windows.
    flop: f64,
    used: u64,
}

fn is_out_of_memory(error: &Error) -> bool {
    matches!(error.cause(), Some(GpuError::OutOfMemory { .. }))
}

/// The model with windows of another number of result frames.
pub fn with_hop(model: &Model, hop: usize) -> Model {
    let mut model = model.clone();
    let Window { frames, hop: before, .. } = model.graph.window;
    model.graph.window.frames = frames - before + hop;
    model.graph.window.hop = hop;
    model
}

impl Pool {
    /// No executors yet. Windows of the size `streams` follow each other at each place, and results are means over `poses`.
    pub fn new(
        backend: &Backend,
        model: &Model,
        calibration: &Calibration,
        streams: Option<WindowExtent>,
        poses: Vec<Symmetry>,
    ) -> Self {
        Self {
            backend: backend.clone(),
            model: model.clone(),
            calibration: calibration.clone(),
            entries: HashMap::new(),
            clock: 0,
            described: None,
            limits: backend.limits(None),
            streams,
            states: HashMap::new(),
            poses,
            shared: Shared::default(),
        }
    }

    /// The executor for windows of `size`, made if there is none.
    fn prepare(&mut self, size: WindowExtent) -> Result<&mut Entry> {
        self.clock += 1;
        if !self.entries.contains_key(&size) {
            let [hop, height, width] = size;
            let model = with_hop(&self.model, hop);
            let plan = self.limits.plan(&model, [height, width], self.streams == Some(size))?;
            let (bytes, flop) = (plan.slot_bytes(size_of::<f32>()) as u64, plan.flop());
            let flop = flop * self.poses.len() as f64;
            while self.entries.values().map(|entry| entry.bytes).sum::<u64>() + bytes > self.limits.total
                && self.drop_oldest()
            {}
            let tuned = self.described == Some(size);
            let executor = loop {
                let made =
                    self.backend.executor_sharing(plan.clone(), &self.calibration, tuned, &self.shared);
                match made {
                    // How much memory there is, a GPU does not say before.
                    Err(error) if is_out_of_memory(&error) && self.drop_oldest() => {}
                    made => break made?,
                }
            };
            let window = model.graph.window;
            let executor = Ensemble::over(executor, &self.poses, window, [height, width], &self.calibration);
            self.entries.insert(size, Entry { executor, bytes, flop, used: 0 });
        }
        let entry = self.entries.get_mut(&size).expect("it was inserted above");
        entry.used = self.clock;
        Ok(entry)
    }

    /// Forgets the executor that was not used for longest, of those that compute nothing; false if there is none.
    fn drop_oldest(&mut self) -> bool {
        let idle = self.entries.iter().filter(|(_, entry)| entry.executor.waiting() == 0);
        let oldest = idle.min_by_key(|(_, entry)| entry.used).map(|(&size, _)| size);
        if oldest.is_some() && oldest == self.streams {
            self.states.clear();
        }
        oldest.is_some_and(|size| self.entries.remove(&size).is_some())
    }

    /// Makes the executor for windows of `size`, the most frequent one, tuned, and says in words what it is, and how many
    /// operations such a window takes.
    pub fn describe(&mut self, size: WindowExtent) -> Result<(String, f64)> {
        self.described = Some(size);
        let Entry { executor, flop, .. } = self.prepare(size)?;
        Ok((executor.describe(), *flop))
    }

    /// Whether a window of `size`, which was prepared for, can be submitted before one is collected.
    pub fn is_free(&self, size: WindowExtent) -> bool {
        self.entries.get(&size).is_none_or(|entry| entry.executor.waiting() < entry.executor.in_flight())
    }

    /// Starts to compute a window of `size` at a place (row, column) of the frame; see [`Executor::submit`]. Returns
    /// [`Executor::in_flight`].
    pub fn submit(
        &mut self,
        size: WindowExtent,
        place: [usize; 2],
        measurement: &[f32],
        schedule: i64,
    ) -> Result<usize> {
        self.prepare(size)?;
        let Self { entries, states, streams, .. } = self;
        let executor = &mut entries.get_mut(&size).expect("it was prepared").executor;
        let state = if *streams == Some(size) {
            Some(match states.entry(place) {
                Occupied(state) => state.into_mut(),
                Vacant(place) => place.insert(executor.state()?),
            })
        } else {
            None
        };
        if let Err(error) = executor.submit(measurement, schedule, state) {
            states.clear();
            return Err(error);
        }
        Ok(executor.in_flight())
    }

    /// The result of the window of `size` that was submitted first.
    pub fn collect(&mut self, size: WindowExtent, result: &mut [f32]) -> Result<()> {
        if let Some(entry) = self.entries.get_mut(&size) {
            entry.executor.collect(result)?;
        }
        Ok(())
    }

    /// Forgets all executors, which may be in any state.
    pub fn clear(&mut self) {
        self.states.clear();
        self.entries.clear();
    }

    /// Forgets all windows that were not collected, and executors that cannot give them.
    pub fn reset(&mut self) {
        self.states.clear();
        let mut unwanted = Vec::new();
        self.entries.retain(|size, entry| {
            unwanted.resize(size.iter().product(), 0.0);
            while entry.executor.waiting() > 0 && entry.executor.collect(&mut unwanted).is_ok() {}
            entry.executor.waiting() == 0
        });
    }
}

//! Executors by the size of window that they are for.

use std::collections::HashMap;

use super::Backend;
use super::ensemble::Ensemble;
use super::tiles::Limits;
use crate::Result;
use crate::cpu::Shared;
use crate::network::{Executor, Model, Window};
use crate::sensor::{Calibration, Symmetry};

/// Result frames, rows and columns of a window.
pub type Size = [usize; 3];

/// Executors of one model, made when they are first asked for. Those that were not used for longest go when all
/// together take too much memory.
pub struct Pool {
    backend: Backend,
    model: Model,
    calibration: Calibration,
    entries: HashMap<Size, Entry>,
    /// Counts uses.
    clock: u64,
    limits: Limits,
    /// The size of windows that mostly follow each other.
    streams: Option<Size>,
    /// Views of a window of which the mean is taken; one: the window as it is.
    views: Vec<Symmetry>,
    /// Size, place and schedule time of the window that was submitted last.
    last: Option<(Size, [usize; 2], i64)>,
    /// What CPU executors have in common.
    shared: Shared<f32>,
}

struct Entry {
    executor: Box<dyn Executor>,
    /// Windows that were submitted and not yet collected.
    waiting: usize,
    bytes: u64,
    /// Operations of most windows.
    flop: f64,
    used: u64,
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
    /// No executors yet. Windows of the size `streams` mostly follow each other, and results are means over `views`.
    pub fn new(
        backend: &Backend,
        model: &Model,
        calibration: &Calibration,
        streams: Option<Size>,
        views: Vec<Symmetry>,
    ) -> Self {
        Self {
            backend: backend.clone(),
            model: model.clone(),
            calibration: calibration.clone(),
            entries: HashMap::new(),
            clock: 0,
            limits: backend.limits(None),
            streams,
            views,
            last: None,
            shared: Shared::default(),
        }
    }

    /// The executor for windows of `size`, made if there is none, and `tuned` then.
    fn prepare(&mut self, size: Size, tuned: bool) -> Result<&mut Entry> {
        self.clock += 1;
        if !self.entries.contains_key(&size) {
            let [hop, height, width] = size;
            let model = with_hop(&self.model, hop);
            let plan = self.limits.plan(&model, [height, width], self.streams == Some(size))?;
            let (bytes, flop) = (plan.slot_bytes(size_of::<f32>()) as u64, plan.flop());
            let flop = flop * self.views.len() as f64;
            while self.entries.values().map(|entry| entry.bytes).sum::<u64>() + bytes > self.limits.total {
                let idle = self.entries.iter().filter(|(_, entry)| entry.waiting == 0);
                let Some((&oldest, _)) = idle.min_by_key(|(_, entry)| entry.used) else { break };
                self.entries.remove(&oldest);
            }
            let executor = self.backend.executor_sharing(plan, &self.calibration, tuned, &self.shared)?;
            let window = model.graph.window;
            let executor = Ensemble::over(executor, &self.views, window, [height, width], &self.calibration);
            self.entries.insert(size, Entry { executor, waiting: 0, bytes, flop, used: 0 });
        }
        let entry = self.entries.get_mut(&size).expect("it was inserted above");
        entry.used = self.clock;
        Ok(entry)
    }

    /// Makes the executor for windows of `size`, the most frequent one, and says in words what it is, and how many
    /// operations such a window takes.
    pub fn describe(&mut self, size: Size) -> Result<(String, f64)> {
        let Entry { executor, flop, .. } = self.prepare(size, true)?;
        Ok((executor.describe(), *flop))
    }

    /// Whether a window of `size`, which was prepared for, can be submitted before one is collected.
    pub fn is_free(&self, size: Size) -> bool {
        self.entries.get(&size).is_none_or(|entry| entry.waiting < entry.executor.in_flight())
    }

    /// Starts to compute a window of `size` at a place (row, column) of the frame; see [`Executor::submit`]. Returns
    /// [`Executor::in_flight`].
    pub fn submit(
        &mut self,
        size: Size,
        place: [usize; 2],
        measurement: &[f32],
        schedule: i64,
    ) -> Result<usize> {
        let before = self.last.replace((size, place, schedule));
        let entry = self.prepare(size, false)?;
        if before == Some((size, place, schedule - size[0] as i64)) {
            entry.executor.follow(measurement, schedule)?;
        } else {
            entry.executor.submit(measurement, schedule)?;
        }
        entry.waiting += 1;
        Ok(entry.executor.in_flight())
    }

    /// The result of the window of `size` that was submitted first.
    pub fn collect(&mut self, size: Size, result: &mut [f32]) -> Result<()> {
        if let Some(entry) = self.entries.get_mut(&size) {
            entry.executor.collect(result)?;
            entry.waiting -= 1;
        }
        Ok(())
    }

    /// Forgets all executors, which may be in any state.
    pub fn clear(&mut self) {
        self.last = None;
        self.entries.clear();
    }

    /// Forgets all windows that were not collected, with their executors.
    pub fn reset(&mut self) {
        self.last = None;
        self.entries.retain(|_, entry| entry.waiting == 0);
    }
}

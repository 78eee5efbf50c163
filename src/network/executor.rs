//! What every executor of a plan can do.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::plan::{Plan, Step};
use super::state::State;
use super::tensor::Tensor;
use crate::{Error, Result};

/// How long an executor computed.
#[derive(Clone, Copy, Debug)]
pub struct WindowTime {
    /// On the caller's clock, with the way to the device.
    pub wall: Duration,
    /// On the device's own clock, where it has one.
    pub device: Option<Duration>,
}

/// How tensors of feature channels and weights are stored; all arithmetic is f32, and so are scalars.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32 bits.
    #[default]
    F32,
    /// 16 bits.
    F16,
}

impl Precision {
    /// Its name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
        }
    }
}

/// Runs one [`Plan`], window after window.
pub trait Executor: Send {
    /// The plan.
    fn plan(&self) -> &Plan;

    /// The state of a sequence of windows, of which none was computed.
    fn state(&self) -> Result<State>;

    /// Starts to compute a window. An executor whose work is done elsewhere returns while it is being done. At most
    /// [`Executor::in_flight`] windows may be submitted and not yet collected.
    ///
    /// `measurement` holds pixel values [frames, H, W] as the plan's measurement view wants them; `schedule` is the
    /// schedule time of its first frame. A window of a sequence comes with the `state` of that sequence alone.
    fn submit(&mut self, measurement: &[f32], schedule: i64, state: Option<&mut State>) -> Result<()>;

    /// Waits for the window that was submitted first, and writes its irradiance [hop, H, W] to `result`.
    fn collect(&mut self, result: &mut [f32]) -> Result<()>;

    /// How many windows can be submitted before one is collected.
    fn in_flight(&self) -> usize;

    /// How many windows were submitted and not yet collected.
    fn waiting(&self) -> usize;

    /// One line for reports, such as "cpu, 2 threads, f32, AVX2" or "Vulkan: llvmpipe, f32".
    fn describe(&self) -> String;

    /// Runs all steps on one window by itself: [`Executor::submit`], then [`Executor::collect`].
    fn run(&mut self, measurement: &[f32], schedule: i64, result: &mut [f32]) -> Result<()> {
        check_len("the result", result.len(), self.plan().result.shape.len())?;
        if self.waiting() > 0 {
            return Err(Error::Misuse("a window was submitted; collect it first".into()));
        }
        self.submit(measurement, schedule, None)?;
        self.collect(result)
    }
}

/// Looks inside of an executor: what its steps compute, and how long they take.
pub trait Inspect: Executor {
    /// Runs one window and shows each step with the tensors that it read and the one that it wrote, so that two executors
    /// can be compared step by step.
    fn trace(
        &mut self,
        measurement: &[f32],
        schedule: i64,
        visit: &mut dyn FnMut(&Step, &[Tensor], &Tensor),
    ) -> Result<()>;

    /// Computes one window `windows` times in a row, and says how long that took: inference alone, since the measurement
    /// is there before the clock starts, and no result is read.
    ///
    /// Of a plan for streams, a window that follows another one.
    fn time_windows(&mut self, measurement: &[f32], schedule: i64, windows: usize) -> Result<WindowTime>;

    /// Runs one window step by step, and gives the time that each one took, in the order of [`Plan::usual_steps`].
    fn time_steps(&mut self, measurement: &[f32], schedule: i64) -> Result<Vec<Duration>>;

    /// Steps whose results met a value that the precision cannot hold and so are stored in larger units, and the units.
    fn rescaled(&self) -> Vec<(String, f32)>;
}

/// Refuses values of another number than a plan wants.
pub(crate) fn check_len(what: &str, len: usize, wanted: usize) -> Result<()> {
    if len == wanted {
        return Ok(());
    }
    Err(Error::Misuse(format!("{what} has {len} values, the plan wants {wanted}")))
}

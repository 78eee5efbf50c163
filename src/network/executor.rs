//! What every executor of a plan can do.

use super::{Step, Tensor};
use crate::Result;

/// How tensors of feature channels and weights are stored; all arithmetic is f32, and so are scalars.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
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

/// Runs one [`Plan`](super::Plan), window after window.
pub trait Executor: Send {
    /// Runs all steps on one window.
    ///
    /// `measurement` holds pixel values [frames, H, W] as the plan's measurement view wants them; `schedule`
    /// is the schedule time of its first frame. `result` receives irradiance [hop, H, W].
    fn run(&mut self, measurement: &[f32], schedule: i64, result: &mut [f32]) -> Result<()>;

    /// Runs one window and shows each step with the tensors that it read and the one that it wrote, so that
    /// two executors can be compared step by step.
    fn trace(
        &mut self,
        measurement: &[f32],
        schedule: i64,
        visit: &mut dyn FnMut(&Step, &[Tensor], &Tensor),
    ) -> Result<()>;

    /// One line for reports, such as "cpu, 2 threads, f32" or "Vulkan: llvmpipe, f32".
    fn describe(&self) -> String;
}

//! The benchmark of run time against error.
//!
//! [`Case::measure`] makes one [`Row`]: how long a net takes on one executor and one [`Clip`], held against what the
//! executor's hardware can do at most ([`Peak`]), and how good and how exact its result is. [`Floors`] says how fast a
//! plan can be at best, [`frontier`] draws run time against error.

mod check;
mod clip;
mod detection;
mod floors;
mod frontier;
mod machine;
mod measure;
mod samples;
mod sensitivity;
mod soak;
pub mod stability;

use crate::ModuleError;

/// A figure that the program itself promises was not kept.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct CheckFailed(pub String);

impl ModuleError for CheckFailed {}

pub use check::Oracle;
pub use clip::Clip;
pub use detection::{DetectionRate, detection};
pub use floors::{Floors, Peak, Work};
pub use frontier::frontier;
pub use machine::{Machine, ProcessorPeak};
pub use measure::{Case, Effort, LayerTime, Row};
pub use samples::Samples;
pub use sensitivity::{Sensitivity, sensitivity};
pub use soak::{Soak, soak};

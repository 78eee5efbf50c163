//! What can be chosen of how a plan is run.

use std::path::Path;

use crate::gpu::variant::Variant;
use crate::network::{Precision, Step};

/// Changes the specialised text of a step's shader.
pub type Edit<'a> = &'a dyn Fn(&Step, &str) -> String;

/// How a plan is run.
#[derive(Clone, Copy, Default)]
pub struct ExecutorOptions<'a> {
    /// How feature channels and weights are stored.
    pub precision: Precision,
    /// How convolutions are divided among invocations, instead of what the executor chooses.
    pub variant: Option<Variant>,
    /// Folder in which measured variants are kept; without one, nothing is measured.
    pub tuned_in: Option<&'a Path>,
    /// What is compiled instead of a step's specialised shader, such as a shader that is broken on purpose.
    pub edit: Option<Edit<'a>>,
}

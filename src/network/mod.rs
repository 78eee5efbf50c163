//! The networks: a layer graph as data, its weights, and the plan that executors run.
//!
//! `weights-format/README.md` is the specification. A [`Graph`] names the operations, a [`Model`] adds the
//! tensors, [`Plan::lower`] turns both into steps over a few reused buffers for one window size, and an
//! [`Executor`] runs the steps.

mod executor;
mod graph;
mod model;
mod news;
mod pieces;
mod plan;
pub mod presets;
mod slots;
mod tensor;

pub(crate) use executor::check_len;
pub use executor::{Executor, Precision, WindowTime};
pub use graph::{Activation, Block, Convolution, Direction, Feature, Graph, Node, Op, Tap, Window};
pub use model::{Layer, Model, Trained};
pub use plan::{
    Carry, Channel, ConvolutionStep, Following, Kernel, Plan, PlannedTensor, Run, Step, TensorId, View,
};
pub use tensor::{Shape, Tensor};

pub use crate::math::MU;

/// Pixel value from which a read-out counts as saturated (design §4, box filter).
pub const SATURATED: f64 = 0.98;

/// What can be wrong with a graph or a weights file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The file is not a weights file of this format.
    #[error("not a pix2hdr weights file: {0}")]
    Format(String),
    /// A node of the graph is wrong.
    #[error("graph node '{node}': {problem}")]
    Node {
        /// The node's name.
        node: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The graph as a whole is wrong.
    #[error("graph '{0}': {1}")]
    Graph(String, String),
    /// A tensor is missing, superfluous, of the wrong shape or type, or not finite.
    #[error("tensor '{tensor}': {problem}")]
    Tensor {
        /// The tensor's name.
        tensor: String,
        /// What is wrong with it.
        problem: String,
    },
    /// No preset of that name.
    #[error("no weights file or preset '{0}'; presets are {1}")]
    NoPreset(String, String),
    /// The preset has no trained weights.
    #[error("preset '{0}' has no trained weights yet; train it, or name a weights file")]
    Untrained(String),
}

impl crate::error::ModuleError for NetworkError {}

//! The networks: a layer graph as data, its weights, and the plan that executors run.
//!
//! `weights-format/README.md` is the specification. A [`Graph`] names the operations, a [`Model`] adds the
//! tensors, [`Plan::lower`] turns both into steps over a few reused buffers for one window size, and an
//! [`Executor`] runs the steps.

mod error;
mod executor;
mod following;
mod graph;
mod kernel;
mod lowering;
mod model;
mod op;
mod pieces;
mod plan;
pub mod presets;
mod slots;
mod state;
mod tensor;

pub use error::NetworkError;
pub(crate) use executor::check_len;
pub use executor::{Executor, Inspect, Precision, WindowTime};
pub use graph::{Graph, Node, Window};
pub use kernel::{
    Activation, Channel, Convolution, ConvolutionStep, Direction, Feature, Fold, Layer, Parameter, Tap,
};
pub use model::{Model, Trained};
pub(crate) use op::for_each_operation;
pub use op::*;
pub use plan::{Carry, Following, Footprint, Plan, PlannedTensor, Run, Step, TensorId, View};
pub use state::State;
pub use tensor::{Shape, Tensor};

pub use crate::math::MU;

/// Pixel value from which a read-out counts as saturated (design §4, box filter).
pub const SATURATED: f64 = 0.98;

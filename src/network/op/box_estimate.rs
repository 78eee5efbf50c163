//! The box filter of design §4.

use serde::{Deserialize, Serialize};

use super::operation::{Computed, Computes, Kind, Operation, Parts, exactly};
use super::relation::Relation;
use crate::network::kernel::Parameter;
use crate::network::tensor::Shape;

/// The box filter: measurement → estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BoxEstimate {}

impl Operation for BoxEstimate {
    fn wants(&self, _input: usize) -> Kind {
        Kind::Scalar
    }

    fn gives(&self) -> Kind {
        Kind::Scalar
    }

    fn shape(&self, inputs: &[Shape], _measurement: Shape) -> Result<Shape, String> {
        let [measurement] = exactly(inputs)?;
        Ok(measurement)
    }

    fn relation(&self, _input: usize) -> [Relation; 3] {
        [Relation::SAME, Relation::near(1, 1), Relation::near(1, 1)]
    }

    fn sees_camera(&self) -> bool {
        true
    }
}

impl Computed for BoxEstimate {
    type Step = Self;

    fn step(&self, _parts: &Parts<'_>) -> Self {
        *self
    }
}

impl Computes for BoxEstimate {
    fn parameters(&self) -> Vec<(&'static str, Parameter)> {
        Vec::new()
    }
}

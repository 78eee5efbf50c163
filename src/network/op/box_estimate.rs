//! The box filter of design §4.

use super::operation::{Kind, Operation, Parts, exactly};
use super::relation::Relation;
use crate::network::kernel::Kernel;
use crate::network::tensor::Shape;

pub struct BoxEstimate;

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

    fn kernel(&self, _parts: &Parts<'_>) -> Option<Kernel> {
        Some(Kernel::BoxEstimate)
    }
}

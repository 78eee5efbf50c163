//! l(R⁻¹(y)/e) of every pixel.

use super::operation::{Kind, Operation, Parts, exactly};
use super::relation::Relation;
use crate::network::kernel::Kernel;
use crate::network::tensor::Shape;

pub struct LogIrradiance;

impl Operation for LogIrradiance {
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
        [Relation::SAME; 3]
    }

    fn sees_camera(&self) -> bool {
        true
    }

    fn kernel(&self, _parts: &Parts<'_>) -> Option<Kernel> {
        Some(Kernel::LogIrradiance)
    }
}

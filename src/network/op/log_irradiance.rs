//! l(R⁻¹(y)/e) of every pixel.

use serde::{Deserialize, Serialize};

use super::operation::{Computed, Computes, Kind, Operation, Parts, exactly};
use super::relation::Relation;
use crate::network::kernel::Parameter;
use crate::network::tensor::Shape;

/// Log irradiance of the measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LogIrradiance {}

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
}

impl Computed for LogIrradiance {
    type Step = Self;

    fn step(&self, _parts: &Parts<'_>) -> Self {
        *self
    }
}

impl Computes for LogIrradiance {
    fn parameters(&self) -> Vec<(&'static str, Parameter)> {
        Vec::new()
    }
}

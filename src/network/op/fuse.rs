//! Weighted fusion (eq. 23).

use serde::{Deserialize, Serialize};

use super::operation::{Computed, Computes, Kind, Operation, Parts, exactly};
use super::relation::Relation;
use crate::network::kernel::Parameter;
use crate::network::tensor::Shape;

/// Weighted mean: weights, (pixel values and) irradiance → radiance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fuse {}

impl Operation for Fuse {
    fn wants(&self, _input: usize) -> Kind {
        Kind::Channels
    }

    fn gives(&self) -> Kind {
        Kind::Scalar
    }

    fn shape(&self, inputs: &[Shape], _measurement: Shape) -> Result<Shape, String> {
        let [weights, rendered] = exactly(inputs)?;
        if weights.extent() != rendered.extent() || 2 * weights.c != rendered.c {
            return Err(format!("weights {weights} do not fit {rendered}"));
        }
        Ok(Shape { c: 1, ..weights })
    }

    fn relation(&self, _input: usize) -> [Relation; 3] {
        [Relation::SAME; 3]
    }

    fn sees_camera(&self) -> bool {
        false
    }
}

impl Computed for Fuse {
    type Step = Self;

    fn step(&self, _parts: &Parts<'_>) -> Self {
        *self
    }
}

impl Computes for Fuse {
    fn parameters(&self) -> Vec<(&'static str, Parameter)> {
        Vec::new()
    }
}

//! Channels one behind the other: nothing is computed where inputs are written to their places at once.

use serde::{Deserialize, Serialize};

use super::operation::{Kind, Operation};
use super::relation::Relation;
use crate::network::tensor::Shape;

/// Channels one behind the other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Concat {}

impl Operation for Concat {
    fn wants(&self, _input: usize) -> Kind {
        Kind::Channels
    }

    fn gives(&self) -> Kind {
        Kind::Channels
    }

    fn shape(&self, inputs: &[Shape], _measurement: Shape) -> Result<Shape, String> {
        let [first, .., _] = inputs else {
            return Err("wants two inputs or more".into());
        };
        if inputs.iter().any(|s| s.extent() != first.extent()) {
            return Err("its inputs differ in extent".into());
        }
        if inputs[..inputs.len() - 1].iter().any(|s| s.c % 4 != 0) {
            return Err("all inputs but the last need a multiple of 4 channels".into());
        }
        Ok(Shape { c: inputs.iter().map(|s| s.c).sum(), ..*first })
    }

    fn relation(&self, _input: usize) -> [Relation; 3] {
        [Relation::SAME; 3]
    }

    fn sees_camera(&self) -> bool {
        false
    }
}

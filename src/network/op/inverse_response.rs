//! Rendered pixel values to irradiance (eq. 22).

use serde::{Deserialize, Serialize};

use super::operation::{Computed, Computes, Kind, Operation, Parts, exactly};
use super::relation::Relation;
use crate::network::kernel::Parameter;
use crate::network::tensor::Shape;

/// Parameters of [`Op::InverseResponse`](super::Op).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InverseResponse {
    /// Exposure of each channel, in frames.
    pub exposures: Vec<f32>,
}

impl Operation for InverseResponse {
    fn wants(&self, _input: usize) -> Kind {
        Kind::Channels
    }

    fn gives(&self) -> Kind {
        Kind::Channels
    }

    fn shape(&self, inputs: &[Shape], _measurement: Shape) -> Result<Shape, String> {
        let [values] = exactly(inputs)?;
        let Self { exposures } = self;
        if exposures.len() != values.c || !exposures.iter().all(|e| e.is_finite() && *e > 0.0) {
            return Err(format!("exposures {exposures:?} for {} channels", values.c));
        }
        Ok(Shape { c: 2 * values.c, ..values })
    }

    fn relation(&self, _input: usize) -> [Relation; 3] {
        [Relation::SAME; 3]
    }

    // Exposures are the net's own.
    fn sees_camera(&self) -> bool {
        false
    }
}

impl Computed for InverseResponse {
    type Step = Self;

    fn step(&self, _parts: &Parts<'_>) -> Self {
        self.clone()
    }
}

impl Computes for InverseResponse {
    fn parameters(&self) -> Vec<(&'static str, Parameter)> {
        vec![("rendered_exposures", Parameter::Floats(self.exposures.clone()))]
    }
}

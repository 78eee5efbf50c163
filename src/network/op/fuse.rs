//! Weighted fusion (eq. 23).

use super::operation::{Kind, Operation, Parts, exactly};
use super::relation::Relation;
use crate::network::kernel::Kernel;
use crate::network::tensor::Shape;

pub struct Fuse;

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

    fn kernel(&self, _parts: &Parts<'_>) -> Option<Kernel> {
        Some(Kernel::Fuse)
    }
}

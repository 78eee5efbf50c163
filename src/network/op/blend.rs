//! Predicted kernels: weights w and a residual d for each pixel, log irradiance, estimate → the radiance whose log is
//! l(estimate) + Σ w·(log irradiance of the tap − l(estimate)) + d.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::operation::{Computed, Computes, Kind, MAX_EXTENT, Operation, Parts, around, exactly};
use super::relation::{Relation, Scale};
use crate::network::kernel::{Fold, Parameter, Tap};
use crate::network::tensor::Shape;

/// Parameters of [`Op::Blend`](super::Op).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Blend {
    /// Block that is unfolded; it spans one frame.
    pub block: Fold,
    /// Pixels, as offsets t, y, x from the result's, that the weights are for. Those outside do not count. All steps of a
    /// plan share them.
    #[serde(with = "shared")]
    pub taps: Arc<[Tap]>,
}

impl Operation for Blend {
    fn wants(&self, input: usize) -> Kind {
        if input == 0 { Kind::Channels } else { Kind::Scalar }
    }

    fn gives(&self) -> Kind {
        Kind::Scalar
    }

    fn shape(&self, inputs: &[Shape], _measurement: Shape) -> Result<Shape, String> {
        let [weights, logs, estimate] = exactly(inputs)?;
        let Self { block, taps } = self;
        let per_pixel = taps.len() + 1;
        if block[0] != 1
            || !block.iter().all(|b| (1..=MAX_EXTENT).contains(b))
            || block.iter().product::<usize>() * per_pixel != weights.c
        {
            return Err(format!("block {block:?} for {} channels", weights.c));
        }
        if taps.iter().flatten().any(|offset| offset.unsigned_abs() as usize > MAX_EXTENT) {
            return Err(format!("taps {taps:?}"));
        }
        let extent = weights.extent();
        let shape = Shape::new(std::array::from_fn(|i| extent[i] * block[i]), 1);
        if [logs, estimate].iter().any(|input| *input != shape) {
            return Err(format!("{shape} does not fit {logs} and {estimate}"));
        }
        Ok(shape)
    }

    fn relation(&self, input: usize) -> [Relation; 3] {
        match input {
            0 => self.block.map(|n| Relation { scale: Scale::Unfold(n), before: 0, after: 0 }),
            1 => std::array::from_fn(|axis| {
                let (before, after) = around(self.taps.iter().map(|tap| tap[axis]));
                Relation::near(before, after)
            }),
            _ => [Relation::SAME; 3],
        }
    }

    fn sees_camera(&self) -> bool {
        false
    }
}

/// Predicted kernels: weights and residual, log irradiance, estimate → radiance.
#[derive(Clone, Debug)]
pub struct BlendStep {
    /// Block that is unfolded; it spans one frame.
    pub block: Fold,
    /// Offsets t, y, x of the pixels that the weights are for. Those outside of the log irradiance do not count.
    pub taps: Arc<[Tap]>,
    /// Frame and row of the log irradiance at which the result begins.
    pub origin: [usize; 2],
}

impl Computed for Blend {
    type Step = BlendStep;

    fn step(&self, parts: &Parts<'_>) -> BlendStep {
        let origin = parts.origins[1].map(isize::unsigned_abs);
        BlendStep { block: self.block, taps: Arc::clone(&self.taps), origin }
    }
}

impl Computes for BlendStep {
    fn parameters(&self) -> Vec<(&'static str, Parameter)> {
        let Self { block, taps, origin: [t, y] } = self;
        let along = |axis: usize| Parameter::Integers(taps.iter().map(|tap| tap[axis]).collect());
        vec![
            ("block", Parameter::Axes(*block)),
            ("taps", Parameter::Integer(taps.len())),
            ("tap_t", along(0)),
            ("tap_y", along(1)),
            ("tap_x", along(2)),
            ("origin_t", Parameter::Integer(*t)),
            ("origin_y", Parameter::Integer(*y)),
        ]
    }
}

/// Taps in a file are a list like any other.
mod shared {
    use std::sync::Arc;

    use serde::{Deserialize, Serialize};

    use crate::network::kernel::Tap;

    pub fn serialize<S: serde::Serializer>(taps: &Arc<[Tap]>, serializer: S) -> Result<S::Ok, S::Error> {
        taps[..].serialize(serializer)
    }

    pub fn deserialize<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Arc<[Tap]>, D::Error> {
        Ok(Vec::deserialize(deserializer)?.into())
    }
}

//! Input normalisation, and folding of blocks into channels: measurement, estimate (, log irradiance).

use serde::{Deserialize, Serialize};

use super::operation::{Kind, MAX_EXTENT, MAX_FRAMES, Operation, Parts, around};
use super::relation::{Relation, Scale};
use crate::network::kernel::{Channel, Feature, Fold, Kernel};
use crate::network::tensor::Shape;

/// Parameters of [`Op::Features`](super::Op).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Features {
    /// Channels per pixel.
    pub channels: Vec<Feature>,
    /// Behind them, the log irradiance of the same pixel this many frames later (before, if negative); 0 outside of the
    /// window.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub neighbours: Vec<i32>,
    /// Block that is folded.
    pub block: Fold,
}

impl Operation for Features {
    fn wants(&self, _input: usize) -> Kind {
        Kind::Scalar
    }

    fn gives(&self) -> Kind {
        Kind::Channels
    }

    fn shape(&self, inputs: &[Shape], measurement: Shape) -> Result<Shape, String> {
        let Self { channels, neighbours, block } = self;
        if !(2..=3).contains(&inputs.len()) {
            return Err(format!("wants 2 inputs, has {}", inputs.len()));
        }
        if inputs.iter().any(|&s| s != measurement) {
            return Err("its inputs must have the measurement's size".into());
        }
        if inputs.len() < 3 && !neighbours.is_empty() {
            return Err("neighbours are those of a third input, log irradiance".into());
        }
        let per_pixel = channels.len() + neighbours.len();
        if channels.is_empty() || per_pixel > 16 {
            return Err(format!("{per_pixel} channels a pixel"));
        }
        if neighbours.iter().any(|offset| offset.unsigned_abs() as usize > MAX_FRAMES) {
            return Err(format!("neighbours {neighbours:?}"));
        }
        if !block.iter().all(|b| (1..=MAX_EXTENT).contains(b)) {
            return Err(format!("block {block:?}"));
        }
        let extent = measurement.extent();
        if (0..3).any(|i| !extent[i].is_multiple_of(block[i])) {
            return Err(format!("block {block:?} does not divide {measurement}"));
        }
        Ok(Shape::new(
            std::array::from_fn(|i| extent[i] / block[i]),
            per_pixel * block.iter().product::<usize>(),
        ))
    }

    fn relation(&self, input: usize) -> [Relation; 3] {
        let mut folded =
            self.block.map(|n| Relation { scale: Scale::Down(n), before: 0, after: n.saturating_sub(1) });
        if input == 2 {
            let (before, after) = around(self.neighbours.iter().copied());
            folded[0].before = before;
            folded[0].after = folded[0].after.saturating_add(after);
        }
        folded
    }

    fn reads(&self, input: usize) -> bool {
        input != 1 || self.channels.contains(&Feature::LogEstimate)
    }

    fn sees_camera(&self) -> bool {
        true
    }

    fn kernel(&self, parts: &Parts<'_>) -> Option<Kernel> {
        let now = self.channels.iter().map(|&feature| Channel { feature, offset: 0 });
        let others =
            self.neighbours.iter().map(|&offset| Channel { feature: Feature::LogIrradiance, offset });
        let lead = parts.origins.get(2).map_or(0, |origin| origin[0]);
        Some(Kernel::Features {
            channels: now.chain(others).collect(),
            block: self.block,
            lead: lead.unsigned_abs(),
        })
    }
}

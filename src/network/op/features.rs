//! Input normalisation, and folding of blocks into channels: measurement, estimate (, log irradiance).

use serde::{Deserialize, Serialize};

use super::operation::{Computed, Computes, Kind, MAX_EXTENT, MAX_FRAMES, Operation, Parts, around};
use super::relation::{Relation, Scale};
use crate::network::kernel::{Channel, Feature, Fold, Parameter};
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
}

/// Normalise and fold: measurement, estimate (, log irradiance) → channels.
#[derive(Clone, Debug)]
pub struct FeaturesStep {
    /// Channels per pixel.
    pub channels: Vec<Channel>,
    /// Block that is folded.
    pub block: Fold,
    /// Frames of the log irradiance before the first block.
    pub lead: usize,
}

impl Computed for Features {
    type Step = FeaturesStep;

    fn step(&self, parts: &Parts<'_>) -> FeaturesStep {
        let now = self.channels.iter().map(|&feature| Channel { feature, offset: 0 });
        let others =
            self.neighbours.iter().map(|&offset| Channel { feature: Feature::LogIrradiance, offset });
        let lead = parts.origins.get(2).map_or(0, |origin| origin[0]);
        FeaturesStep { channels: now.chain(others).collect(), block: self.block, lead: lead.unsigned_abs() }
    }
}

impl Computes for FeaturesStep {
    fn parameters(&self) -> Vec<(&'static str, Parameter)> {
        let Self { channels, block, lead } = self;
        // Shaders number features as `Feature` does.
        let features = channels.iter().map(|channel| channel.feature as i32).collect();
        let offsets = channels.iter().map(|channel| channel.offset).collect();
        vec![
            ("block", Parameter::Axes(*block)),
            ("channels", Parameter::Integer(channels.len())),
            ("features", Parameter::Integers(features)),
            ("frame_offsets", Parameter::Integers(offsets)),
            ("lead", Parameter::Integer(*lead)),
        ]
    }
}

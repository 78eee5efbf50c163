//! What is known of one frame: the planes that panes show.

use std::sync::Arc;
use std::time::Duration;

use pix2hdr::gpu::DeviceFrame;
use pix2hdr::synth::Active;

/// All planes [y, x] of one frame.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// Its number: in the file, or since a live camera began.
    pub number: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Pixel values y in [0, 1] of the exposures that cover the frame.
    pub mosaic: Option<Vec<f32>>,
    /// The box filter's irradiance p.
    pub filtered: Option<Vec<f32>>,
    /// The net's irradiance p.
    pub ours: Option<Vec<f32>>,
    /// Ground truth p, where there is one.
    pub truth: Option<Vec<f32>>,
    /// The net's irradiance where the GPU left it, if it is kept there too.
    pub on_gpu: Option<DeviceFrame>,
    /// Which cells of the frame were computed, where some may be skipped.
    pub computed: Option<Computed>,
    /// The frame's share of the time in which the net computed.
    pub inference: Duration,
}

/// The cells of a frame that were computed.
#[derive(Clone, Debug)]
pub struct Computed {
    /// Those of the frame's window.
    pub active: Arc<Active>,
    /// The frame's slab in it.
    pub slab: usize,
    /// Rows and columns of a cell, in pixels.
    pub cell: [usize; 2],
}

impl Computed {
    /// Whether the pixel at row `y`, column `x` was computed.
    pub fn is(&self, y: usize, x: usize) -> bool {
        let (r, c) = (y / self.cell[0].max(1), x / self.cell[1].max(1));
        self.active.slab(self.slab).get(r * self.active.extent()[2] + c).is_some_and(|active| *active)
    }

    /// Part of the cells that was computed.
    pub fn fraction(&self) -> f64 {
        let cells = self.active.slab(self.slab);
        cells.iter().filter(|computed| **computed).count() as f64 / cells.len().max(1) as f64
    }
}

/// One of a frame's planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plane {
    /// Pixel values.
    Mosaic,
    /// The box filter.
    Filtered,
    /// The net's result.
    Ours,
    /// Ground truth.
    Truth,
}

impl Frame {
    /// A plane, if the frame has it.
    pub fn plane(&self, plane: Plane) -> Option<&[f32]> {
        let plane = match plane {
            Plane::Mosaic => &self.mosaic,
            Plane::Filtered => &self.filtered,
            Plane::Ours => &self.ours,
            Plane::Truth => &self.truth,
        };
        plane.as_deref().filter(|plane| plane.len() == self.height * self.width)
    }

    /// Bytes of its planes, in main memory and on the GPU.
    pub fn bytes(&self) -> usize {
        let planes = [&self.mosaic, &self.filtered, &self.ours, &self.truth];
        let values: usize = planes.iter().filter_map(|plane| plane.as_ref()).map(Vec::len).sum();
        let on_gpu = self.on_gpu.as_ref().map_or(0, |_| self.height * self.width);
        4 * (values + on_gpu)
    }
}

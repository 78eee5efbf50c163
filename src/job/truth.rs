//! Comparison with the ground truth.

use std::path::Path;

use super::Sink;
use crate::frame::Plane;
use crate::quality::{Comparison, Measures};
use crate::synth::{Report, ResultFrame};
use crate::video::{self, ReadVideo};
use crate::{At, Error, Result};

/// Compares each frame with the truth, which is read frame by frame.
pub struct Truth {
    video: Box<dyn ReadVideo>,
    comparison: Comparison,
}

impl Truth {
    /// Opens the truth of a capture of extents [t, y, x].
    pub fn open(path: impl AsRef<Path>, extents: [usize; 3]) -> Result<Self> {
        let path = path.as_ref();
        let video = video::open(path)?;
        if video.extents() != extents {
            let [[t, y, x], [frames, height, width]] = [video.extents(), extents];
            let problem = format!("{t}×{y}×{x} is not the size of the capture, {frames}×{height}×{width}");
            return Err(Error::Usage(problem)).at(path);
        }
        Ok(Self { video, comparison: Comparison::default() })
    }
}

impl Sink for Truth {
    type Output = Measures;

    fn take(&mut self, result: &ResultFrame) -> Result<()> {
        let truth = self.video.frame(result.number)?;
        self.comparison.add(Plane::new(result.frame.extent(), &truth), result.frame.plane());
        Ok(())
    }

    fn finish(self, _: &Report) -> Result<Measures> {
        Ok(self.comparison.measures())
    }
}

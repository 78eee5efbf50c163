//! A result in memory.

use super::Sink;
use crate::Result;
use crate::frame::Extent;
use crate::synth::{Report, ResultFrame};
use crate::video::Video;

/// Keeps all frames.
pub struct InMemory(Video);

impl InMemory {
    /// Room for so many frames.
    pub fn new(frames: usize, Extent { height, width }: Extent) -> Self {
        Self(Video::black(frames, height, width))
    }
}

impl Sink for InMemory {
    type Output = Video;

    fn take(&mut self, result: &ResultFrame) -> Result<()> {
        self.0.frame_mut(result.number).copy_from_slice(result.frame.values());
        Ok(())
    }

    fn finish(self, _: &Report) -> Result<Video> {
        Ok(self.0)
    }
}

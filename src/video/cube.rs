//! A monochrome HDR video in memory.

use super::VideoError;
use super::pixels::check_pixels;
use crate::frame::{Extent, Plane};

/// A cube [t, y, x] of linear values (irradiance as a fraction of an anchor, or scene-referred before
/// normalisation), C-contiguous, origin top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Video {
    /// Number of frames.
    pub frames: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// `frames`·`height`·`width` values.
    pub data: Vec<f32>,
}

impl Video {
    /// A video of the given extents and data.
    pub fn new(frames: usize, height: usize, width: usize, data: Vec<f32>) -> Result<Self, VideoError> {
        let len = frames.checked_mul(height).and_then(|n| n.checked_mul(width));
        if len != Some(data.len()) {
            return Err(VideoError::Shape(format!("{} values for {frames}×{height}×{width}", data.len())));
        }
        Ok(Self { frames, height, width, data })
    }

    /// A black video.
    pub fn black(frames: usize, height: usize, width: usize) -> Self {
        Self { frames, height, width, data: vec![0.0; frames * height * width] }
    }

    /// Pixels of one frame.
    pub fn frame_len(&self) -> usize {
        self.height * self.width
    }

    /// One frame [y, x].
    pub fn frame(&self, t: usize) -> &[f32] {
        &self.data[t * self.frame_len()..][..self.frame_len()]
    }

    /// Rows and columns.
    pub fn extent(&self) -> Extent {
        Extent { height: self.height, width: self.width }
    }

    /// One frame.
    pub fn plane(&self, t: usize) -> Plane<'_> {
        Plane::new(self.extent(), self.frame(t))
    }

    /// One frame [y, x], to write.
    pub fn frame_mut(&mut self, t: usize) -> &mut [f32] {
        let len = self.frame_len();
        &mut self.data[t * len..][..len]
    }

    /// The first pixel that is not a finite, non-negative number, as an error.
    pub fn check_finite(&self) -> Result<(), VideoError> {
        (0..self.frames).try_for_each(|t| check_pixels(self.frame(t), t, self.width))
    }

    /// Normalises to the anchor: divides by the 99th percentile and clips to 1 (paper eq. 11). Returns the
    /// anchor: where nearly everything is black, that of the pixels that are not; 1 of a black video.
    pub fn normalise(&mut self) -> f32 {
        let percentile = |mut values: Vec<f32>| match values.len() {
            0 => None,
            n => Some(*values.select_nth_unstable_by((n - 1) * 99 / 100, f32::total_cmp).1),
        };
        let all = percentile(self.data.clone()).filter(|anchor| *anchor > 0.0);
        let lit = || percentile(self.data.iter().copied().filter(|value| *value > 0.0).collect());
        let anchor = all.or_else(lit).unwrap_or(1.0);
        for value in &mut self.data {
            *value = (*value / anchor).min(1.0);
        }
        anchor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_anchor_is_that_of_what_is_lit() {
        let normalised = |data: Vec<f32>| {
            let mut video = Video::new(1, 10, 100, data).unwrap();
            (video.normalise(), video)
        };
        let (anchor, ramp) = normalised((0..1000).map(|i| i as f32).collect());
        assert_eq!((anchor, ramp.data[494], ramp.data[999]), (989.0, 494.0 / 989.0, 1.0));
        // Nine stars on a black sky.
        let sky: Vec<f32> = (0..1000).map(|i| if i < 9 { 100.0 * i as f32 + 100.0 } else { 0.0 }).collect();
        let (anchor, sky) = normalised(sky);
        assert_eq!((anchor, sky.data[3], sky.data[8]), (800.0, 0.5, 1.0));
        assert_eq!(normalised(vec![0.0; 1000]).0, 1.0);
    }
}

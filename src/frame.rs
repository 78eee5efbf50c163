//! What flows from sources to sinks: frames.

use std::fmt;

/// Rows and columns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Extent {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

impl Extent {
    /// Number of pixels.
    pub fn pixels(self) -> usize {
        self.height * self.width
    }
}

impl From<[usize; 2]> for Extent {
    /// From [rows, columns].
    fn from([height, width]: [usize; 2]) -> Self {
        Self { height, width }
    }
}

impl From<Extent> for [usize; 2] {
    /// [rows, columns].
    fn from(Extent { height, width }: Extent) -> Self {
        [height, width]
    }
}

impl fmt::Display for Extent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}×{}", self.height, self.width)
    }
}

/// The values of one frame period.
#[derive(Clone, PartialEq)]
pub struct Frame {
    extent: Extent,
    channels: usize,
    time: i64,
    values: Vec<f32>,
}

impl Frame {
    /// A frame of one channel at schedule time `time`; `values` are [y, x].
    pub fn new(extent: Extent, time: i64, values: Vec<f32>) -> Self {
        Self::with_channels(extent, 1, time, values)
    }

    /// A frame at schedule time `time`; `values` are [y, x, c].
    pub fn with_channels(extent: Extent, channels: usize, time: i64, values: Vec<f32>) -> Self {
        assert_eq!(values.len(), extent.pixels() * channels, "values of a frame of {extent}");
        Self { extent, channels, time, values }
    }

    /// Rows and columns.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// Values of a pixel.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Schedule time.
    pub fn time(&self) -> i64 {
        self.time
    }

    /// All values, [y, x, c].
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// All values, [y, x, c].
    pub fn into_values(self) -> Vec<f32> {
        self.values
    }

    /// The frame as a plane; it must have one channel.
    pub fn plane(&self) -> Plane<'_> {
        assert_eq!(self.channels, 1, "a plane has one channel");
        Plane { extent: self.extent, values: &self.values }
    }
}

impl fmt::Debug for Frame {
    /// Without the values, of which there are too many to read.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { extent, channels, time, .. } = self;
        write!(f, "Frame({extent}, {channels} channels, at {time})")
    }
}

/// One channel of a frame, wherever its values lie.
#[derive(Clone, Copy, PartialEq)]
pub struct Plane<'a> {
    extent: Extent,
    values: &'a [f32],
}

impl<'a> Plane<'a> {
    /// The plane of `values` [y, x].
    pub fn new(extent: impl Into<Extent>, values: &'a [f32]) -> Self {
        let extent = extent.into();
        assert_eq!(values.len(), extent.pixels(), "values of a plane of {extent}");
        Self { extent, values }
    }

    /// Rows and columns.
    pub fn extent(self) -> Extent {
        self.extent
    }

    /// All values, [y, x].
    pub fn values(self) -> &'a [f32] {
        self.values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_what_it_was_made_of() {
        let frame = Frame::new([2, 3].into(), -4, vec![1.0; 6]);
        assert_eq!((frame.extent().to_string(), frame.channels(), frame.time()), ("2×3".into(), 1, -4));
        assert!(frame.plane() == Plane::new([2, 3], &[1.0; 6]));
        assert_eq!(Frame::with_channels([1, 2].into(), 3, 0, vec![0.5; 6]).into_values(), [0.5; 6]);
    }

    #[test]
    #[should_panic(expected = "2×3")]
    fn values_fit_their_extent() {
        Frame::new([2, 3].into(), 0, vec![0.0; 5]);
    }
}

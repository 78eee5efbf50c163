//! What a format of files can do.

use std::fmt;
use std::path::Path;

use super::{Counts, Video, Writing};
use crate::Result;
use crate::frame::Plane;

/// Reads a video frame by frame.
pub trait ReadVideo: Send {
    /// Extents [t, y, x].
    fn extents(&self) -> [usize; 3];

    /// The values [y, x] of frame `t`, which must be one of the video's; all are finite and ≥ 0.
    fn frame(&mut self, t: usize) -> Result<Vec<f32>>;

    /// The whole video.
    fn all(self: Box<Self>) -> Result<Video>;
}

/// Writes a video frame by frame. It appears under its name when it is finished.
pub trait WriteVideo: Send {
    /// Frames that are there, those of an earlier run included.
    fn pushed(&self) -> usize;

    /// Appends a frame, whose values must be finite and ≥ 0. A failure to write an earlier one may be reported here.
    fn push(&mut self, frame: Plane<'_>) -> Result<()>;

    /// Completes the video; an error if fewer frames came than were promised.
    fn finish(self: Box<Self>) -> Result<()>;

    /// Leaves what there is in the place of [`Destination::partial`], as a shorter video that can be gone on with. Returns
    /// the number of its frames: all that were pushed, unless the disk is full; none where there is no such place.
    fn suspend(self: Box<Self>) -> Result<usize>;

    /// The values [y, x] of frame `t` of those that an earlier run left, if the format can look at them meanwhile.
    fn written(&self, t: usize) -> Result<Option<Vec<f32>>> {
        let _ = t;
        Ok(None)
    }
}

/// Where and how a video is written.
#[derive(Clone, Copy, Debug)]
pub struct Destination<'a> {
    /// Extents [t, y, x].
    pub extents: [usize; 3],
    /// How its frames are written.
    pub how: Writing,
    /// Where frames are collected and stay until the video is complete: frames that are there already are its first
    /// ones. Without such a place, nothing stays of a video that is never completed.
    pub partial: Option<&'a Path>,
}

/// Reads the counts of a capture frame by frame.
pub trait ReadCounts: fmt::Debug + Send {
    /// Extents [t, y, x].
    fn extents(&self) -> [usize; 3];

    /// Bits of a count's type: 8 or 16.
    fn bits(&self) -> u32;

    /// The counts [y, x] of frame `t`, which must be one of the file's.
    fn frame(&mut self, t: usize) -> Result<Counts>;
}

/// Writes the counts of a capture frame by frame. The file appears when it is finished.
pub trait WriteCounts: Send {
    /// Appends the counts [y, x] of a frame.
    fn push(&mut self, frame: &Counts) -> Result<()>;

    /// Completes the file; an error if fewer frames came than were promised.
    fn finish(self: Box<Self>) -> Result<()>;
}

/// What a format can do.
pub struct Format {
    /// What a user calls it, with its article.
    pub name: &'static str,
    /// What names of its files end in, in small letters and without the dot; nothing: a folder.
    pub endings: &'static [&'static str],
    /// Whether a file holds one frame.
    pub single: bool,
    /// Opens a video.
    pub open: fn(&Path) -> Result<Box<dyn ReadVideo>>,
    /// Begins a video, if the format is written.
    pub begin: Option<BeginVideo>,
    /// Opens and begins the counts of a capture.
    pub counts: Option<CountsFormat>,
}

impl Format {
    /// Whether it is one of folders.
    pub fn is_folder(&self) -> bool {
        self.endings.is_empty()
    }
}

/// How a format holds the counts of a capture.
#[derive(Clone, Copy)]
pub struct CountsFormat {
    /// Opens a file.
    pub open: fn(&Path) -> Result<Box<dyn ReadCounts>>,
    /// Begins a file.
    pub begin: BeginCounts,
}

/// Begins the video of a path.
pub type BeginVideo = fn(&Path, Destination<'_>) -> Result<Box<dyn WriteVideo>>;
/// Begins counts of extents [t, y, x] and of so many bits.
pub type BeginCounts = fn(&Path, [usize; 3], u32) -> Result<Box<dyn WriteCounts>>;

/// What a name ends in, in small letters and without the dot; empty if there is none.
pub fn ending(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

impl ReadVideo for Video {
    fn extents(&self) -> [usize; 3] {
        [self.frames, self.height, self.width]
    }

    fn frame(&mut self, t: usize) -> Result<Vec<f32>> {
        Ok(Video::frame(self, t).to_vec())
    }

    fn all(self: Box<Self>) -> Result<Video> {
        Ok(*self)
    }
}

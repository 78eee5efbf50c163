//! Writing a video frame by frame, as the name of its destination says.

use std::fmt;
use std::path::{Path, PathBuf};

use super::Video;
use super::files;
use super::folder;
use super::format::{Destination, WriteVideo};
use super::writing::Writing;
use crate::frame::Plane;
use crate::{At, Result};

/// A video being written. It appears under its name when it is finished; dropped before, nothing of it stays.
pub struct VideoWriter(Box<dyn WriteVideo>);

impl fmt::Debug for VideoWriter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "VideoWriter of {} frames so far", self.pushed())
    }
}

impl VideoWriter {
    /// Begins a video of `extents` [t, y, x] in the format that `path`'s name says, such as a cube if it ends in `.npy`,
    /// one picture if it ends in `.exr`, a folder of EXR pictures if it has no ending.
    pub fn begin(path: impl AsRef<Path>, extents: [usize; 3], how: Writing) -> Result<Self> {
        Ok(Self(files::begin(path.as_ref(), Destination { extents, how, partial: None })?))
    }

    /// As [`VideoWriter::begin`], but what was written stays beside the video's name as [`VideoWriter::partial`] until it
    /// is complete, where the format allows that. What is there already from an earlier run is taken for the first frames;
    /// [`VideoWriter::pushed`] says how many there are.
    pub fn go_on(path: impl AsRef<Path>, extents: [usize; 3], how: Writing) -> Result<Self> {
        let path = path.as_ref();
        let partial = Self::partial(path);
        Ok(Self(files::begin(path, Destination { extents, how, partial: Some(&partial) })?))
    }

    /// Where [`VideoWriter::go_on`] collects frames: `video.partial.npy` for `video.npy`, `folder.partial` for `folder`.
    pub fn partial(path: &Path) -> PathBuf {
        match path.extension() {
            Some(ending) => path.with_extension(format!("partial.{}", ending.to_string_lossy())),
            None => path.with_extension("partial"),
        }
    }

    /// Frames that are there.
    pub fn pushed(&self) -> usize {
        self.0.pushed()
    }

    /// Frame `t` [y, x], of those that were there when the writer began, if the format can look at them meanwhile.
    pub fn written(&self, t: usize) -> Result<Option<Vec<f32>>> {
        self.0.written(t)
    }

    /// Removes what [`VideoWriter::go_on`] left for the video `path`.
    pub fn discard_partial(path: &Path) -> Result<()> {
        let partial = Self::partial(path);
        if partial.is_dir() {
            folder::remove_partial(&partial)
        } else if partial.exists() {
            std::fs::remove_file(&partial).at(&partial)
        } else {
            Ok(())
        }
    }

    /// Leaves what there is as a shorter video, which [`VideoWriter::go_on`] takes up.
    /// Returns the number of its frames: all that were pushed, unless the disk is full.
    pub fn suspend(self) -> Result<usize> {
        self.0.suspend()
    }

    /// Appends a frame. Every value must be finite and ≥ 0.
    pub fn push(&mut self, frame: Plane<'_>) -> Result<()> {
        self.0.push(frame)
    }

    /// Completes the video; an error if fewer frames came than were promised.
    pub fn finish(self) -> Result<()> {
        self.0.finish()
    }
}

/// Writes a whole video as `path`'s name says (see [`VideoWriter::begin`]).
pub fn write(path: impl AsRef<Path>, video: &Video, how: Writing) -> Result<()> {
    let mut writer = VideoWriter::begin(path, [video.frames, video.height, video.width], how)?;
    for t in 0..video.frames {
        writer.push(video.plane(t))?;
    }
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::video;

    #[test]
    fn every_kind_of_file_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let video = Video::new(1, 2, 3, (0..6).map(|i| i as f32).collect()).unwrap();
        for name in ["a.npy", "A.EXR", "sequence"] {
            let path = folder.path().join(name);
            video::write(&path, &video, Writing::default()).unwrap();
            assert_eq!(video::read(&path).unwrap(), video);
        }
        let two = Video::black(2, 2, 3);
        let error = video::write(folder.path().join("a.exr"), &two, Writing::default()).unwrap_err();
        assert!(error.to_string().contains("one frame"));
        let error = video::write(folder.path().join("a.mp4"), &two, Writing::default()).unwrap_err();
        assert!(error.to_string().contains(".npy"));
    }

    /// A video that was left is a video of the frames that were written, and goes on to the same bytes.
    #[test]
    fn an_interrupted_video_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let video = Video::new(12, 2, 3, (0..72).map(|i| i as f32 / 7.0).collect()).unwrap();
        let how = Writing { half: false, ..Writing::default() };
        for name in ["a.npy", "sequence"] {
            let (path, whole) = (folder.path().join(name), folder.path().join(format!("whole-{name}")));
            video::write(&whole, &video, how).unwrap();
            for (from, to) in [(0, 3), (3, 11), (11, 11)] {
                let mut writer = VideoWriter::go_on(&path, [12, 2, 3], how).unwrap();
                assert_eq!(writer.pushed(), from, "{name}");
                (from..to).for_each(|t| writer.push(video.plane(t)).unwrap());
                writer.suspend().unwrap();
                let partial = video::read(VideoWriter::partial(&path)).unwrap();
                assert_eq!((partial.frames, &partial.data[..]), (to, &video.data[..to * 6]), "{name}");
                assert!(!path.exists());
            }
            let mut writer = VideoWriter::go_on(&path, [12, 2, 3], how).unwrap();
            writer.push(video.plane(11)).unwrap();
            writer.finish().unwrap();
            assert!(!VideoWriter::partial(&path).exists());
            let files = |path: &Path| -> Vec<Vec<u8>> {
                if path.is_file() {
                    return vec![std::fs::read(path).unwrap()];
                }
                let mut files: Vec<_> = std::fs::read_dir(path).unwrap().map(|e| e.unwrap().path()).collect();
                files.sort();
                files.iter().map(|file| std::fs::read(file).unwrap()).collect()
            };
            assert_eq!(files(&path), files(&whole), "{name}");
        }
    }

    #[test]
    fn unknown_files_are_refused_with_the_cure() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mp4");
        assert!(video::read(&path).unwrap_err().to_string().contains("a.mp4"));
        std::fs::write(&path, b"").unwrap();
        assert!(video::read(&path).unwrap_err().to_string().contains("a folder of .exr"));
    }
}

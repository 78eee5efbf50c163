//! Writing a video frame by frame, as the name of its destination says.

use std::path::{Path, PathBuf};

use super::exr::{self, PlaneWriting};
use super::folder::{self, FolderWriter};
use super::npy::NpyWriter;
use super::{check_complete, check_frame, extension};
use crate::{At, Error, Result};

/// How a video is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Writing {
    /// Half instead of single precision; values above 65504 become 65504.
    pub half: bool,
    /// Whether what is there already is replaced: a file, or a folder of pictures.
    pub overwrite: bool,
    /// Duration of a frame, noted in EXR files.
    pub frame_period_ms: Option<f64>,
    /// What p = 1 stands for, noted in EXR files.
    pub anchor: Option<f32>,
}

impl Default for Writing {
    fn default() -> Self {
        Self { half: true, overwrite: false, frame_period_ms: None, anchor: None }
    }
}

impl Writing {
    fn plane(self) -> PlaneWriting {
        let Self { half, frame_period_ms, anchor, .. } = self;
        PlaneWriting { half, frame_period_ms, anchor }
    }
}

/// Refuses a file that is there, unless it may be replaced.
pub fn check_free(path: &Path, overwrite: bool) -> Result<()> {
    if path.exists() && !overwrite {
        let problem = "is already there; choose another name or allow it to be overwritten";
        return Err(Error::Usage(problem.into())).at(path);
    }
    Ok(())
}

/// A video being written. It appears under its name when it is finished; dropped before, nothing of it stays.
#[derive(Debug)]
pub struct VideoWriter(Kind);

#[derive(Debug)]
enum Kind {
    Npy(NpyWriter),
    Folder(FolderWriter),
    Picture { path: PathBuf, extents: [usize; 3], how: PlaneWriting, frame: Option<Vec<f32>> },
}

impl VideoWriter {
    /// Begins a video of `extents` [t, y, x]: a cube if `path` ends in `.npy`, one picture if it ends in
    /// `.exr`, a folder of EXR
    /// pictures if it has no extension.
    pub fn begin(path: impl AsRef<Path>, extents: [usize; 3], how: Writing) -> Result<Self> {
        let path = path.as_ref();
        let kind = match extension(path).as_str() {
            "npy" => {
                check_free(path, how.overwrite)?;
                Kind::Npy(NpyWriter::begin(path, extents, how.half)?)
            }
            "exr" if extents[0] == 1 => {
                check_free(path, how.overwrite)?;
                Kind::Picture { path: path.to_owned(), extents, how: how.plane(), frame: None }
            }
            "exr" => {
                let problem = "one .exr file holds one frame; name a folder or a .npy file";
                return Err(Error::Usage(problem.into())).at(path);
            }
            _ if path.is_dir() || path.extension().is_none() => {
                Kind::Folder(FolderWriter::begin(path, extents, how.overwrite, how.plane())?)
            }
            _ => {
                let problem =
                    "a video is written as a folder of .exr pictures (a name without extension) or as .npy";
                return Err(Error::Usage(problem.into())).at(path);
            }
        };
        Ok(Self(kind))
    }

    /// As [`VideoWriter::begin`], for a `.npy` cube or a folder, but what was written stays beside the video's name as
    /// [`VideoWriter::partial`] until it is complete. What is there already from an earlier run is taken for the first
    /// frames; [`VideoWriter::pushed`] says how many there are.
    pub fn go_on(path: impl AsRef<Path>, extents: [usize; 3], how: Writing) -> Result<Self> {
        let path = path.as_ref();
        let partial = Self::partial(path);
        match extension(path).as_str() {
            "npy" => {
                check_free(path, how.overwrite)?;
                Ok(Self(Kind::Npy(NpyWriter::go_on(path, extents, how.half, &partial)?)))
            }
            "" => {
                let writer = FolderWriter::go_on(path, extents, how.overwrite, how.plane(), &partial)?;
                Ok(Self(Kind::Folder(writer)))
            }
            // One picture is written at once.
            _ => Self::begin(path, extents, how),
        }
    }

    /// Where [`VideoWriter::go_on`] collects frames: `video.partial.npy` for `video.npy`, `folder.partial` for `folder`.
    pub fn partial(path: &Path) -> PathBuf {
        match path.extension() {
            Some(extension) => path.with_extension(format!("partial.{}", extension.to_string_lossy())),
            None => path.with_extension("partial"),
        }
    }

    /// Frames that are there.
    pub fn pushed(&self) -> usize {
        match &self.0 {
            Kind::Npy(writer) => writer.pushed(),
            Kind::Folder(writer) => writer.pushed(),
            Kind::Picture { frame, .. } => usize::from(frame.is_some()),
        }
    }

    /// Frame `t`, of those that were there in a folder when the writer began.
    pub fn written(&self, t: usize) -> Result<Vec<f32>> {
        match &self.0 {
            Kind::Folder(writer) => writer.frame(t),
            _ => Err(Error::Usage("only a folder's frames can be looked at".into())),
        }
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
        match self.0 {
            Kind::Npy(writer) => writer.suspend(),
            Kind::Folder(writer) => writer.suspend(),
            Kind::Picture { .. } => Ok(0),
        }
    }

    /// Appends one frame [y, x]. Every value must be finite and ≥ 0.
    pub fn push(&mut self, frame: &[f32]) -> Result<()> {
        match &mut self.0 {
            Kind::Npy(writer) => writer.push(frame),
            Kind::Folder(writer) => writer.push(frame),
            Kind::Picture { path, extents, frame: held, .. } => {
                check_frame(frame, usize::from(held.is_some()), *extents).at(path)?;
                *held = Some(frame.to_vec());
                Ok(())
            }
        }
    }

    /// Completes the video; an error if fewer frames came than were promised.
    pub fn finish(self) -> Result<()> {
        match self.0 {
            Kind::Npy(writer) => writer.finish(),
            Kind::Folder(writer) => writer.finish(),
            Kind::Picture { path, extents, how, frame } => {
                check_complete(usize::from(frame.is_some()), extents[0]).at(&path)?;
                exr::write(path, &frame.unwrap_or_default(), extents[2], how)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::video::{self, Video};

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
                (from..to).for_each(|t| writer.push(video.frame(t)).unwrap());
                writer.suspend().unwrap();
                let partial = video::read(VideoWriter::partial(&path)).unwrap();
                assert_eq!((partial.frames, &partial.data[..]), (to, &video.data[..to * 6]), "{name}");
                assert!(!path.exists());
            }
            let mut writer = VideoWriter::go_on(&path, [12, 2, 3], how).unwrap();
            writer.push(video.frame(11)).unwrap();
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

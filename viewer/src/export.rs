//! What the viewer writes. All of it runs on a thread of its own; nothing that is there is replaced.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::frame::Frame;
use crate::picture::{Kinds, Picture};
use crate::place::Part;
use crate::tone::ToneTable;
use pix2hdr::frame::Plane;
use pix2hdr::video::{PreviewWriter, VideoWriter, Writing, png};
use pix2hdr::{Error, Result};

/// Writes the irradiance of a frame that a pane shows as `frame-NUMBER.exr` into `folder`; raw pictures as they are.
pub fn save_exr(folder: &Path, frame: &Frame, picture: Picture) -> Result<PathBuf> {
    let plane = match picture {
        Picture::Mosaic | Picture::SubFrames => &frame.mosaic,
        Picture::Filtered | Picture::FilteredDifference => &frame.filtered,
        Picture::Ours | Picture::Difference => &frame.ours,
        Picture::Truth => &frame.truth,
    };
    let plane = plane.as_ref().ok_or_else(|| Error::Usage(format!("there is no {}", picture.name())))?;
    let path = unused(folder, &format!("frame-{:05}", frame.number), "exr");
    let how = Writing { half: false, ..Writing::default() };
    let mut writer = VideoWriter::begin(&path, [1, frame.height, frame.width], how)?;
    writer.push(Plane::new([frame.height, frame.width], plane))?;
    writer.finish()?;
    Ok(path)
}

/// Writes a frame as a pane shows it as `frame-NUMBER.png` into `folder`.
pub fn save_png(
    folder: &Path,
    frame: &Frame,
    picture: Picture,
    kinds: &Kinds,
    table: &ToneTable,
) -> Result<PathBuf> {
    let part = Part { rows: 0..frame.height, cols: 0..frame.width, stride: 1 };
    let pixels = picture.pixels(frame, kinds, &part, table, false);
    if pixels.is_empty() {
        return Err(Error::Usage(format!("there is no {}", picture.name())));
    }
    let path = unused(folder, &format!("frame-{:05}", frame.number), "png");
    png::write_rgb(&path, pixels.as_chunks::<3>().0, frame.width)?;
    Ok(path)
}

/// Writes the results of `frames` into `folder`: a folder of EXR pictures and, where ffmpeg is installed, a preview
/// video of `rate` frames per second. Returns what was written, and what went wrong with the video.
pub fn record(folder: &Path, frames: &[Arc<Frame>], rate: u32) -> Result<(Vec<PathBuf>, Option<Error>)> {
    let results: Vec<&Frame> = frames.iter().map(|frame| &**frame).filter(|f| f.ours.is_some()).collect();
    let (Some(first), Some(last)) = (results.first(), results.last()) else {
        return Err(Error::Usage("there are no frames in this range".into()));
    };
    let name = format!("range-{:05}-{:05}", first.number, last.number);
    let target = unused(folder, &name, "");
    let mut writer =
        VideoWriter::begin(&target, [results.len(), first.height, first.width], Writing::default())?;
    let values = || results.iter().filter_map(|frame| frame.ours.as_ref());
    let extent = [first.height, first.width];
    values().try_for_each(|values| writer.push(Plane::new(extent, values)))?;
    writer.finish()?;
    if !PreviewWriter::is_installed() {
        return Ok((vec![target], None));
    }
    let video = unused(folder, &name, "mp4");
    let preview = PreviewWriter::begin(&video, [first.height, first.width], rate).and_then(|mut writer| {
        values().try_for_each(|values| writer.push(values))?;
        writer.finish()
    });
    Ok(match preview {
        Ok(path) => (vec![target, path], None),
        Err(error) => (vec![target], Some(error)),
    })
}

/// A path that nothing has yet: `name.extension`, `name-2.extension` …
fn unused(folder: &Path, name: &str, extension: &str) -> PathBuf {
    let path = |name: String| folder.join(name).with_extension(extension);
    let numbered = (2..).map(|i| path(format!("{name}-{i}")));
    std::iter::once(path(name.to_owned())).chain(numbered).find(|path| !path.exists()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tone::Display;
    use pix2hdr::video;

    fn frame(number: usize) -> Frame {
        let plane: Vec<f32> = (0..12).map(|i| (number * 12 + i) as f32 / 100.0).collect();
        Frame { number, height: 3, width: 4, ours: Some(plane), ..Frame::default() }
    }

    #[test]
    fn frames_are_written_beside_what_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let table = ToneTable::new(Display::default());
        let names = |path: Result<PathBuf>| path.unwrap().file_name().unwrap().to_str().unwrap().to_owned();
        let frame = frame(7);
        assert_eq!(names(save_exr(folder.path(), &frame, Picture::Ours)), "frame-00007.exr");
        assert_eq!(names(save_exr(folder.path(), &frame, Picture::Ours)), "frame-00007-2.exr");
        let png = save_png(folder.path(), &frame, Picture::Ours, &Kinds::default(), &table);
        assert_eq!(names(png), "frame-00007.png");
        let read = video::read(folder.path().join("frame-00007-2.exr")).unwrap();
        assert_eq!(Some(read.data), frame.ours);
        let error = save_exr(folder.path(), &frame, Picture::Truth).unwrap_err().to_string();
        assert!(error.contains("truth"), "{error}");
        assert!(save_png(folder.path(), &frame, Picture::Truth, &Kinds::default(), &table).is_err());
    }

    #[test]
    fn a_range_is_a_video() {
        let folder = tempfile::tempdir().unwrap();
        let frames: Vec<_> = [3, 4, 9].map(|number| Arc::new(frame(number))).into();
        let (files, problem) = record(folder.path(), &frames, 30).unwrap();
        // Without ffmpeg the pictures are there all the same, and nothing has failed.
        assert!(problem.is_none(), "{problem:?}");
        assert_eq!(files.len(), if PreviewWriter::is_installed() { 2 } else { 1 });
        assert!(files[0].ends_with("range-00003-00009"));
        let read = video::read(&files[0]).unwrap();
        assert_eq!((read.frames, read.height, read.width), (3, 3, 4));
        assert!(record(folder.path(), &[], 30).is_err());
    }
}

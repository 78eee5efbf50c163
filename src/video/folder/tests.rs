use std::fs;
use std::path::Path;

use super::super::Video;
use super::super::exr::{self, PlaneWriting};
use super::names::frame_name;
use super::pictures::natural_order;
use super::writer::FolderWriter;
use super::*;
use crate::Result;
use crate::frame::Plane;
use crate::video::format::WriteVideo;

const HOW: PlaneWriting = PlaneWriting { half: true, frame_period_ms: None, anchor: None };

fn ramp(frames: usize) -> Video {
    Video::new(frames, 3, 4, (0..frames * 12).map(|i| i as f32 / 8.0).collect()).unwrap()
}

fn write(path: &Path, video: &Video, overwrite: bool) -> Result<()> {
    let mut writer = FolderWriter::begin(path, [video.frames, video.height, video.width], overwrite, HOW)?;
    (0..video.frames).try_for_each(|t| writer.push(video.plane(t)))?;
    Box::new(writer).finish()
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn sequences_round_trip() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/out");
    write(&path, &ramp(13), false).unwrap();
    assert_eq!(read(&path).unwrap(), ramp(13));
    assert_eq!(names(&path)[12], "frame-00012.exr");
    assert_eq!(names(path.parent().unwrap()), ["out"]);
}

#[test]
fn names_are_in_natural_order() {
    let mut names = ["b10", "b9", "a", "b", "b010", "b1x", "b1", "b99999999999999999999999", "é2", "é10"];
    names.sort_by(|a, b| natural_order(a, b));
    assert_eq!(names, ["a", "b", "b1", "b1x", "b9", "b010", "b10", "b99999999999999999999999", "é2", "é10"]);
    let folder = tempfile::tempdir().unwrap();
    for (name, value) in [("frame11.exr", 3.0), ("frame10.exr", 2.0), ("frame9.EXR", 1.0)] {
        exr::write(folder.path().join(name), &[value], 1, HOW).unwrap();
    }
    fs::write(folder.path().join(".frame12.exr"), b"hidden").unwrap();
    fs::write(folder.path().join("notes.txt"), b"").unwrap();
    assert_eq!(read(folder.path()).unwrap().data, [1.0, 2.0, 3.0]);
    fs::rename(folder.path().join("frame11.exr"), folder.path().join("frame12.exr")).unwrap();
    assert!(read(folder.path()).unwrap_err().to_string().contains("frame 11 between"));
}

#[test]
fn what_cannot_be_read_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let error = read(folder.path()).unwrap_err().to_string();
    assert!(error.contains("no .exr"), "{error}");
    for t in 0..4 {
        exr::write(folder.path().join(frame_name(t)), &[1.0; 6], 2, HOW).unwrap();
    }
    exr::write(folder.path().join(frame_name(2)), &[1.0; 6], 3, HOW).unwrap();
    fs::write(folder.path().join(frame_name(3)), b"junk").unwrap();
    let error = read(folder.path()).unwrap_err().to_string();
    assert!(error.contains("frame-00002.exr") && error.contains("3×2"), "{error}");
    assert!(read(folder.path().join("none")).unwrap_err().to_string().contains("none"));
}

#[test]
fn an_existing_folder_is_replaced_only_when_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    fs::create_dir(&path).unwrap();
    write(&path, &ramp(3), false).unwrap();
    let error = write(&path, &ramp(2), false).unwrap_err().to_string();
    assert!(error.contains("not empty"), "{error}");
    assert_eq!(read(&path).unwrap(), ramp(3));
    write(&path, &ramp(2), true).unwrap();
    assert_eq!(read(&path).unwrap(), ramp(2));
    assert_eq!(names(folder.path()), ["out"]);
}

#[test]
fn what_is_not_ours_is_never_removed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    for name in ["notes.txt", "frame-1.exr", "frame-00001.exr.bak", "frame-000x1.exr"] {
        let _ = fs::remove_dir_all(&path);
        fs::create_dir(&path).unwrap();
        fs::write(path.join(name), b"mine").unwrap();
        let error = write(&path, &ramp(2), true).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
        assert_eq!(names(&path), [name]);
    }
    // It came while we were writing.
    fs::remove_dir_all(&path).unwrap();
    let mut writer = FolderWriter::begin(&path, [1, 3, 4], true, HOW).unwrap();
    writer.push(ramp(1).plane(0)).unwrap();
    fs::create_dir_all(path.join("frame-00000.exr")).unwrap();
    assert!(Box::new(writer).finish().is_err());
    assert_eq!(names(folder.path()), ["out"]);
    // A file in the place of the folder.
    let file = folder.path().join("file");
    fs::write(&file, b"mine").unwrap();
    assert!(write(&file, &ramp(2), true).is_err());
    assert_eq!(fs::read(&file).unwrap(), b"mine");
}

#[test]
fn an_unfinished_sequence_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    let mut writer = FolderWriter::begin(&path, [3, 3, 4], false, HOW).unwrap();
    writer.push(ramp(1).plane(0)).unwrap();
    drop(writer);
    assert!(names(folder.path()).is_empty());
    let mut writer = FolderWriter::begin(&path, [3, 3, 4], false, HOW).unwrap();
    writer.push(ramp(1).plane(0)).unwrap();
    assert!(Box::new(writer).finish().unwrap_err().to_string().contains("1 of 3"));
    assert!(names(folder.path()).is_empty());
    let mut writer = FolderWriter::begin(&path, [1, 3, 4], false, HOW).unwrap();
    let error = writer.push(Plane::new([3, 4], &[f32::NAN; 12])).unwrap_err().to_string();
    assert!(error.contains("row 0, column 0"), "{error}");
    assert!(writer.push(Plane::new([1, 11], &[0.0; 11])).is_err());
}

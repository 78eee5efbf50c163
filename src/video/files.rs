//! Files by their names: one table of formats, in which what a name ends in is looked up, here alone.
//!
//! A new format is a file that implements what it can of the traits in [`format`](super::format), and a line in
//! [`FORMATS`].

use std::path::{Path, PathBuf};

use super::format::{
    CountsFormat, Destination, Format, ReadCounts, ReadVideo, WriteCounts, WriteVideo, ending,
};
use super::{Video, exr, folder, npy, radiance};
use crate::{At, Error, Result};

/// All formats. Captures whose names say nothing are taken for the first one that can hold counts.
static FORMATS: &[&Format] = &[&folder::FORMAT, &npy::FORMAT, &exr::FORMAT, &radiance::FORMAT];

fn formats() -> impl Iterator<Item = &'static Format> {
    FORMATS.iter().copied()
}

/// The format of files that end in `ending`.
fn ends_in(ending: &str) -> Option<&'static Format> {
    formats().find(|format| format.endings.contains(&ending))
}

/// The format of the video that is at `path`.
fn of(path: &Path) -> Result<&'static Format> {
    let found = if std::fs::metadata(path).at(path)?.is_dir() {
        formats().find(|format| format.is_folder())
    } else {
        ends_in(&ending(path))
    };
    let names = || listed(formats());
    found.ok_or_else(|| Error::Usage(format!("not a video that can be read; give {}", names())).at(path))
}

/// The format of a video that is written to `path`.
pub(super) fn to_write(path: &Path) -> Result<&'static Format> {
    // What cannot be told from a folder's name is one.
    let folder = path.extension().is_none() || path.is_dir();
    let format = ends_in(&ending(path)).or_else(|| formats().find(|format| format.is_folder() && folder));
    format.filter(|format| format.begin.is_some()).ok_or_else(|| {
        let names = listed(formats().filter(|format| format.begin.is_some()));
        Error::Usage(format!("a video is written as {names}; a folder's name has no ending")).at(path)
    })
}

/// The format of counts in the file `path`.
fn of_counts(path: &Path) -> CountsFormat {
    let named = ends_in(&ending(path)).and_then(|format| format.counts);
    let first = formats().find_map(|format| format.counts);
    named.or(first).expect("some format holds counts")
}

/// Names of formats: "a, b or c".
fn listed(formats: impl Iterator<Item = &'static Format>) -> String {
    let names: Vec<&str> = formats.map(|format| format.name).collect();
    match names.split_last() {
        Some((last, others)) if !others.is_empty() => format!("{} or {last}", others.join(", ")),
        _ => names.concat(),
    }
}

/// Opens a video, which is read frame by frame.
pub fn open(path: impl AsRef<Path>) -> Result<Box<dyn ReadVideo>> {
    let path = path.as_ref();
    (of(path)?.open)(path)
}

/// Reads a whole HDR video: a folder of EXR pictures, one `.npy` cube, or one `.exr` or `.hdr` picture as a video of one
/// frame.
pub fn read(path: impl AsRef<Path>) -> Result<Video> {
    open(path)?.all()
}

/// Begins a video as `path`'s name says.
pub(super) fn begin(path: &Path, to: Destination<'_>) -> Result<Box<dyn WriteVideo>> {
    match to_write(path)?.begin {
        Some(begin) => begin(path, to),
        None => unreachable!("a format that writes was chosen"),
    }
}

/// Whether a file of this name is one picture.
pub fn is_picture(path: &Path) -> bool {
    ends_in(&ending(path)).is_some_and(|format| format.single)
}

/// Whether a file of this name can be written as a video of many frames.
pub fn is_cube(path: &Path) -> bool {
    ends_in(&ending(path)).is_some_and(|format| !format.single && format.begin.is_some())
}

/// Opens the counts of a capture.
pub fn open_counts(path: impl AsRef<Path>) -> Result<Box<dyn ReadCounts>> {
    let path = path.as_ref();
    (of_counts(path).open)(path)
}

/// Whether a file is of a format that holds counts, by its name and by its content.
pub fn holds_counts(path: &Path) -> bool {
    let named = ends_in(&ending(path)).and_then(|format| format.counts);
    named.is_some_and(|format| (format.open)(path).is_ok())
}

/// The array of counts in `folder` that is called as `name`, whatever it ends in; `name` itself if there is none.
pub fn counts_in(folder: &Path, name: &str) -> PathBuf {
    let formats = formats().filter(|format| format.counts.is_some());
    let paths =
        formats.flat_map(|format| format.endings).map(|ending| folder.join(name).with_extension(ending));
    paths.into_iter().find(|path| path.exists()).unwrap_or_else(|| folder.join(name))
}

/// Begins the counts of a capture, of extents [t, y, x] and of numbers of so many `bits`: 8 or 16.
pub fn begin_counts(path: impl AsRef<Path>, extents: [usize; 3], bits: u32) -> Result<Box<dyn WriteCounts>> {
    let path = path.as_ref();
    (of_counts(path).begin)(path, extents, bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No two formats claim one ending, and what is written can be read again.
    #[test]
    fn endings_are_of_one_format() {
        let endings: Vec<_> = FORMATS.iter().flat_map(|format| format.endings).collect();
        for (i, own) in endings.iter().enumerate() {
            assert!(!endings[..i].contains(own), "{own} is of two formats");
            assert_eq!(ending(Path::new(&format!("A.{}", own.to_uppercase()))), **own);
        }
        assert_eq!(FORMATS.iter().filter(|format| format.is_folder()).count(), 1);
        assert!(listed(formats()).ends_with(" or a .hdr picture"));
    }

    #[test]
    fn formats_are_told_by_name_or_by_what_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let there = folder.path().join("a.b");
        assert!(to_write(&there).is_err());
        std::fs::create_dir(&there).unwrap();
        for path in [&there, &folder.path().join("new")] {
            assert!(to_write(path).unwrap().is_folder() && !is_cube(path) && !is_picture(path));
        }
        for (name, cube, picture) in [("a.NPY", true, false), ("a.exr", false, true), ("a.hdr", false, true)]
        {
            assert_eq!((is_cube(Path::new(name)), is_picture(Path::new(name))), (cube, picture), "{name}");
        }
    }
}

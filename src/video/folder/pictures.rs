//! Reading pictures, one a frame.

use std::cmp::Ordering;
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::super::format::{ReadVideo, ending};
use super::super::pixels::reserve;
use super::super::{Video, VideoError, exr};
use super::sequence::check_sequence;
use crate::{At, Result};

/// The pictures of a folder, in natural order of their names (`frame2` before `frame10`), read one by one.
#[derive(Clone, Debug)]
pub struct Pictures {
    folder: PathBuf,
    files: Vec<PathBuf>,
    extent: [usize; 2],
}

impl Pictures {
    /// Those of a folder, which holds at least one. All must have the size of the first one, and be of one sequence
    /// without gaps.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self> {
        let folder = folder.as_ref();
        let files = pictures(folder)?;
        let stem = |path: &PathBuf| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        check_sequence(&files.iter().map(stem).collect::<Vec<_>>()).at(folder)?;
        let Some(first) = files.first() else {
            return Err(VideoError::Format("holds no .exr pictures".into())).at(folder);
        };
        let Video { height, width, .. } = exr::read(first)?;
        Ok(Self { folder: folder.to_owned(), files, extent: [height, width] })
    }

    /// Number of pictures.
    pub fn count(&self) -> usize {
        self.files.len()
    }

    /// Rows and columns.
    pub fn extent(&self) -> [usize; 2] {
        self.extent
    }

    /// Picture `t`, as a video of one frame.
    pub fn read(&self, t: usize) -> Result<Video> {
        let picture = exr::read_frame(&self.files[t], t)?;
        let [height, width] = self.extent;
        if [picture.height, picture.width] != self.extent {
            return Err(VideoError::Shape(format!(
                "has {}×{} pixels, but the first picture {width}×{height}",
                picture.width, picture.height
            )))
            .at(&self.files[t]);
        }
        Ok(picture)
    }
}

impl ReadVideo for Pictures {
    fn extents(&self) -> [usize; 3] {
        let [height, width] = self.extent;
        [self.count(), height, width]
    }

    fn frame(&mut self, t: usize) -> Result<Vec<f32>> {
        Ok(self.read(t)?.data)
    }

    fn all(self: Box<Self>) -> Result<Video> {
        let ([height, width], frames) = (self.extent, self.count());
        let frame_len = height * width;
        let mut data = reserve(frame_len.saturating_mul(frames)).at(&self.folder)?;
        data.resize(frame_len * frames, 0.0);
        let read_into = |(t, frame): (usize, &mut [f32])| -> Result<()> {
            frame.copy_from_slice(&self.read(t)?.data);
            Ok(())
        };
        let results: Vec<_> = data.par_chunks_mut(frame_len).enumerate().map(read_into).collect();
        // The first failure in the order of frames, not of time.
        results.into_iter().collect::<Result<()>>()?;
        Ok(Video::new(frames, height, width, data)?)
    }
}

/// Reads all pictures of a folder.
pub fn read(path: impl AsRef<Path>) -> Result<Video> {
    Box::new(Pictures::open(path)?).all()
}

/// The `.exr` files of a folder in natural order. Hidden files are none.
fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).at(folder)? {
        let path = entry.at(folder)?.path();
        let hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        if ending(&path) == "exr" && !hidden {
            files.push(path);
        }
    }
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    files.sort_by(|a, b| natural_order(&name(a), &name(b)));
    Ok(files)
}

/// Order of names in which numbers count as numbers.
pub(super) fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    while let (Some(x), Some(y)) = (left.chars().next(), right.chars().next()) {
        let order = if x.is_ascii_digit() && y.is_ascii_digit() {
            // Without leading zeros, the longer number is the larger one.
            let (x, y) = (split_number(&mut left), split_number(&mut right));
            x.len().cmp(&y.len()).then_with(|| x.cmp(y))
        } else {
            left = &left[x.len_utf8()..];
            right = &right[y.len_utf8()..];
            x.cmp(&y)
        };
        if order.is_ne() {
            return order;
        }
    }
    left.len().cmp(&right.len()).then_with(|| a.cmp(b))
}

/// Cuts the number at the beginning off `text` and returns it without leading zeros.
fn split_number<'a>(text: &mut &'a str) -> &'a str {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, rest) = text.split_at(end);
    *text = rest;
    number.trim_start_matches('0')
}

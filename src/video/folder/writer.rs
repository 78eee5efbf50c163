//! Writing pictures, one a frame.

use std::fs;
use std::path::{Path, PathBuf};

use super::super::exr::{self, PlaneWriting};
use super::super::format::{Destination, WriteVideo};
use super::super::pixels::{check_complete, check_frame, check_size};
use super::super::{VideoError, atomic};
use super::names::frame_name;
use super::pool::Pool;
use super::working::{Working, check_replaceable, remove_unfinished, replace};
use crate::frame::Plane;
use crate::{At, Result};

/// Writes a folder of pictures `frame-00000.exr` … from several threads. The pictures are collected in a hidden folder
/// beside the destination, which is renamed when it is complete and removed when it never is.
#[derive(Debug)]
pub(super) struct FolderWriter {
    destination: PathBuf,
    overwrite: bool,
    extents: [usize; 3],
    pushed: usize,
    // Dropped in this order: the threads end before their folder goes.
    pool: Pool,
    folder: Working,
}

impl FolderWriter {
    /// Begins the folder `path` of `extents` [t, y, x]. An existing folder that is not empty is refused unless `overwrite`
    /// says to replace it, and even then if it holds anything but pictures with our names.
    pub fn begin(path: &Path, extents: [usize; 3], overwrite: bool, how: PlaneWriting) -> Result<Self> {
        let hidden = |destination: &Path| {
            let parent = atomic::make_parent(destination)?;
            let folder = atomic::hidden_folder()
                .suffix(".part")
                .tempdir_in(&parent)
                .map_err(atomic::unnamed)
                .at(&parent)?;
            Ok((Working::Hidden(folder), 0))
        };
        Self::begin_in(path, extents, overwrite, how, hidden)
    }

    /// As [`FolderWriter::begin`], but pictures are collected in the folder `partial`, which stays until it is
    /// complete. The pictures that are there already are the first ones of the video.
    fn go_on(
        path: &Path,
        extents: [usize; 3],
        overwrite: bool,
        how: PlaneWriting,
        partial: &Path,
    ) -> Result<Self> {
        let there = |_: &Path| {
            fs::create_dir_all(partial).at(partial)?;
            remove_unfinished(partial)?;
            check_replaceable(partial, true)?;
            let pushed = (0..extents[0]).take_while(|&t| partial.join(frame_name(t)).is_file()).count();
            Ok((Working::Partial(partial.to_owned()), pushed))
        };
        Self::begin_in(path, extents, overwrite, how, there)
    }

    fn begin_in(
        path: &Path,
        extents: [usize; 3],
        overwrite: bool,
        how: PlaneWriting,
        working: impl FnOnce(&Path) -> Result<(Working, usize)>,
    ) -> Result<Self> {
        let [t, y, x] = extents;
        if t == 0 {
            return Err(VideoError::Shape(format!("a video of {t}×{y}×{x} cannot be written"))).at(path);
        }
        check_size(x, y).at(path)?;
        // The folder itself if `path` is a link to it or a name such as `.`.
        let destination = if path.exists() { fs::canonicalize(path).at(path)? } else { path.to_owned() };
        check_replaceable(&destination, overwrite)?;
        let (folder, pushed) = working(&destination)?;
        let pool = Pool::start(folder.path(), x, how).at(path)?;
        Ok(Self { destination, overwrite, extents, pushed, pool, folder })
    }
}

/// Begins a folder, for the table of formats.
pub(super) fn begin(path: &Path, to: Destination<'_>) -> Result<Box<dyn WriteVideo>> {
    let Destination { extents, how, partial } = to;
    Ok(Box::new(match partial {
        None => FolderWriter::begin(path, extents, how.overwrite, how.plane())?,
        Some(partial) => FolderWriter::go_on(path, extents, how.overwrite, how.plane(), partial)?,
    }))
}

impl WriteVideo for FolderWriter {
    fn pushed(&self) -> usize {
        self.pushed
    }

    fn push(&mut self, frame: Plane<'_>) -> Result<()> {
        check_frame(frame, self.pushed, self.extents).at(&self.destination)?;
        self.pool.write(self.pushed, frame.values().to_vec())?;
        self.pushed += 1;
        Ok(())
    }

    /// Waits for all pictures and gives the folder its name.
    fn finish(mut self: Box<Self>) -> Result<()> {
        check_complete(self.pushed, self.extents[0]).at(&self.destination)?;
        self.pool.join()?;
        // Anyone may have removed some meanwhile.
        if let Some(t) = (0..self.pushed).find(|&t| !self.folder.path().join(frame_name(t)).is_file()) {
            let problem = format!("frame {t} is gone; was the folder removed while it was written?");
            return Err(VideoError::Format(problem)).at(self.folder.path());
        }
        let Self { folder, destination, overwrite, .. } = *self;
        replace(folder, &destination, overwrite)
    }

    /// Waits for all pictures, and leaves those before the first one that could not be written.
    fn suspend(mut self: Box<Self>) -> Result<usize> {
        if let Err(error) = self.pool.join() {
            tracing::warn!("{error}");
        }
        let path = |t: usize| self.folder.path().join(frame_name(t));
        let whole = (0..self.pushed).take_while(|&t| path(t).is_file()).count();
        for later in (whole..self.pushed).map(path).filter(|later| later.is_file()) {
            fs::remove_file(&later).at(&later)?;
        }
        Ok(whole)
    }

    fn written(&self, t: usize) -> Result<Option<Vec<f32>>> {
        Ok(Some(exr::read(self.folder.path().join(frame_name(t)))?.data))
    }
}

//! Folders of EXR pictures, one a frame.

use std::cmp::Ordering;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use rayon::prelude::*;
use tempfile::TempDir;

use super::exr::{self, PlaneWriting};
use super::{Video, VideoError, atomic, check_complete, check_frame};
use crate::{At, Error, Result};

/// Most threads that compress and write pictures.
const MAX_THREADS: usize = 8;

/// The pictures of a folder, in natural order of their names (`frame2` before `frame10`), read one by one.
#[derive(Clone, Debug)]
pub struct Pictures {
    files: Vec<PathBuf>,
    extent: [usize; 2],
}

impl Pictures {
    /// Those of a folder, which holds at least one. All must have the size of the first one.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self> {
        let folder = folder.as_ref();
        let files = pictures(folder)?;
        let Some(first) = files.first() else {
            return Err(VideoError::Format("holds no .exr pictures".into())).at(folder);
        };
        let Video { height, width, .. } = exr::read(first)?;
        Ok(Self { files, extent: [height, width] })
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

/// Reads all pictures of a folder.
pub fn read(path: impl AsRef<Path>) -> Result<Video> {
    let path = path.as_ref();
    let pictures = Pictures::open(path)?;
    let ([height, width], frames) = (pictures.extent, pictures.count());
    let frame_len = height * width;
    let Some(len) = frame_len.checked_mul(frames) else {
        return Err(VideoError::Shape("too many pixels".into())).at(path);
    };
    let mut data = Vec::new();
    data.try_reserve_exact(len)
        .map_err(|_| VideoError::Shape(format!("{len} values do not fit into memory")))
        .at(path)?;
    data.resize(len, 0.0);
    let read_into = |(t, frame): (usize, &mut [f32])| -> Result<()> {
        frame.copy_from_slice(&pictures.read(t)?.data);
        Ok(())
    };
    let results: Vec<_> = data.par_chunks_mut(frame_len).enumerate().map(read_into).collect();
    // The first failure in the order of frames, not of time.
    results.into_iter().collect::<Result<()>>()?;
    Ok(Video::new(frames, height, width, data)?)
}

/// The `.exr` files of a folder in natural order. Hidden files are none.
fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).at(folder)? {
        let path = entry.at(folder)?.path();
        let hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        if super::extension(&path) == "exr" && !hidden {
            files.push(path);
        }
    }
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    files.sort_by(|a, b| natural_order(&name(a), &name(b)));
    Ok(files)
}

/// Order of names in which numbers count as numbers.
fn natural_order(a: &str, b: &str) -> Ordering {
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

/// Name of the picture of frame `t`.
fn frame_name(t: usize) -> String {
    format!("frame-{t:05}.exr")
}

/// Whether a name is one that [`FolderWriter`] gives.
fn is_frame_name(name: &str) -> bool {
    let digits = name.strip_prefix("frame-").and_then(|rest| rest.strip_suffix(".exr"));
    digits.is_some_and(|d| d.len() >= 5 && d.bytes().all(|b| b.is_ascii_digit()))
}

/// Writes a folder of pictures `frame-00000.exr` … from several threads. The pictures are collected in a
/// hidden folder
/// beside the destination, which is renamed when it is complete and removed when it never is.
#[derive(Debug)]
pub struct FolderWriter {
    destination: PathBuf,
    overwrite: bool,
    extents: [usize; 3],
    pushed: usize,
    // Dropped in this order: the threads end before their folder goes.
    pool: Pool,
    folder: Working,
}

/// Where pictures are collected.
#[derive(Debug)]
enum Working {
    /// A hidden folder that goes if it is never completed.
    Hidden(TempDir),
    /// A folder that stays, so that another run can go on.
    Partial(PathBuf),
}

impl Working {
    fn path(&self) -> &Path {
        match self {
            Self::Hidden(folder) => folder.path(),
            Self::Partial(folder) => folder,
        }
    }

    /// The folder has got its name: nothing is left to remove.
    fn keep(self) {
        if let Self::Hidden(folder) = self {
            let _ = folder.keep();
        }
    }
}

impl FolderWriter {
    /// Begins the folder `path` of `extents` [t, y, x]. An existing folder that is not empty is refused
    /// unless `overwrite`
    /// says to replace it, and even then if it holds anything but pictures with our names.
    pub fn begin(
        path: impl AsRef<Path>,
        extents: [usize; 3],
        overwrite: bool,
        how: PlaneWriting,
    ) -> Result<Self> {
        let hidden = |destination: &Path| {
            let parent = atomic::make_parent(destination)?;
            let folder = atomic::hidden_folder().suffix(".part").tempdir_in(&parent).at(&parent)?;
            Ok((Working::Hidden(folder), 0))
        };
        Self::begin_in(path.as_ref(), extents, overwrite, how, hidden)
    }

    /// As [`FolderWriter::begin`], but pictures are collected in the folder `partial`, which stays until it is
    /// complete. The pictures that are there already are the first ones of the video; [`FolderWriter::pushed`] says
    /// how many.
    pub fn go_on(
        path: impl AsRef<Path>,
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
        Self::begin_in(path.as_ref(), extents, overwrite, how, there)
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
        super::check_size(x, y).at(path)?;
        // The folder itself if `path` is a link to it or a name such as `.`.
        let destination = if path.exists() { fs::canonicalize(path).at(path)? } else { path.to_owned() };
        check_replaceable(&destination, overwrite)?;
        let (folder, pushed) = working(&destination)?;
        let pool = Pool::start(folder.path(), x, how).at(path)?;
        Ok(Self { destination, overwrite, extents, pushed, pool, folder })
    }

    /// Frames that are there.
    pub fn pushed(&self) -> usize {
        self.pushed
    }

    /// Frame `t`, of those that were there when the writer began.
    pub fn frame(&self, t: usize) -> Result<Vec<f32>> {
        Ok(exr::read(self.folder.path().join(frame_name(t)))?.data)
    }

    /// Waits for all pictures, and leaves what there is: those before the first one that could not be written. Returns
    /// their number.
    pub fn suspend(mut self) -> Result<usize> {
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

    /// Appends one frame [y, x]. A failure to write an earlier frame may be reported here.
    pub fn push(&mut self, frame: &[f32]) -> Result<()> {
        check_frame(frame, self.pushed, self.extents).at(&self.destination)?;
        self.pool.write(self.pushed, frame.to_vec())?;
        self.pushed += 1;
        Ok(())
    }

    /// Waits for all pictures and gives the folder its name.
    pub fn finish(mut self) -> Result<()> {
        check_complete(self.pushed, self.extents[0]).at(&self.destination)?;
        self.pool.join()?;
        // Anyone may have removed some meanwhile.
        if let Some(t) = (0..self.pushed).find(|&t| !self.folder.path().join(frame_name(t)).is_file()) {
            let problem = format!("frame {t} is gone; was the folder removed while it was written?");
            return Err(VideoError::Format(problem)).at(self.folder.path());
        }
        replace(self.folder, &self.destination, self.overwrite)
    }
}

/// Whether there is nothing at `destination`, an empty folder, or one that `overwrite` allows to replace.
/// Returns the files
/// to remove.
fn check_replaceable(destination: &Path, overwrite: bool) -> Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(destination) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error).at(destination),
    };
    let mut files = Vec::new();
    for entry in entries {
        let entry = entry.at(destination)?;
        let name = entry.file_name();
        let is_file = entry.file_type().at(entry.path())?.is_file();
        if !is_file || !is_frame_name(&name.to_string_lossy()) {
            let name = name.to_string_lossy();
            let problem = format!("holds '{name}', which is no picture of a sequence; choose another folder");
            return Err(Error::Usage(problem)).at(destination);
        }
        files.push(entry.path());
    }
    if !files.is_empty() && !overwrite {
        let problem = "is not empty; choose another folder or allow it to be overwritten";
        return Err(Error::Usage(problem.into())).at(destination);
    }
    Ok(files)
}

/// Removes what a killed process was writing into a folder that nobody else writes.
fn remove_unfinished(folder: &Path) -> Result<()> {
    for entry in fs::read_dir(folder).at(folder)? {
        let entry = entry.at(folder)?;
        if atomic::is_unfinished(&entry.file_name()) && entry.file_type().at(entry.path())?.is_file() {
            fs::remove_file(entry.path()).at(entry.path())?;
        }
    }
    Ok(())
}

/// Removes a folder in which pictures were collected.
pub(super) fn remove_partial(folder: &Path) -> Result<()> {
    remove_unfinished(folder)?;
    remove(folder)
}

/// Removes a folder that holds nothing but pictures with our names.
fn remove(folder: &Path) -> Result<()> {
    check_replaceable(folder, true)?.iter().try_for_each(|file| fs::remove_file(file).at(file))?;
    fs::remove_dir(folder).at(folder)
}

/// Puts the complete folder `complete` in the place of `destination`.
fn replace(complete: Working, destination: &Path, overwrite: bool) -> Result<()> {
    // Anyone may have written there meanwhile.
    check_replaceable(destination, overwrite)?;
    let aside = if destination.exists() {
        let parent = atomic::make_parent(destination)?;
        let aside = atomic::hidden_folder().suffix(".old").tempdir_in(&parent).at(&parent)?;
        let old = aside.path().join("sequence");
        fs::rename(destination, &old).at(destination)?;
        Some((aside, old))
    } else {
        None
    };
    if let Err(error) = fs::rename(complete.path(), destination) {
        if let Some((aside, old)) = aside {
            // Back to where it was; if even that fails, it must not be removed with its temporary folder.
            if fs::rename(&old, destination).is_err() {
                let _ = aside.keep();
            }
        }
        return Err(error).at(destination);
    }
    complete.keep();
    if let Some((aside, old)) = aside {
        // Only what was checked above goes; a file that came in between stays, in the hidden folder.
        if remove(&old).is_err() {
            let kept = aside.keep();
            tracing::warn!("what was in {} before is kept in {}", destination.display(), kept.display());
        }
    }
    Ok(())
}

type Job = (usize, Vec<f32>);

/// What the threads of a pool do.
const WRITES: &str = "writes pictures";

/// Threads that write pictures. Few frames wait at a time, so that a slow disk slows the caller down instead
/// of
/// filling the memory.
#[derive(Debug)]
struct Pool {
    jobs: Option<SyncSender<Job>>,
    threads: Vec<JoinHandle<()>>,
    failure: Arc<Mutex<Option<Error>>>,
}

impl Pool {
    fn start(folder: &Path, width: usize, how: PlaneWriting) -> std::io::Result<Self> {
        let count = thread::available_parallelism().map_or(1, usize::from).min(MAX_THREADS);
        let (jobs, waiting) = sync_channel::<Job>(count);
        let waiting = Arc::new(Mutex::new(waiting));
        let mut pool = Self { jobs: Some(jobs), threads: Vec::new(), failure: Arc::default() };
        for _ in 0..count {
            let (folder, waiting, failure) = (folder.to_owned(), waiting.clone(), pool.failure.clone());
            let work = move || {
                while let Some((t, plane)) = next(&waiting) {
                    // A folder that was removed is not made anew: the frames in it are lost.
                    let there = fs::metadata(&folder).map(drop).at(&folder);
                    let path = folder.join(frame_name(t));
                    if let Err(error) = there.and_then(|()| exr::write(path, &plane, width, how)) {
                        failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                    }
                }
            };
            pool.threads.push(thread::Builder::new().name("write-exr".into()).spawn(work)?);
        }
        Ok(pool)
    }

    fn write(&self, t: usize, plane: Vec<f32>) -> Result<()> {
        self.check()?;
        let sent = self.jobs.as_ref().is_some_and(|jobs| jobs.send((t, plane)).is_ok());
        if sent { Ok(()) } else { Err(Error::Panicked(WRITES)) }
    }

    /// Waits for all that was given to the pool.
    fn join(&mut self) -> Result<()> {
        self.jobs = None;
        let ends: Vec<_> = self.threads.drain(..).map(JoinHandle::join).collect();
        let panicked = ends.iter().any(thread::Result::is_err);
        self.check()?;
        if panicked { Err(Error::Panicked(WRITES)) } else { Ok(()) }
    }

    fn check(&self) -> Result<()> {
        match self.failure.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        // The threads must have left the folder before it is removed; their failures no longer matter.
        let _ = self.join();
    }
}

fn next(waiting: &Mutex<Receiver<Job>>) -> Option<Job> {
    waiting.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOW: PlaneWriting = PlaneWriting { half: true, frame_period_ms: None, anchor: None };

    fn ramp(frames: usize) -> Video {
        Video::new(frames, 3, 4, (0..frames * 12).map(|i| i as f32 / 8.0).collect()).unwrap()
    }

    fn write(path: &Path, video: &Video, overwrite: bool) -> Result<()> {
        let mut writer =
            FolderWriter::begin(path, [video.frames, video.height, video.width], overwrite, HOW)?;
        (0..video.frames).try_for_each(|t| writer.push(video.frame(t)))?;
        writer.finish()
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
        assert_eq!(
            names,
            ["a", "b", "b1", "b1x", "b9", "b010", "b10", "b99999999999999999999999", "é2", "é10"]
        );
        let folder = tempfile::tempdir().unwrap();
        for (name, value) in [("frame10.exr", 3.0), ("frame2.exr", 2.0), ("frame1.EXR", 1.0)] {
            exr::write(folder.path().join(name), &[value], 1, HOW).unwrap();
        }
        fs::write(folder.path().join(".frame3.exr"), b"hidden").unwrap();
        fs::write(folder.path().join("notes.txt"), b"").unwrap();
        assert_eq!(read(folder.path()).unwrap().data, [1.0, 2.0, 3.0]);
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
        writer.push(ramp(1).frame(0)).unwrap();
        fs::create_dir_all(path.join("frame-00000.exr")).unwrap();
        assert!(writer.finish().is_err());
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
        writer.push(ramp(1).frame(0)).unwrap();
        drop(writer);
        assert!(names(folder.path()).is_empty());
        let mut writer = FolderWriter::begin(&path, [3, 3, 4], false, HOW).unwrap();
        writer.push(ramp(1).frame(0)).unwrap();
        assert!(writer.finish().unwrap_err().to_string().contains("1 of 3"));
        assert!(names(folder.path()).is_empty());
        let mut writer = FolderWriter::begin(&path, [1, 3, 4], false, HOW).unwrap();
        let error = writer.push(&[f32::NAN; 12]).unwrap_err().to_string();
        assert!(error.contains("row 0, column 0"), "{error}");
        assert!(writer.push(&[0.0; 11]).is_err());
    }
}

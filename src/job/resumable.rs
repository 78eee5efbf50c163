//! A video that stays where a run ends early, and is gone on with.

use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{Left, Sink, Warning};
use crate::error::ModuleError;
use crate::fingerprint::{Difference, Fingerprint};
use crate::synth::{Report, ResultFrame};
use crate::video::{VideoWriter, Writing};
use crate::{At, Error, Result};

/// Why a result cannot be begun, or gone on with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ResumeError {
    /// There is no interrupted result.
    #[error("there is no interrupted result to go on with{}", .0.as_ref().map_or_else(String::new, |why| format!(": {why}")))]
    Nothing(Option<Box<Error>>),
    /// There is one, and nobody said what to do with it.
    #[error("holds an interrupted result: go on with --resume, or begin anew with --overwrite")]
    Interrupted,
    /// Another process is writing it.
    #[error("another process is writing this result")]
    Busy,
    /// Its frames would not be made as those that are there.
    #[error("the result was begun with another {key}: {before} instead of {now}")]
    Differs {
        /// What differs.
        key: String,
        /// What it was.
        before: Value,
        /// What it is now.
        now: Value,
    },
}

impl ModuleError for ResumeError {}

/// Whether a result is begun, or gone on with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// With its first frame.
    Anew,
    /// Where an interrupted run stopped.
    WhereItStopped,
}

/// A result that stays beside its name until it is complete, with a note of how it is being made.
pub struct Resumable {
    writer: VideoWriter,
    target: PathBuf,
    frames: usize,
    note: Note,
}

/// The note, which is locked for as long as this process writes the result.
struct Note {
    path: PathBuf,
    file: File,
}

impl Note {
    /// Opens the note of a result, or begins one if `new` allows it. An empty one is new. A warning where it cannot be
    /// locked.
    fn lock(path: PathBuf, new: bool) -> Result<(Self, Option<Warning>)> {
        loop {
            let open = File::options().read(true).write(true).create(new).truncate(false).open(&path);
            let file = match open {
                Err(error) if error.kind() == ErrorKind::NotFound && !new => {
                    return Err(ResumeError::Nothing(None)).at(&path);
                }
                open => open.at(&path)?,
            };
            match file.try_lock() {
                // Who held it may have completed the result and removed it.
                Ok(()) if path.exists() => return Ok((Self { path, file }, None)),
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Err(ResumeError::Busy).at(&path),
                Err(TryLockError::Error(error)) => {
                    let warning = Warning::Unlocked { path: path.clone(), error };
                    return Ok((Self { path, file }, Some(warning)));
                }
            }
        }
    }

    fn read(&mut self) -> Result<Vec<u8>> {
        let mut text = Vec::new();
        self.file.read_to_end(&mut text).at(&self.path)?;
        Ok(text)
    }

    fn write(&mut self, made: &Fingerprint) -> Result<()> {
        let text = made.text()?;
        let mut write = || {
            self.file.set_len(0)?;
            self.file.rewind()?;
            self.file.write_all(&text)
        };
        write().at(&self.path)
    }

    fn remove(self) -> Result<()> {
        match std::fs::remove_file(&self.path) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error).at(&self.path),
            _ => Ok(()),
        }
    }
}

impl Resumable {
    /// Begins `target` of `extents` [t, y, x], or goes on with it. `made` says all that frames depend on: a result is only
    /// gone on with as it was begun. One process at a time can write it; a warning where that cannot be made sure.
    pub fn begin(
        target: &Path,
        extents: [usize; 3],
        how: Writing,
        begin: Begin,
        made: &Fingerprint,
    ) -> Result<(Self, Option<Warning>)> {
        let new = begin == Begin::Anew;
        let mut note = VideoWriter::partial(target).into_os_string();
        note.push(".json");
        let note = PathBuf::from(note);
        if let Some(folder) = note.parent().filter(|folder| new && !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).at(folder)?;
        }
        let (mut note, warning) = Note::lock(note, new)?;
        let before = note.read()?;
        match Self::writer(target, extents, how, (begin, &before), made) {
            Ok(writer) => {
                note.write(made)?;
                let result = Self { writer, target: target.to_owned(), frames: extents[0], note };
                Ok((result, warning))
            }
            Err(error) => {
                if before.is_empty() {
                    note.remove()?;
                }
                Err(error)
            }
        }
    }

    /// Where frames go, once it is known that they may; `before` is what the note said.
    fn writer(
        target: &Path,
        extents: [usize; 3],
        how: Writing,
        (begin, before): (Begin, &[u8]),
        made: &Fingerprint,
    ) -> Result<VideoWriter> {
        let partial = VideoWriter::partial(target);
        if begin == Begin::WhereItStopped {
            let nothing = |error| ResumeError::Nothing(Some(Box::new(error)));
            let before = Fingerprint::read(before).map_err(nothing).at(&partial)?;
            if let Some(Difference { key, before, now }) = made.difference(&before)? {
                return Err(ResumeError::Differs { key, before, now }).at(&partial);
            }
        } else if partial.exists() {
            if !how.overwrite {
                return Err(ResumeError::Interrupted).at(&partial);
            }
            VideoWriter::discard_partial(target)?;
        }
        VideoWriter::go_on(target, extents, how)
    }

    /// The values [y, x] of frame `t` of those that an earlier run left, if the format can look at them meanwhile.
    pub fn written(&self, t: usize) -> Result<Option<Vec<f32>>> {
        self.writer.written(t)
    }
}

impl Sink for Resumable {
    type Output = PathBuf;

    fn begun(&self) -> usize {
        self.writer.pushed()
    }

    fn take(&mut self, result: &ResultFrame) -> Result<()> {
        self.writer.push(result.frame.plane())
    }

    fn finish(self, _: &Report) -> Result<PathBuf> {
        self.writer.finish()?;
        self.note.remove()?;
        Ok(self.target)
    }

    fn suspend(self) -> Result<Option<Left>> {
        let done = self.writer.suspend()?;
        if done == 0 {
            VideoWriter::discard_partial(&self.target)?;
            self.note.remove()?;
        }
        Ok(Some(Left { done, frames: self.frames, partial: VideoWriter::partial(&self.target) }))
    }
}

//! Interrupting a run so that it can go on: Ctrl-C, and what is left behind.

use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::video::{VideoWriter, Writing};
use crate::{At, Error, Result};
use serde_json::Value;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::options::show;
use super::terminal;

/// Exit code of a program that Ctrl-C ended.
const INTERRUPTED: i32 = 130;

/// Sets `stop` at the first Ctrl-C; the second one ends the program at once.
pub fn stop_on_signal(stop: &Arc<AtomicBool>) -> Result<()> {
    for signal in [SIGINT, SIGTERM] {
        // In this order: the first signal finds the flag unset.
        flag::register_conditional_shutdown(signal, INTERRUPTED, Arc::clone(stop))?;
        flag::register(signal, Arc::clone(stop))?;
    }
    Ok(())
}

/// A result that stays beside its name until it is complete, with a note of how it is being made.
pub struct Resumable {
    /// Where frames go.
    pub writer: VideoWriter,
    target: PathBuf,
    note: Note,
}

/// The note, which is locked for as long as this process writes the result.
struct Note {
    path: PathBuf,
    file: File,
}

impl Note {
    /// Opens the note of a result, or begins one if `new` allows it. An empty one is new.
    fn lock(path: PathBuf, new: bool) -> Result<Self> {
        loop {
            let open = File::options().read(true).write(true).create(new).truncate(false).open(&path);
            let file = match open {
                Err(error) if error.kind() == ErrorKind::NotFound && !new => {
                    let problem = "there is no interrupted result to go on with";
                    return Err(Error::Usage(problem.into())).at(&path);
                }
                open => open.at(&path)?,
            };
            match file.try_lock() {
                // Who held it may have completed the result and removed it.
                Ok(()) if path.exists() => return Ok(Self { path, file }),
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    return Err(Error::Usage("another process is writing this result".into())).at(&path);
                }
                Err(TryLockError::Error(error)) => {
                    let name = show(&path);
                    terminal::warn(&format!("{name}: cannot be locked ({error}); let nobody else write it"));
                    return Ok(Self { path, file });
                }
            }
        }
    }

    fn read(&mut self) -> Result<Vec<u8>> {
        let mut text = Vec::new();
        self.file.read_to_end(&mut text).at(&self.path)?;
        Ok(text)
    }

    fn write(&mut self, made: &Value) -> Result<()> {
        let text = serde_json::to_vec_pretty(made)?;
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
    /// Begins `target` of `extents` [t, y, x], or goes on with it if `resume`. `made` says all that frames depend on:
    /// a result is only gone on with as it was begun. One process at a time can write it.
    pub fn begin(
        target: &Path,
        extents: [usize; 3],
        how: Writing,
        resume: bool,
        made: &Value,
    ) -> Result<Self> {
        let mut note = VideoWriter::partial(target).into_os_string();
        note.push(".json");
        let note = PathBuf::from(note);
        if let Some(folder) = note.parent().filter(|folder| !resume && !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).at(folder)?;
        }
        let mut note = Note::lock(note, !resume)?;
        let before = note.read()?;
        match Self::writer(target, extents, how, (resume, &before), made) {
            Ok(writer) => {
                note.write(made)?;
                Ok(Self { writer, target: target.to_owned(), note })
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
        (resume, before): (bool, &[u8]),
        made: &Value,
    ) -> Result<VideoWriter> {
        let partial = VideoWriter::partial(target);
        if resume {
            let begun: Value = serde_json::from_slice(before).map_err(|error| {
                Error::Usage(format!("there is no interrupted result to go on with: {error}")).at(&partial)
            })?;
            if let Some(key) = differing_key(&begun, made) {
                let problem = format!(
                    "the result was begun with another {key}: {} instead of {}",
                    begun[&key], made[&key]
                );
                return Err(Error::Usage(problem)).at(&partial);
            }
        } else if partial.exists() {
            if !how.overwrite {
                let problem =
                    "holds an interrupted result: go on with --resume, or begin anew with --overwrite";
                return Err(Error::Usage(problem.into())).at(&partial);
            }
            VideoWriter::discard_partial(target)?;
        }
        VideoWriter::go_on(target, extents, how)
    }

    /// Completes the result.
    pub fn finish(self) -> Result<()> {
        self.writer.finish()?;
        self.note.remove()
    }

    /// Leaves what there is, and says what that is and how to go on.
    pub fn suspend(self, frames: usize) -> Result<String> {
        let done = self.writer.suspend()?;
        let partial = VideoWriter::partial(&self.target);
        if done == 0 {
            VideoWriter::discard_partial(&self.target)?;
            self.note.remove()?;
            return Ok("stopped before the first frame; nothing is left".into());
        }
        let partial = show(&partial);
        Ok(format!("stopped after {done} of {frames} frames, which are in {partial}; go on with --resume"))
    }
}

/// The first key whose values differ.
fn differing_key(a: &Value, b: &Value) -> Option<String> {
    let keys = |value: &Value| value.as_object().map(|map| map.keys().cloned().collect::<Vec<_>>());
    let all = keys(a).into_iter().chain(keys(b)).flatten();
    all.into_iter().find(|key| a[key] != b[key])
}

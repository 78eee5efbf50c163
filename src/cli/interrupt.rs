//! Interrupting a run so that it can go on: Ctrl-C, and what is left behind.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use pix2hdr::video::{self, VideoWriter, Writing};
use pix2hdr::{At, Error, Result};
use serde_json::Value;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::options::show;

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
    note: PathBuf,
}

impl Resumable {
    /// Begins `target` of `extents` [t, y, x], or goes on with it if `resume`. `made` says all that frames depend on:
    /// a result is only gone on with as it was begun.
    pub fn begin(
        target: &Path,
        extents: [usize; 3],
        how: Writing,
        resume: bool,
        made: &Value,
    ) -> Result<Self> {
        let partial = VideoWriter::partial(target);
        let mut note = partial.clone().into_os_string();
        note.push(".json");
        let note = PathBuf::from(note);
        if resume {
            let text = std::fs::read(&note).map_err(Error::from).and_then(|text| {
                serde_json::from_slice::<Value>(&text).map_err(|e| Error::Usage(e.to_string()))
            });
            let begun = text.map_err(|error| {
                Error::Usage(format!("there is no interrupted result to go on with: {error}")).at(&note)
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
            discard(target, &note)?;
        }
        let writer = VideoWriter::go_on(target, extents, how)?;
        let text = serde_json::to_vec_pretty(made).map_err(|e| Error::Usage(e.to_string()))?;
        video::atomic::write_bytes(&note, &text)?;
        Ok(Self { writer, target: target.to_owned(), note })
    }

    /// Completes the result.
    pub fn finish(self) -> Result<()> {
        self.writer.finish()?;
        std::fs::remove_file(&self.note).at(&self.note)
    }

    /// Leaves what there is. Returns the error that says so.
    pub fn suspend(self, frames: usize) -> Result<Error> {
        let done = self.writer.pushed();
        self.writer.suspend()?;
        let partial = VideoWriter::partial(&self.target);
        if done == 0 {
            discard(&self.target, &self.note)?;
            return Ok(Error::Usage("interrupted before the first frame; nothing is left".into()));
        }
        Ok(Error::Usage(format!(
            "interrupted after {done} of {frames} frames, which are in {}; go on with --resume",
            show(&partial)
        )))
    }
}

/// Removes an interrupted result and its note.
fn discard(target: &Path, note: &Path) -> Result<()> {
    VideoWriter::discard_partial(target)?;
    match std::fs::remove_file(note) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error).at(note),
        _ => Ok(()),
    }
}

/// The first key whose values differ.
fn differing_key(a: &Value, b: &Value) -> Option<String> {
    let keys = |value: &Value| value.as_object().map(|map| map.keys().cloned().collect::<Vec<_>>());
    let all = keys(a).into_iter().chain(keys(b)).flatten();
    all.into_iter().find(|key| a[key] != b[key])
}

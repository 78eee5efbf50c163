//! The folder in which pictures are collected, and how it takes the place of another one.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::super::atomic;
use super::names::is_frame_name;
use crate::{At, Error, Result};

/// Where pictures are collected.
#[derive(Debug)]
pub(super) enum Working {
    /// A hidden folder that goes if it is never completed.
    Hidden(TempDir),
    /// A folder that stays, so that another run can go on.
    Partial(PathBuf),
}

impl Working {
    pub fn path(&self) -> &Path {
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

/// Whether there is nothing at `destination`, an empty folder, or one that `overwrite` allows to replace.
/// Returns the files to remove.
pub(in crate::video) fn check_replaceable(destination: &Path, overwrite: bool) -> Result<Vec<PathBuf>> {
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
        let problem = "is not empty; --overwrite replaces its pictures, or name another folder";
        return Err(Error::Usage(problem.into())).at(destination);
    }
    Ok(files)
}

/// Removes what a killed process was writing into a folder that nobody else writes.
pub(super) fn remove_unfinished(folder: &Path) -> Result<()> {
    for entry in fs::read_dir(folder).at(folder)? {
        let entry = entry.at(folder)?;
        if atomic::is_unfinished(&entry.file_name()) && entry.file_type().at(entry.path())?.is_file() {
            fs::remove_file(entry.path()).at(entry.path())?;
        }
    }
    Ok(())
}

/// Removes a folder in which pictures were collected.
pub(in crate::video) fn remove_partial(folder: &Path) -> Result<()> {
    remove_unfinished(folder)?;
    remove(folder)
}

/// Removes a folder that holds nothing but pictures with our names.
fn remove(folder: &Path) -> Result<()> {
    check_replaceable(folder, true)?.iter().try_for_each(|file| fs::remove_file(file).at(file))?;
    fs::remove_dir(folder).at(folder)
}

/// Puts the complete folder `complete` in the place of `destination`.
pub(super) fn replace(complete: Working, destination: &Path, overwrite: bool) -> Result<()> {
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

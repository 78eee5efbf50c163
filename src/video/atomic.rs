//! Files that appear whole or not at all.
//!
//! A file is written under a hidden name in the folder that it is for, and gets its own name when it is complete.
//! What stood there before stays until then. A result that a killed process leaves behind is never half a file;
//! a loss of power is not guarded against.

use std::ffi::OsStr;
use std::fs;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::{At, Error, Result};

/// How names of what is not complete begin.
const PREFIX: &str = ".pix2hdr-";
/// How names of files that are not complete end.
const SUFFIX: &str = ".part";

/// A file under a hidden name. Dropped unfinished, it is removed.
#[derive(Debug)]
pub struct AtomicFile {
    /// Where the content goes.
    pub content: BufWriter<Hidden>,
    path: PathBuf,
}

/// The file itself. Its failures do not speak of the hidden name, which nobody knows.
#[derive(Debug)]
pub struct Hidden(NamedTempFile);

impl Write for Hidden {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.as_file_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.as_file_mut().flush()
    }
}

impl Seek for Hidden {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.as_file_mut().seek(to)
    }
}

impl AtomicFile {
    /// Begins the file `path`; makes its folder if there is none.
    pub fn create(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let folder = make_parent(path)?;
        let file = hidden_file().suffix(SUFFIX).tempfile_in(folder).map_err(unnamed).at(path)?;
        Ok(Self { content: BufWriter::with_capacity(1 << 20, Hidden(file)), path: path.to_owned() })
    }

    /// Gives the complete file its name.
    pub fn finish(self) -> Result<()> {
        let file = self.content.into_inner().map_err(io::IntoInnerError::into_error).at(&self.path)?;
        file.0.persist(&self.path).map_err(|failure| failure.error).at(&self.path)?;
        Ok(())
    }
}

/// Writes the file `path` with `write`, whole or not at all.
pub fn write(path: impl AsRef<Path>, write: impl FnOnce(&mut BufWriter<Hidden>) -> Result<()>) -> Result<()> {
    let path = path.as_ref();
    let mut file = AtomicFile::create(path)?;
    write(&mut file.content).at(path)?;
    file.finish()
}

/// Writes the file `path` with the content `bytes`, whole or not at all.
pub fn write_bytes(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    write(path, |content| Ok(content.write_all(bytes)?))
}

/// Makes the folder that `path` lies in, and returns it.
pub(super) fn make_parent(path: &Path) -> Result<PathBuf> {
    if path.file_name().is_none() {
        return Err(Error::Usage("not a name for a file or folder".into())).at(path);
    }
    let parent = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(parent).at(parent)?;
    Ok(parent.to_owned())
}

/// What the system said, without the name that a file had before it is complete, which nobody knows.
pub(super) fn unnamed(error: io::Error) -> io::Error {
    let said = error.to_string();
    match said.rsplit_once(" at path ") {
        Some((why, _)) => io::Error::new(error.kind(), why),
        None => error,
    }
}

/// Whether a file's name is one that it had before it was complete.
pub(super) fn is_unfinished(name: &OsStr) -> bool {
    let name = name.as_encoded_bytes();
    name.starts_with(PREFIX.as_bytes()) && name.ends_with(SUFFIX.as_bytes())
}

/// Builder of files under names for what is not complete yet.
pub(super) fn hidden_file() -> tempfile::Builder<'static, 'static> {
    hidden(0o666)
}

/// Builder of folders under names for what is not complete yet.
pub(super) fn hidden_folder() -> tempfile::Builder<'static, 'static> {
    hidden(0o777)
}

/// `mode` is what files of a user have by default (the umask still applies); temporary ones would be closed to
/// everyone else.
fn hidden(mode: u32) -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode));
    #[cfg(not(unix))]
    let _ = mode;
    builder
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_file_appears_whole_in_a_new_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/c.txt");
        write_bytes(&path, b"one").unwrap();
        write_bytes(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(names(path.parent().unwrap()), ["c.txt"]);
    }

    #[test]
    fn a_failure_leaves_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.txt");
        write_bytes(&path, b"one").unwrap();
        let failed = write(&path, |content| {
            content.write_all(b"half")?;
            Err(Error::Usage("no more".into()))
        });
        assert!(failed.unwrap_err().to_string().contains("c.txt"));
        assert_eq!(fs::read(&path).unwrap(), b"one");
        assert_eq!(names(folder.path()), ["c.txt"]);
    }

    #[test]
    fn a_folder_in_the_way_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.txt");
        fs::create_dir(&path).unwrap();
        assert!(write_bytes(&path, b"one").unwrap_err().to_string().contains("c.txt"));
        let below = path.join("x");
        fs::write(&below, b"").unwrap();
        assert!(write_bytes(below.join("y"), b"one").unwrap_err().to_string().contains('x'));
        assert!(write_bytes("/", b"one").is_err());
    }

    #[cfg(unix)]
    #[test]
    fn others_may_read_the_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, theirs) = (folder.path().join("ours"), folder.path().join("theirs"));
        write_bytes(&ours, b"").unwrap();
        fs::write(&theirs, b"").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&theirs));
    }
}

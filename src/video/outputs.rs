//! What a command may write: the one rule, which is asked before work begins.

use std::fs;
use std::path::{Path, PathBuf};

use super::atomic::{hidden_file, unnamed};
use super::files;
use super::folder::check_replaceable;
use super::writing::check_free;
use crate::system::is_same_file;
use crate::{At, Error, Result};

/// What a command may write: nothing that is there, unless it may be replaced, and never what it reads.
#[derive(Clone, Debug, Default)]
pub struct Outputs {
    overwrite: bool,
    sources: Vec<PathBuf>,
}

impl Outputs {
    /// Outputs that may replace what is there if `overwrite` says so.
    pub fn new(overwrite: bool) -> Self {
        Self { overwrite, sources: Vec::new() }
    }

    /// Also keeps `sources`, which are read, from being written. One that is not there is nothing.
    #[must_use]
    pub fn reading<P: Into<PathBuf>>(mut self, sources: impl IntoIterator<Item = P>) -> Self {
        self.sources.extend(sources.into_iter().map(Into::into));
        self
    }

    /// Refuses `target` as a file to write where that would destroy something, or cannot be done.
    pub fn check(&self, target: impl AsRef<Path>) -> Result<()> {
        let target = target.as_ref();
        self.check_no_source(target)?;
        check_free(target, self.overwrite)?;
        if target.is_dir() {
            return Err(Error::Usage("is a folder, not a file".into())).at(target);
        }
        check_writable(target)
    }

    /// As [`Outputs::check`], of a video, which its name says the kind of (see [`VideoWriter`](super::VideoWriter)).
    pub fn check_video(&self, target: impl AsRef<Path>) -> Result<()> {
        let target = target.as_ref();
        if !files::to_write(target)?.is_folder() {
            return self.check(target);
        }
        self.check_no_source(target)?;
        check_replaceable(target, self.overwrite)?;
        check_writable(&target.join("frame"))
    }

    /// Refuses what is read, by whatever name: the file or folder itself, one around it, and what lies directly in a
    /// folder of frames.
    fn check_no_source(&self, target: &Path) -> Result<()> {
        let whole = fs::canonicalize(target).ok();
        let is_read = |source: &PathBuf| {
            let around = whole.as_ref().zip(fs::canonicalize(source).ok());
            is_same_file(source, target)
                || around.is_some_and(|(target, source)| {
                    source.starts_with(target) || (source.is_dir() && target.parent() == Some(&source))
                })
        };
        if self.sources.iter().any(is_read) {
            let problem = "is the source itself, which is read; name another file or folder";
            return Err(Error::Usage(problem.into())).at(target);
        }
        Ok(())
    }
}

/// Refuses the name of a file as that of a folder which is made for several files.
pub fn check_folder_name(path: &Path) -> Result<()> {
    if path.extension().is_some() && !path.is_dir() {
        let problem = "names one file, but a folder for several is made; its name has no ending";
        return Err(Error::Usage(problem.into())).at(path);
    }
    Ok(())
}

/// Whether a file can be made beside `target`, or in the first folder above that there is.
fn check_writable(target: &Path) -> Result<()> {
    let here = Path::new(".");
    let above = target.ancestors().skip(1);
    let mut above = above.map(|folder| if folder.as_os_str().is_empty() { here } else { folder });
    let Some(folder) = above.find(|folder| folder.exists()) else { return Ok(()) };
    match hidden_file().tempfile_in(folder) {
        Ok(_) => Ok(()),
        Err(error) => Err(unnamed(error)).at(folder),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(outputs: &Outputs, target: &Path, word: &str) {
        let told = outputs.check(target).unwrap_err().to_string();
        assert!(
            told.contains(word) && told.contains(&*target.file_name().unwrap().to_string_lossy()),
            "{told}"
        );
    }

    #[test]
    fn what_is_there_is_kept_unless_it_may_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (new, old) = (folder.path().join("a/b/new"), folder.path().join("old"));
        fs::write(&old, "mine").unwrap();
        let [keep, replace] = [false, true].map(Outputs::new);
        keep.check(&new).unwrap();
        replace.check(&old).unwrap();
        refused(&keep, &old, "--overwrite");
        assert!(!new.parent().unwrap().exists(), "a check makes no folders");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a check leaves no file");
        // A folder is never replaced by a file, nor a file by what lies in a folder of its name.
        refused(&replace, folder.path(), "folder");
        assert!(keep.check(old.join("deeper")).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn a_source_is_no_target_by_any_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("video")).unwrap();
        fs::write(path("video/frame.exr"), "mine").unwrap();
        std::os::unix::fs::symlink(path("video"), path("linked")).unwrap();
        std::os::unix::fs::symlink(path("video/frame.exr"), path("link.exr")).unwrap();
        fs::hard_link(path("video/frame.exr"), path("hard.exr")).unwrap();
        let outputs = Outputs::new(true).reading([path("video/frame.exr"), path("not-there")]);
        for name in
            ["video/frame.exr", "video/../video/frame.exr", "linked/frame.exr", "link.exr", "hard.exr"]
        {
            refused(&outputs, &path(name), "source");
        }
        // Neither a folder around it, nor a frame of a folder that is read.
        assert!(outputs.check_video(path("linked")).unwrap_err().to_string().contains("source"));
        let outputs = Outputs::new(true).reading([path("linked")]);
        refused(&outputs, &path("video/frame.exr"), "source");
        outputs.check(path("video/new")).unwrap();
        outputs.check(path("other")).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_there_even_if_it_leads_nowhere() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(folder.path().join("nowhere"), &link).unwrap();
        refused(&Outputs::new(false), &link, "--overwrite");
    }

    #[test]
    fn a_file_is_no_folder() {
        let folder = tempfile::tempdir().unwrap();
        let dotted = folder.path().join("a.b");
        for name in ["x.mp4", "x.exr", "x.tif", "x.npz"] {
            assert!(check_folder_name(&folder.path().join(name)).unwrap_err().to_string().contains(name));
            assert!(name == "x.exr" || Outputs::new(true).check_video(folder.path().join(name)).is_err());
        }
        check_folder_name(&folder.path().join("x")).unwrap();
        assert!(check_folder_name(&dotted).is_err());
        fs::create_dir(&dotted).unwrap();
        check_folder_name(&dotted).unwrap();
    }
}

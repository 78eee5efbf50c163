//! What can go wrong, as one type that names the file where there is one.

use std::io;
use std::path::{Path, PathBuf};

/// The result of everything that can fail here.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Any failure of the library. Its text is one line that a user can act on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A failure while reading or writing `path`.
    #[error("{}: {source}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What went wrong with it.
        source: Box<Error>,
    },
    /// The operating system refused.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// JSON that cannot be read or written.
    #[error("{0}")]
    Json(#[from] serde_json::Error),
    /// What a module has to say of its own matter; [`Error::cause`] finds it.
    #[error("{0}")]
    Module(Box<dyn std::error::Error + Send + Sync>),
    /// Words of a user that contradict each other or the data.
    #[error("{0}")]
    Usage(String),
    /// A function of the library was not called as it says: a mistake of the program, not of its user.
    #[error("{0}")]
    Misuse(String),
    /// A thread panicked, which is named by what it does.
    #[error("the thread that {0} panicked")]
    Panicked(&'static str),
    /// Whoever wanted the result does not want it any more.
    #[error("stopped")]
    Stopped,
}

/// The error type of a module, which becomes an [`Error`] by `?`.
pub trait ModuleError: std::error::Error + Send + Sync + 'static {}

impl<E: ModuleError> From<E> for Error {
    fn from(error: E) -> Self {
        Self::Module(Box::new(error))
    }
}

impl Error {
    /// Names the file that the failure is about, unless one is named already.
    #[must_use]
    pub fn at(self, path: impl AsRef<Path>) -> Self {
        match self {
            Self::File { .. } => self,
            source => Self::File { path: path.as_ref().to_owned(), source: Box::new(source) },
        }
    }

    /// What the module whose error type is `E` said, if the failure comes from there.
    pub fn cause<E: ModuleError>(&self) -> Option<&E> {
        match self {
            Self::File { source, .. } => source.cause(),
            Self::Module(error) => error.downcast_ref(),
            _ => None,
        }
    }
}

/// Adds the name of a file to the failures of a result.
pub trait At<T> {
    /// Names the file that a failure is about.
    fn at(self, path: impl AsRef<Path>) -> Result<T>;
}

impl<T, E: Into<Error>> At<T> for std::result::Result<T, E> {
    fn at(self, path: impl AsRef<Path>) -> Result<T> {
        self.map_err(|error| error.into().at(path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, thiserror::Error)]
    #[error("{0} is odd")]
    struct Odd(u32);
    impl ModuleError for Odd {}

    #[derive(Debug, thiserror::Error)]
    #[error("other")]
    struct Other;
    impl ModuleError for Other {}

    /// A module finds its own error again, behind the name of a file too, and no other one.
    #[test]
    fn causes_are_found() {
        let failure = || -> Result<()> { Err(Odd(3))? };
        let named = failure().at("a/b").unwrap_err();
        assert_eq!(named.to_string(), Path::new("a/b").display().to_string() + ": 3 is odd");
        for error in [failure().unwrap_err(), named] {
            assert_eq!(error.cause(), Some(&Odd(3)));
            assert!(error.cause::<Other>().is_none());
        }
        assert!(Error::Usage("words".into()).cause::<Odd>().is_none());
    }
}

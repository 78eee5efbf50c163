//! What can go wrong, as one type that names the file where there is one.

use std::io;
use std::path::{Path, PathBuf};

use crate::gpu::GpuError;
use crate::network::NetworkError;
use crate::sensor::SensorError;
use crate::video::VideoError;

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
    /// A video or picture file is not what it should be.
    #[error(transparent)]
    Video(#[from] VideoError),
    /// A pattern, response or capture is not what it should be.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// A weights file or layer graph is not what it should be.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The GPU is missing, too small or lost.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A request that contradicts itself or the data.
    #[error("{0}")]
    Usage(String),
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

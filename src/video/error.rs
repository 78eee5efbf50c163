//! What can be wrong with a video or picture.

use crate::error::ModuleError;

/// What can be wrong with a video or picture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// The data do not fit the extents.
    #[error("{0}")]
    Shape(String),
    /// The values are not of a range that can be compared.
    #[error(
        "{0}; scale both to irradiance p (1 is where the shortest exposure saturates), or give --normalise, which divides both by the truth's largest value"
    )]
    Range(String),
    /// The file is not what its name promises.
    #[error("{0}")]
    Format(String),
    /// The program that encodes videos is missing or failed.
    #[error("{0}")]
    Encoder(String),
    /// A pixel is NaN, infinite or negative.
    #[error("frame {frame}, row {row}, column {column} is {value}")]
    Pixel {
        /// Frame of the pixel.
        frame: usize,
        /// Row of the pixel.
        row: usize,
        /// Column of the pixel.
        column: usize,
        /// Its value.
        value: f32,
    },
}

impl ModuleError for VideoError {}

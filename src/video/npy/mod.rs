//! NumPy's `.npy`: one cube [t, y, x], as NumPy's format versions 1 to 3 store it.
//!
//! The format is a length-prefixed Python dictionary and then the numbers; nothing here depends on what the
//! header claims before it has been held against the length of the file.

mod counts;
mod file;
mod header;
#[cfg(test)]
mod tests;
mod video;

use std::io::Write;
use std::path::Path;

use half::f16;

pub use counts::{CountsReader, CountsWriter, read_counts, write_counts};
pub use video::{read_video, write_video};

use super::atomic;
use super::format::{CountsFormat, Format};
use crate::{At, Result};
use header::{Kind, check_count, header};

/// Cubes, of videos and of counts.
pub(super) const FORMAT: Format = Format {
    name: "a .npy cube [t, y, x]",
    endings: &["npy"],
    single: false,
    open: video::open,
    begin: Some(video::begin),
    counts: Some(CountsFormat { open: counts::open, begin: counts::begin }),
};

/// Writes half-precision values of any extents.
pub fn write_halves(path: impl AsRef<Path>, extents: &[usize], values: &[f16]) -> Result<()> {
    let path = path.as_ref();
    check_count(values.len(), extents).at(path)?;
    atomic::write(path, |file| {
        file.write_all(&header(Kind::F16, extents))?;
        for value in values {
            file.write_all(&value.to_le_bytes())?;
        }
        Ok(())
    })
}

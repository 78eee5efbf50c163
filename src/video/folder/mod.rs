//! Folders of EXR pictures, one a frame.

mod names;
mod pictures;
mod pool;
mod sequence;
#[cfg(test)]
mod tests;
mod working;
mod writer;

pub use pictures::{Pictures, read};
pub(super) use working::{check_replaceable, remove_partial};

use super::format::Format;

/// Folders, which are told by what is there, or by a name without an ending.
pub(super) const FORMAT: Format = Format {
    name: "a folder of .exr pictures",
    endings: &[],
    single: false,
    open: |path| Ok(Box::new(Pictures::open(path)?)),
    begin: Some(writer::begin),
    counts: None,
};

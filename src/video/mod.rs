//! HDR videos and the files that hold them (design §8).

pub mod atomic;
mod counts;
mod cube;
mod error;
pub mod exr;
mod files;
pub mod folder;
pub mod format;
pub mod npy;
mod outputs;
mod pixels;
pub mod png;
mod preview;
pub mod radiance;
mod tone_range;
mod writer;
mod writing;

pub use crate::math::tone;
pub use counts::Counts;
pub use cube::Video;
pub use error::VideoError;
pub use files::{begin_counts, counts_in, holds_counts, is_cube, is_picture, open, open_counts, read};
pub use folder::Pictures;
pub use format::{Format, ReadCounts, ReadVideo, WriteCounts, ending};
pub use outputs::{Outputs, check_folder_name};
pub(crate) use pixels::{MAX_PIXELS, check_size};
pub use preview::PreviewWriter;
pub use tone_range::ToneRange;
pub use writer::{VideoWriter, write};
pub use writing::{Writing, check_free};

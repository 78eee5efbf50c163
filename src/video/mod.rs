//! HDR videos and the files that hold them (design §8).

pub mod atomic;
mod cube;
pub mod exr;
pub mod folder;
pub mod npy;
pub mod png;
mod preview;
pub mod radiance;
mod writer;

use std::path::Path;

use half::f16;

pub use crate::math::tone;
pub use cube::Video;
pub use folder::Pictures;
pub use preview::PreviewWriter;
pub use writer::{VideoWriter, Writing, check_free};

use crate::{At, Error, Result};

/// What can be wrong with a video or picture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// The data do not fit the extents.
    #[error("{0}")]
    Shape(String),
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

impl crate::error::ModuleError for VideoError {}

/// Most pixels of one picture: 16384×16384.
pub(crate) const MAX_PIXELS: usize = 1 << 28;

/// Reads an HDR video: a folder of EXR pictures, one `.npy` cube, or one `.exr` or `.hdr` picture as a video of one
/// frame.
pub fn read(path: impl AsRef<Path>) -> Result<Video> {
    let path = path.as_ref();
    if std::fs::metadata(path).at(path)?.is_dir() {
        return folder::read(path);
    }
    match extension(path).as_str() {
        "npy" => npy::read_video(path),
        "exr" => exr::read(path),
        "hdr" | "pic" => radiance::read(path),
        _ => Err(Error::Usage(
            "not a video that can be read; give a folder of .exr pictures, a .npy cube [t, y, x], or one .exr or \
             .hdr picture"
                .into(),
        ))
        .at(path),
    }
}

/// Writes a whole video as `path`'s name says (see [`VideoWriter::begin`]).
pub fn write(path: impl AsRef<Path>, video: &Video, how: Writing) -> Result<()> {
    let mut writer = VideoWriter::begin(path, [video.frames, video.height, video.width], how)?;
    for t in 0..video.frames {
        writer.push(video.frame(t))?;
    }
    writer.finish()
}

/// The extension of a name, in small letters; empty if there is none.
fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// An empty vector with room for `len` values, or an error where there is not that much memory.
fn reserve<T>(len: usize) -> Result<Vec<T>> {
    let mut values = Vec::new();
    let fail = |_| VideoError::Shape(format!("{len} values do not fit into memory"));
    values.try_reserve_exact(len).map_err(fail)?;
    Ok(values)
}

/// Refuses a picture of no or too many pixels.
pub(crate) fn check_size(width: usize, height: usize) -> Result<(), VideoError> {
    match width.checked_mul(height) {
        Some(1..=MAX_PIXELS) => Ok(()),
        _ => Err(VideoError::Shape(format!(
            "a picture of {width}×{height} pixels; 1 to {MAX_PIXELS} can be read"
        ))),
    }
}

/// Refuses a frame that a writer of extents [t, y, x] cannot take as number `t`.
fn check_frame(frame: &[f32], t: usize, [frames, height, width]: [usize; 3]) -> Result<(), VideoError> {
    if t >= frames {
        return Err(VideoError::Shape(format!("more than the {frames} frames that were promised")));
    }
    if frame.len() != height * width {
        return Err(VideoError::Shape(format!("a frame of {} pixels for {height}×{width}", frame.len())));
    }
    check_pixels(frame, t, width)
}

/// The first pixel of frame `t` that is not a finite, non-negative number, as an error.
fn check_pixels(frame: &[f32], t: usize, width: usize) -> Result<(), VideoError> {
    match frame.iter().position(|v| !v.is_finite() || *v < 0.0) {
        Some(at) => {
            Err(VideoError::Pixel { frame: t, row: at / width, column: at % width, value: frame[at] })
        }
        None => Ok(()),
    }
}

fn check_complete(pushed: usize, frames: usize) -> Result<(), VideoError> {
    if pushed == frames {
        Ok(())
    } else {
        Err(VideoError::Shape(format!("only {pushed} of {frames} frames were written")))
    }
}

/// The nearest half-precision number; what is too large becomes the largest one instead of infinite.
fn half_of(value: f32) -> f16 {
    f16::from_f32(value.min(f16::MAX.to_f32()))
}

/// Luminance of linear Rec. 709 colours.
fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

//! Rules that pixels of every file keep, and how they are rounded.

use half::f16;

use super::VideoError;
use crate::Result;
use crate::frame::Plane;

/// Most pixels of one picture: 16384×16384.
pub(crate) const MAX_PIXELS: usize = 1 << 28;

/// An empty vector with room for `len` values, or an error where there is not that much memory.
pub(super) fn reserve<T>(len: usize) -> Result<Vec<T>> {
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
pub(super) fn check_frame(frame: Plane<'_>, t: usize, extents: [usize; 3]) -> Result<(), VideoError> {
    let [_, height, width] = extents;
    if frame.extent() != [height, width].into() {
        return Err(VideoError::Shape(format!("a frame of {} pixels for {height}×{width}", frame.extent())));
    }
    check_values(frame.values(), t, extents)
}

/// As [`check_frame`], of the values [y, x] of a frame.
pub(super) fn check_values(
    frame: &[f32],
    t: usize,
    [frames, height, width]: [usize; 3],
) -> Result<(), VideoError> {
    if t >= frames {
        return Err(VideoError::Shape(format!("more than the {frames} frames that were promised")));
    }
    if frame.len() != height * width {
        return Err(VideoError::Shape(format!("a frame of {} pixels for {height}×{width}", frame.len())));
    }
    check_pixels(frame, t, width)
}

/// The first pixel of frame `t` that is not a finite, non-negative number, as an error.
pub(super) fn check_pixels(frame: &[f32], t: usize, width: usize) -> Result<(), VideoError> {
    match frame.iter().position(|v| !v.is_finite() || *v < 0.0) {
        Some(at) => {
            Err(VideoError::Pixel { frame: t, row: at / width, column: at % width, value: frame[at] })
        }
        None => Ok(()),
    }
}

pub(super) fn check_complete(pushed: usize, frames: usize) -> Result<(), VideoError> {
    if pushed == frames {
        Ok(())
    } else {
        Err(VideoError::Shape(format!("only {pushed} of {frames} frames were written")))
    }
}

/// The nearest half-precision number; what is too large becomes the largest one instead of infinite.
pub(super) fn half_of(value: f32) -> f16 {
    f16::from_f32(value.min(f16::MAX.to_f32()))
}

/// Luminance of linear Rec. 709 colours.
pub(super) fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

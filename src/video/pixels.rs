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

/// What each of three primaries adds to the luminance of a pixel, by their chromaticities (x, y) and that of white, which
/// all three together show with luminance 1; nothing if such primaries cannot show it.
pub(super) fn luminance_weights(primaries: [[f64; 2]; 3], white: [f64; 2]) -> Option<[f32; 3]> {
    let xyz = |[x, y]: [f64; 2]| [x, y, 1.0 - x - y];
    let [r, g, b] = primaries.map(xyz);
    let white = xyz(white).map(|value| value / white[1]);
    let det = |[a, b, c]: [[f64; 3]; 3]| {
        a[0] * (b[1] * c[2] - b[2] * c[1]) - b[0] * (a[1] * c[2] - a[2] * c[1])
            + c[0] * (a[1] * b[2] - a[2] * b[1])
    };
    // Cramer's rule for how much of each primary is in white.
    let whole = det([r, g, b]);
    let shares = [det([white, g, b]), det([r, white, b]), det([r, g, white])];
    let weights = [0, 1, 2].map(|i| (shares[i] / whole * [r, g, b][i][1]) as f32);
    weights.iter().all(|weight| weight.is_finite()).then_some(weights)
}

/// Luminance of linear Rec. 709 colours.
pub(super) fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

#[cfg(test)]
mod tests {
    use super::luminance_weights;

    /// Against what the standards state.
    #[test]
    fn primaries_give_their_luminance() {
        let near = |primaries, white, expected: [f32; 3]| {
            let weights = luminance_weights(primaries, white).unwrap();
            for (weight, expected) in weights.iter().zip(expected) {
                assert!((weight - expected).abs() < 1e-4, "{weights:?}");
            }
        };
        let d65 = [0.3127, 0.3290];
        near([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]], d65, [0.2126, 0.7152, 0.0722]);
        near([[0.708, 0.292], [0.170, 0.797], [0.131, 0.046]], d65, [0.2627, 0.6780, 0.0593]);
        let aces = [[0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.077]];
        near(aces, [0.32168, 0.33767], [0.343_966, 0.728_166, -0.072_133]);
        near([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], [1.0 / 3.0, 1.0 / 3.0], [0.0, 1.0, 0.0]);
        assert_eq!(luminance_weights([[0.3, 0.3]; 3], d65), None);
        assert_eq!(luminance_weights([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]], [0.3, 0.0]), None);
    }
}

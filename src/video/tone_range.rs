//! Which irradiance a picture shows black and which white: one exposure for all panes of it.

use std::ops::RangeInclusive;

use crate::math::tone;

/// Part of all pixels that may be darker than black, and as many brighter than white.
const CUT: f64 = 0.005;

/// Least distance of black and white in l, so that an even picture's noise stays noise.
const LEAST: f64 = 0.2;

/// The values of the tone curve l that a picture shows black and white. What lies between them is shown proportionally.
///
/// Whatever is shown beside each other shares its levels. Without them, most of a recording of little contrast is light
/// grey, since l lifts p = 0.01 to 0.46 already.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToneRange {
    black: f64,
    white: f64,
}

impl Default for ToneRange {
    fn default() -> Self {
        Self::WHOLE
    }
}

impl ToneRange {
    /// From p = 0 to p = 1, as in figures of quality.
    pub const WHOLE: Self = Self { black: 0.0, white: 1.0 };

    /// The levels of frames of irradiance: all but half a percent of the pixels at either end lie between them. What is no
    /// number counts as little as what no pixel measures; without pixels, [`ToneRange::WHOLE`].
    pub fn of<'a>(frames: impl IntoIterator<Item = &'a [f32]>) -> Self {
        let measured = |p: &f32| p.is_finite() && *p >= 0.0;
        let mut values: Vec<f32> = frames.into_iter().flatten().copied().filter(measured).collect();
        let Some(last) = values.len().checked_sub(1) else { return Self::WHOLE };
        let cut = (CUT * last as f64) as usize;
        let mut at = |rank: usize| {
            let (_, value, _) = values.select_nth_unstable_by(rank, f32::total_cmp);
            tone(f64::from(*value).min(1.0))
        };
        let (black, white) = (at(cut), at(last - cut));
        let missing = (LEAST - (white - black)).max(0.0);
        // Widened about the middle, as far as l goes.
        let black = (black - 0.5 * missing).clamp(0.0, 1.0 - LEAST);
        Self { black, white: white.max(black + LEAST) }
    }

    /// Black and white in l.
    pub fn range(self) -> RangeInclusive<f64> {
        self.black..=self.white
    }

    /// Brightness in [0, 1] of a value of l.
    pub fn brightness(self, l: f64) -> f64 {
        ((l - self.black) / (self.white - self.black)).clamp(0.0, 1.0)
    }

    /// The grey value of irradiance `p`. What is no number is black.
    pub fn byte(self, p: f32) -> u8 {
        (255.0 * self.brightness(tone(f64::from(p).clamp(0.0, 1.0)))).round() as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// l⁻¹.
    fn irradiance(l: f64) -> f32 {
        ((l * 5001_f64.ln()).exp_m1() / 5000.0) as f32
    }

    /// 1001 pixels at even steps of l from 0.4 to 0.9: five of them at either end are beyond the levels.
    #[test]
    fn all_but_half_a_percent_lies_between_black_and_white() {
        let frame: Vec<f32> =
            (0..1001).rev().map(|i| irradiance(0.4 + 0.5 * f64::from(i) / 1000.0)).collect();
        let (first, second) = frame.split_at(300);
        let levels = ToneRange::of([first, second]);
        assert!((levels.range().start() - 0.4025).abs() < 1e-6, "{levels:?}");
        assert!((levels.range().end() - 0.8975).abs() < 1e-6, "{levels:?}");
        // (0.5015 − 0.4025)/(0.8975 − 0.4025) = 1/5.
        assert_eq!(
            [0.3, 0.4025, 0.5015, 0.8975, 1.0].map(|l| levels.byte(irradiance(l))),
            [0, 0, 51, 255, 255]
        );
        assert_eq!(levels.byte(f32::NAN), 0);
    }

    /// One pixel in a hundred thousand that is wrong, or far brighter than all others, moves nothing.
    #[test]
    fn single_pixels_move_no_level() {
        let mut frame: Vec<f32> =
            (0..10_000).map(|i| irradiance(0.4 + 0.5 * f64::from(i) / 10_000.0)).collect();
        let levels = ToneRange::of([&frame[..]]);
        frame.extend([f32::NAN, f32::INFINITY, -1.0]);
        assert_eq!(ToneRange::of([&frame[..]]), levels);
        frame[0] = 1e9;
        let moved = ToneRange::of([&frame[..]]);
        assert!((levels.range().end() - moved.range().end()).abs() < 1e-3, "{levels:?} {moved:?}");
    }

    /// An even picture is an even grey, not noise from black to white, at either end of l too.
    #[test]
    fn an_even_picture_stays_even() {
        for (l, grey) in [(0.5, 128), (0.0, 0), (1.0, 255), (0.95, 191)] {
            let frame = [irradiance(l); 64];
            let levels = ToneRange::of([&frame[..]]);
            assert!((levels.range().end() - levels.range().start() - LEAST).abs() < 1e-9, "{levels:?}");
            assert!(levels.byte(frame[0]).abs_diff(grey) <= 1, "{l}: {}", levels.byte(frame[0]));
        }
        assert_eq!(ToneRange::of([]), ToneRange::WHOLE);
        assert_eq!(ToneRange::of([&[f32::NAN][..]]), ToneRange::WHOLE);
    }
}

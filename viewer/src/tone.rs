//! HDR on an SDR screen: from irradiance to bytes.

use serde::{Deserialize, Serialize};

use pix2hdr::video::tone;

/// How irradiance becomes brightness.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Curve {
    /// l(p) = ln(1 + 5000 p)/ln 5001, what nets are trained and measured by.
    #[default]
    Mu,
    /// Reinhard et al. 2002, eq. 4, white where p = 1.
    Reinhard,
    /// Narkowicz' fit (2015) of the ACES filmic curve.
    Filmic,
    /// Proportional, with the transfer function of sRGB.
    Linear,
    /// Twelve stops below p = 1 as colours, from dark blue to yellow.
    FalseColour,
}

impl Curve {
    /// All curves.
    pub const ALL: [Self; 5] = [Self::Mu, Self::Reinhard, Self::Filmic, Self::Linear, Self::FalseColour];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mu => "µ-law",
            Self::Reinhard => "Reinhard",
            Self::Filmic => "filmic (ACES-like)",
            Self::Linear => "linear",
            Self::FalseColour => "false colour",
        }
    }

    /// What it does, for a tooltip.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Mu => "ln(1 + 5000 p)/ln 5001: what nets are trained and measured by; lifts shadows most",
            Self::Reinhard => "x(1 + x/64)/(1 + x) with x = 8 p; white where p = 1",
            Self::Filmic => "Narkowicz' fit of the ACES filmic curve, with x = 2 p",
            Self::Linear => "proportional to light, up to where the screen ends",
            Self::FalseColour => "each stop a colour: dark blue is 12 stops below p = 1, yellow is p = 1",
        }
    }

    /// Brightness in [0, 1], as the screen wants it, of `p` after exposure.
    fn brightness(self, p: f64) -> f64 {
        match self {
            Self::Mu => tone(p.min(1.0)),
            Self::Reinhard => {
                let x = 8.0 * p;
                encode(x * (1.0 + x / 64.0) / (1.0 + x))
            }
            Self::Filmic => {
                let x = 2.0 * p;
                encode(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14))
            }
            Self::Linear => encode(p),
            Self::FalseColour => (1.0 + p.max(f64::MIN_POSITIVE).log2() / STOPS).clamp(0.0, 1.0),
        }
    }
}

/// Stops of false colour.
pub const STOPS: f64 = 12.0;

/// The transfer function of sRGB (IEC 61966-2-1) of linear light, clipped.
fn encode(v: f64) -> f64 {
    let v = v.clamp(0.0, 1.0);
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// How panes show irradiance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Display {
    /// Exposure in stops.
    pub exposure: f32,
    /// The curve.
    pub curve: Curve,
    /// Whether pixels at or above the end of the scale are marked.
    pub clipping: bool,
    /// Whether steps between grey values are broken up.
    pub dither: bool,
    /// Difference of l at which the difference picture is at the end of its scale.
    pub difference: f32,
}

impl Default for Display {
    fn default() -> Self {
        Self { exposure: 0.0, curve: Curve::Mu, clipping: false, dither: true, difference: 0.1 }
    }
}

/// Bits of the mantissa that tell entries apart: steps of 0.2%.
pub(crate) const MANTISSA: u32 = 9;
/// Exponents of the table: from 2⁻³⁰, black in every curve, to 2¹⁰.
const EXPONENTS: [i32; 2] = [-30, 10];

/// A display as a table over irradiance, so that a pixel costs no logarithm.
#[derive(Clone, Debug)]
pub struct ToneTable {
    display: Display,
    /// Brightness in [0, 255].
    brightness: Vec<f32>,
}

impl ToneTable {
    /// The table of a display.
    pub fn new(display: Display) -> Self {
        let gain = f64::from(display.exposure.clamp(-40.0, 40.0)).exp2();
        let steps = 1 << MANTISSA;
        let entry = |i: i32| {
            // The middle of the interval of numbers that share the entry.
            let mantissa = 1.0 + (f64::from(i % steps) + 0.5) / f64::from(steps);
            let p = mantissa * f64::from(EXPONENTS[0] + i / steps).exp2();
            (255.0 * display.curve.brightness(p * gain)) as f32
        };
        let brightness = (0..(EXPONENTS[1] - EXPONENTS[0]) * steps).map(entry).collect();
        Self { display, brightness }
    }

    /// Brightness in [0, 255], entry by entry: entries count steps of [`MANTISSA`] bits from [`ToneTable::FIRST`] on.
    pub(crate) fn entries(&self) -> &[f32] {
        &self.brightness
    }

    /// Upper bits of the f32 that the first entry stands for.
    pub(crate) const FIRST: u32 = ((EXPONENTS[0] + 127) as u32) << MANTISSA;

    /// The display.
    pub fn display(&self) -> Display {
        self.display
    }

    /// Brightness of irradiance `p` in [0, 255].
    pub fn brightness(&self, p: f32) -> f32 {
        // Negative numbers and NaN are nothing that a pixel holds; they are black.
        if p.is_nan() || p <= 0.0 {
            return 0.0;
        }
        let entry = (p.to_bits() >> (23 - MANTISSA)).saturating_sub(Self::FIRST) as usize;
        self.brightness[entry.min(self.brightness.len() - 1)]
    }

    /// Colour of irradiance `p` at place (`x`, `y`) of the screen.
    pub fn colour(&self, p: f32, x: usize, y: usize) -> [u8; 3] {
        let brightness = self.brightness(p);
        let over = p * self.display.exposure.exp2() >= 1.0;
        if self.display.clipping && over {
            return CLIPPED;
        }
        if self.display.curve == Curve::FalseColour {
            return ramp(&COLOURS, brightness / 255.0);
        }
        [self.byte(brightness, x, y); 3]
    }

    /// A byte of brightness in [0, 255], rounded one way or the other as the place says.
    pub fn byte(&self, brightness: f32, x: usize, y: usize) -> u8 {
        let threshold = if self.display.dither { (f32::from(BAYER[y % 4][x % 4]) + 0.5) / 16.0 } else { 0.5 };
        (brightness + threshold).clamp(0.0, 255.0) as u8
    }

    /// Colour of a pixel value y in [0, 1].
    pub fn pixel_value(&self, y: f32, [row, column]: [usize; 2]) -> [u8; 3] {
        if self.display.clipping && y >= pix2hdr::network::SATURATED as f32 {
            return CLIPPED;
        }
        if self.display.curve == Curve::FalseColour {
            return ramp(&COLOURS, y);
        }
        [self.byte(255.0 * y.clamp(0.0, 1.0), column, row); 3]
    }

    /// Colour of the difference of two irradiances in l: blue where `a` is darker than `b`, orange where it is brighter.
    pub fn difference(&self, a: f32, b: f32) -> [u8; 3] {
        let l = |p: f32| tone(f64::from(p.clamp(0.0, 1.0))) as f32;
        ramp(&DIVERGING, 0.5 + 0.5 * (l(a) - l(b)) / self.display.difference.max(1e-6))
    }
}

/// Colour of clipped pixels: magenta, which no other scale has.
pub const CLIPPED: [u8; 3] = [255, 0, 200];

/// Thresholds of ordered dithering.
pub(crate) const BAYER: [[u8; 4]; 4] = [[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]];

/// Colours of even steps of lightness that the colour-blind tell apart as well: points of the map cividis
/// (Nuñez, Anderton, Renslow 2018).
pub(crate) const COLOURS: [[u8; 3]; 9] = [
    [0, 34, 78],
    [18, 53, 112],
    [59, 73, 108],
    [87, 93, 109],
    [112, 113, 115],
    [138, 134, 120],
    [165, 156, 116],
    [195, 179, 105],
    [254, 232, 56],
];

/// From blue over grey to orange, told apart with any colour vision.
pub(crate) const DIVERGING: [[u8; 3]; 5] =
    [[0, 90, 181], [98, 143, 190], [128, 128, 128], [214, 153, 84], [255, 140, 0]];

/// The colour at `at`, in [0, 1], of evenly spaced `points`.
fn ramp(points: &[[u8; 3]], at: f32) -> [u8; 3] {
    let at = if at.is_nan() { 0.0 } else { at.clamp(0.0, 1.0) } * (points.len() - 1) as f32;
    let i = (at as usize).min(points.len() - 2);
    let f = at - i as f32;
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(points[i][c]), f32::from(points[i + 1][c]));
        (a + f * (b - a)).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(curve: Curve, exposure: f32) -> ToneTable {
        ToneTable::new(Display { curve, exposure, dither: false, ..Display::default() })
    }

    /// The table against the curves themselves, over 40 stops.
    #[test]
    fn the_table_is_the_curve() {
        for curve in Curve::ALL {
            for exposure in [-3.0, 0.0, 5.0] {
                let table = table(curve, exposure);
                let mut last = 0.0;
                for i in 0..4000 {
                    let p = ((f64::from(i) / 100.0) - 32.0).exp2();
                    let expected = 255.0 * curve.brightness(p * f64::from(exposure).exp2());
                    let found = table.brightness(p as f32);
                    assert!(
                        (f64::from(found) - expected).abs() < 0.25,
                        "{curve:?} {exposure} {p}: {found} {expected}"
                    );
                    assert!(found >= last - 1e-3, "{curve:?} falls at {p}");
                    last = found;
                }
            }
        }
    }

    #[test]
    fn curves_begin_black_and_end_white() {
        for curve in Curve::ALL {
            let table = table(curve, 0.0);
            assert_eq!(table.brightness(0.0), 0.0);
            // The filmic curve has a shoulder, and keeps something for what is brighter.
            let white = if curve == Curve::Filmic { 220.0 } else { 253.5 };
            assert!(table.brightness(1.0) > white, "{curve:?} {}", table.brightness(1.0));
            assert!(table.brightness(1e9) > 254.5);
            for bad in [f32::NAN, -1.0, f32::NEG_INFINITY] {
                assert_eq!(table.brightness(bad), 0.0);
                assert_eq!(table.colour(bad, 0, 0), table.colour(0.0, 0, 0));
            }
            assert!(table.brightness(f32::INFINITY) > 254.5);
            assert!(table.brightness(f32::MIN_POSITIVE / 8.0) < 0.5);
        }
        // The µ-law is what pictures of `synth` are written with.
        for p in [0.0002, 0.01, 0.3, 1.0] {
            let byte = table(Curve::Mu, 0.0).colour(p, 0, 0)[0];
            assert!(byte.abs_diff(pix2hdr::video::png::tone_byte(p)) <= 1);
        }
    }

    #[test]
    fn a_stop_of_exposure_doubles() {
        let (plain, brighter) = (table(Curve::Reinhard, 0.0), table(Curve::Reinhard, 1.0));
        assert_eq!(plain.brightness(0.2), brighter.brightness(0.1));
    }

    #[test]
    fn clipping_is_marked_after_exposure() {
        let display = Display { clipping: true, exposure: 2.0, dither: false, ..Display::default() };
        let table = ToneTable::new(display);
        assert_eq!(table.colour(0.26, 0, 0), CLIPPED);
        assert_ne!(table.colour(0.24, 0, 0), CLIPPED);
        assert_eq!(table.pixel_value(0.99, [0, 0]), CLIPPED);
        assert_ne!(table.pixel_value(0.9, [0, 0]), CLIPPED);
    }

    /// Dithering keeps the mean, and moves no pixel by more than one.
    #[test]
    fn dithering_keeps_the_mean() {
        let table = ToneTable::new(Display::default());
        for brightness in [0.0, 10.25, 100.5, 254.9, 255.0] {
            let bytes: Vec<u8> = (0..16).map(|i| table.byte(brightness, i % 4, i / 4)).collect();
            let mean = bytes.iter().map(|b| f32::from(*b)).sum::<f32>() / 16.0;
            assert!((mean - brightness).abs() <= 1.0 / 16.0, "{brightness}: {mean}");
            assert!(bytes.iter().all(|b| (f32::from(*b) - brightness).abs() < 1.0));
        }
    }

    #[test]
    fn differences_are_signed() {
        let table = table(Curve::Mu, 0.0);
        assert_eq!(table.difference(0.3, 0.3), DIVERGING[2]);
        assert_eq!(table.difference(1.0, 0.0), DIVERGING[4]);
        assert_eq!(table.difference(0.0, 1.0), DIVERGING[0]);
    }

    /// False colours get lighter with every step: who sees no colours sees the order.
    #[test]
    fn false_colours_are_in_order_without_colour() {
        let light = |i: u8| {
            let [r, g, b] = ramp(&COLOURS, f32::from(i) / 64.0).map(f32::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        assert!((1..=64).all(|i| light(i) > light(i - 1)));
    }
}

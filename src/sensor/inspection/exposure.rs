//! How static pixels scale with their exposure.

use crate::sensor::{Form, Recording};

/// Pixel values between which the exposure ratio is judged: above noise and black-level error, below the knee of
/// saturation.
const JUDGED: std::ops::Range<f32> = 0.04..0.9;
/// Largest change over time, relative to the mean, up to which a pixel counts as static.
const STATIC: f32 = 0.1;
/// Least number of pixel pairs for a verdict.
const ENOUGH: usize = 64;
/// How far a black level may be off, as a part of the range, and how many times more than it is uncertain.
const BLACK: f64 = 0.01;
const CERTAIN: f64 = 4.0;
/// How far dark and bright pairs may be apart in what they ask for, as a part of it, and how far it may be from the
/// described one, as a part of the range.
const AGREED: f64 = 1.0 / 6.0;
const PLAUSIBLE: f64 = 0.15;

/// Least, largest and mean pixel value of each pixel over some frames.
#[derive(Clone, Debug)]
pub struct StaticPixels {
    range: Vec<(f32, f32, f32)>,
    values: Vec<f32>,
    looks: usize,
}

/// How the values of static pixels scale with their exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RatioCheck {
    /// Median of ln(x_long/x_short)/ln(e_long/e_short) over pairs of neighbouring pixels: 1 if the response is
    /// right.
    pub exponent: f64,
    /// Pairs that were judged.
    pub pairs: usize,
    /// The count at which pairs of all levels agree, with its standard error, where one does and the response is linear.
    pub black_level: Option<[f64; 2]>,
}

impl RatioCheck {
    /// Whether the exponent is off by more than scene and noise explain.
    pub fn is_off(&self) -> bool {
        (self.exponent - 1.0).abs() > 0.15
    }
}

impl StaticPixels {
    pub fn new(pixels: usize) -> Self {
        let range = vec![(f32::INFINITY, f32::NEG_INFINITY, 0.0f32); pixels];
        Self { range, values: vec![0.0; pixels], looks: 0 }
    }

    /// Looks at a frame, whose pixel values `fill` gives.
    pub fn add(&mut self, fill: impl FnOnce(&mut [f32])) {
        fill(&mut self.values);
        for (range, &y) in self.range.iter_mut().zip(&self.values) {
            *range = (range.0.min(y), range.1.max(y), range.2 + y);
        }
        self.looks += 1;
    }

    /// Compares neighbouring static pixels of different exposure; `None` where there are too few of them.
    pub fn ratio(&self, recording: &Recording) -> Option<RatioCheck> {
        let Recording { pattern, response, info, height, width, .. } = recording;
        let (height, width) = (*height, *width);
        // Mean pixel value and exposure of a static, well exposed pixel.
        let judged = |y: usize, x: usize| {
            let (least, most, sum) = self.range[y * width + x];
            let mean = sum / self.looks as f32;
            let exposure = pattern.schedule(y, x).exposure()?;
            let steady = most - least < STATIC * mean;
            let well_exposed = JUDGED.contains(&least) && JUDGED.contains(&most);
            (steady && well_exposed).then_some((f64::from(mean), exposure as f64))
        };
        // Exponent, black level and level of each pair.
        let mut exponents = Vec::new();
        let mut blacks = Vec::new();
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let Some((value, exposure)) = judged(y, x) else { continue };
            for (ny, nx) in [(y, x + 1), (y + 1, x)] {
                if ny >= height || nx >= width {
                    continue;
                }
                match judged(ny, nx) {
                    Some((other, e)) if e != exposure => {
                        let [one, two] = [value, other].map(|value| response.exposure(value));
                        exponents.push((two / one).ln() / (e / exposure).ln());
                        blacks.push(((e * value - exposure * other) / (e - exposure), value + other));
                    }
                    _ => {}
                }
            }
        }
        if exponents.len() < ENOUGH {
            return None;
        }
        let exponent = median(&mut exponents);
        let linear = matches!(response.form(), Form::Linear);
        let range = info.white_level - info.black_level;
        let black = linear.then(|| agreed(blacks)).flatten();
        let black_level = black.map(|[black, error]| [info.black_level + black * range, error * range]);
        Some(RatioCheck { exponent, pairs: exponents.len(), black_level })
    }
}

impl RatioCheck {
    /// The black level that static pixels ask for in place of the described one, with its standard error, where it clearly
    /// is another one.
    pub fn other_black_level(&self, recording: &Recording) -> Option<[f64; 2]> {
        let info = &recording.info;
        let [black, error] = self.black_level?;
        let off = (black - info.black_level).abs();
        (off > BLACK * (info.white_level - info.black_level) && off > CERTAIN * error)
            .then_some([black, error])
    }
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The black level, in pixel values, that darker and brighter pairs agree on, with its standard error.
fn agreed(mut pairs: Vec<(f64, f64)>) -> Option<[f64; 2]> {
    pairs.sort_unstable_by(|a, b| a.1.total_cmp(&b.1));
    let third = pairs.len() / 3;
    let median_of = |pairs: &[(f64, f64)]| {
        let mut blacks: Vec<f64> = pairs.iter().map(|pair| pair.0).collect();
        let middle = median(&mut blacks);
        let mut off: Vec<f64> = blacks.iter().map(|black| (black - middle).abs()).collect();
        // From the median deviation to the standard error of a median of values that scatter normally.
        let error = 1.4826 * 1.2533 * median(&mut off) / (blacks.len() as f64).sqrt();
        [middle, error]
    };
    let [dark, bright] = [&pairs[..third], &pairs[pairs.len() - third..]].map(median_of);
    let whole = median_of(&pairs);
    let apart = (dark[0] - bright[0]).abs();
    // A response that is not linear asks for another black at each level.
    (apart < AGREED * whole[0].abs() && whole[0].abs() < PLAUSIBLE)
        .then_some([whole[0], whole[1].max(apart / 4.0)])
}

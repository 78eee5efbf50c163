//! PSNR, SSIM and temporal contrast.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use crate::frame::Plane;
use crate::math::tone;
use crate::video::{Video, VideoError};

/// Taps of the window of SSIM (paper, above eq. 19).
const WINDOW: usize = 11;
/// Standard deviation of the window in pixels, as SSIM's authors chose it; the paper gives none.
const SIGMA: f64 = 1.5;
/// C1 and C2 of eq. 18.
const STABILISERS: [f64; 2] = [1e-4, 9e-4];

/// What a video was found to be worth. Higher is better; an exact copy has an infinite PSNR, which JSON writes as null.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// PSNR of irradiance p, peak 1, in dB.
    pub psnr: f64,
    /// PSNR of l(p), peak 1, in dB ("PSNR-µ").
    pub psnr_mu: f64,
    /// Mean SSIM of l(p); none where frames are smaller than the window of 11 pixels.
    pub ssim_mu: Option<f64>,
}

impl fmt::Display for Measures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PSNR-µ {:.2} dB, PSNR {:.2} dB", self.psnr_mu, self.psnr)?;
        self.ssim_mu.map_or(Ok(()), |ssim| write!(f, ", SSIM-µ {ssim:.4}"))
    }
}

/// A mean squared error that grows with every frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SquaredError {
    /// Sum of squared differences.
    pub sum: f64,
    /// Number of differences.
    pub count: u64,
}

impl SquaredError {
    /// Adds the difference of two equally long series.
    pub fn add(&mut self, truth: impl IntoIterator<Item = f64>, result: impl IntoIterator<Item = f64>) {
        for (a, b) in truth.into_iter().zip(result) {
            self.sum += (a - b) * (a - b);
            self.count += 1;
        }
    }

    /// Adds another sum.
    pub fn merge(&mut self, other: Self) {
        self.sum += other.sum;
        self.count += other.count;
    }

    /// The mean; NaN before anything was added.
    pub fn mean(&self) -> f64 {
        self.sum / self.count as f64
    }

    /// PSNR in dB for a peak of 1.
    pub fn psnr(&self) -> f64 {
        -10.0 * self.mean().log10()
    }
}

/// A comparison that grows frame by frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Comparison {
    linear: SquaredError,
    toned: SquaredError,
    ssim_sum: f64,
    ssim_windows: u64,
}

impl Comparison {
    /// Adds one frame of irradiance. Values are clipped to [0, 1], the range of p.
    pub fn add(&mut self, truth: Plane<'_>, result: Plane<'_>) {
        let width = truth.extent().width;
        let clip = |frame: Plane<'_>| -> Vec<f64> {
            frame.values().iter().map(|&p| f64::from(p).clamp(0.0, 1.0)).collect()
        };
        let (mut truth, mut result) = (clip(truth), clip(result));
        self.linear.add(truth.iter().copied(), result.iter().copied());
        for p in truth.iter_mut().chain(&mut result) {
            *p = tone(*p);
        }
        self.toned.add(truth.iter().copied(), result.iter().copied());
        let (sum, windows) = ssim_sum(&truth, &result, width);
        self.ssim_sum += sum;
        self.ssim_windows += windows;
    }

    /// Adds the frames of another comparison.
    pub fn merge(&mut self, other: Self) {
        self.linear.merge(other.linear);
        self.toned.merge(other.toned);
        self.ssim_sum += other.ssim_sum;
        self.ssim_windows += other.ssim_windows;
    }

    /// The measures over all frames so far: errors are averaged before the logarithm is taken.
    pub fn measures(&self) -> Measures {
        Measures {
            psnr: self.linear.psnr(),
            psnr_mu: self.toned.psnr(),
            ssim_mu: (self.ssim_windows > 0).then(|| self.ssim_sum / self.ssim_windows as f64),
        }
    }
}

/// Measures of a whole video. Does not depend on the number of threads.
pub fn compare(truth: &Video, result: &Video) -> Result<Measures, VideoError> {
    let extents = |v: &Video| [v.frames, v.height, v.width];
    if extents(truth) != extents(result) {
        let ([t, y, x], [u, b, a]) = (extents(truth), extents(result));
        return Err(VideoError::Shape(format!("the truth has {t}×{y}×{x} pixels, the result {u}×{b}×{a}")));
    }
    if truth.data.is_empty() {
        return Err(VideoError::Shape("there are no pixels to compare".into()));
    }
    let frame = |t: usize| {
        let mut comparison = Comparison::default();
        comparison.add(truth.plane(t), result.plane(t));
        comparison
    };
    let frames: Vec<Comparison> = (0..truth.frames).into_par_iter().map(frame).collect();
    let mut all = Comparison::default();
    for frame in frames {
        all.merge(frame);
    }
    Ok(all.measures())
}

/// Mean SSIM of two pictures [y, x] with values in [0, 1] (eq. 18, 19), over the windows that lie wholly inside; none
/// if there are none.
pub fn ssim(a: &[f64], b: &[f64], width: usize) -> Option<f64> {
    let (sum, windows) = ssim_sum(a, b, width);
    (windows > 0).then(|| sum / windows as f64)
}

/// Sum of SSIM over the windows that lie wholly inside, and their number.
fn ssim_sum(a: &[f64], b: &[f64], width: usize) -> (f64, u64) {
    let height = a.len().min(b.len()) / width.max(1);
    if width < WINDOW || height < WINDOW {
        return (0.0, 0);
    }
    let taps = window();
    let columns = width - WINDOW + 1;
    // Weighted sums along each row: of a, b, a², b² and ab.
    let mut across = vec![[0.0; 5]; height * columns];
    for (row, sums) in across.chunks_mut(columns).enumerate() {
        let (a, b) = (&a[row * width..][..width], &b[row * width..][..width]);
        for (x, sum) in sums.iter_mut().enumerate() {
            for ((w, a), b) in taps.iter().zip(&a[x..]).zip(&b[x..]) {
                for (sum, term) in sum.iter_mut().zip([*a, *b, a * a, b * b, a * b]) {
                    *sum += w * term;
                }
            }
        }
    }
    let rows = height - WINDOW + 1;
    let mut total = 0.0;
    for (y, x) in (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x))) {
        let mut sums = [0.0; 5];
        for (k, w) in taps.iter().enumerate() {
            let row = &across[(y + k) * columns + x];
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += w * value;
            }
        }
        let [mean_a, mean_b, square_a, square_b, product] = sums;
        let [c1, c2] = STABILISERS;
        let variances = square_a - mean_a * mean_a + square_b - mean_b * mean_b;
        let covariance = product - mean_a * mean_b;
        total += (2.0 * mean_a * mean_b + c1) * (2.0 * covariance + c2)
            / ((mean_a * mean_a + mean_b * mean_b + c1) * (variances + c2));
    }
    (total, (rows * columns) as u64)
}

/// The Gaussian window, with sum 1.
fn window() -> [f64; WINDOW] {
    let centre = (WINDOW / 2) as f64;
    let weight = |i: usize| (-(i as f64 - centre).powi(2) / (2.0 * SIGMA * SIGMA)).exp();
    let sum: f64 = (0..WINDOW).map(weight).sum();
    std::array::from_fn(|i| weight(i) / sum)
}

/// Temporal contrast of one pixel's irradiance over time (eq. 26): (peak − trough)/(peak + trough), 0 where all is black.
pub fn temporal_contrast(series: impl IntoIterator<Item = f32>) -> f64 {
    let (mut peak, mut trough) = (f64::NEG_INFINITY, f64::INFINITY);
    for value in series {
        peak = peak.max(f64::from(value));
        trough = trough.min(f64::from(value));
    }
    if peak + trough > 0.0 { (peak - trough) / (peak + trough) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(frames: usize, height: usize, width: usize, seed: u32) -> Video {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        Video::new(frames, height, width, (0..frames * height * width).map(|_| next()).collect()).unwrap()
    }

    #[test]
    fn psnr_of_a_known_difference() {
        let truth = Video::new(2, 12, 13, vec![0.5; 2 * 12 * 13]).unwrap();
        let mut result = truth.clone();
        result.data.iter_mut().for_each(|v| *v += 0.1);
        let measures = compare(&truth, &result).unwrap();
        assert!((measures.psnr - 20.0).abs() < 1e-5);
        // l(0.6) − l(0.5) = ln(3001/2501)/ln 5001 = 0.0213957.
        assert!((measures.psnr_mu + 20.0 * 0.021_395_7_f64.log10()).abs() < 1e-3, "{}", measures.psnr_mu);
    }

    #[test]
    fn a_copy_is_perfect() {
        let video = noise(2, 20, 15, 1);
        let measures = compare(&video, &video).unwrap();
        assert!(measures.psnr.is_infinite() && measures.psnr_mu.is_infinite());
        assert!((measures.ssim_mu.unwrap() - 1.0).abs() < 1e-12);
        assert!(serde_json::to_string(&measures).unwrap().contains("\"psnr\":null"));
    }

    #[test]
    fn values_out_of_range_are_clipped() {
        let truth = Video::new(1, 1, 3, vec![1.0, 0.0, 1.0]).unwrap();
        let result = Video::new(1, 1, 3, vec![7.0, -2.0, 1.0]).unwrap();
        let measures = compare(&truth, &result).unwrap();
        assert!(measures.psnr.is_infinite() && measures.ssim_mu.is_none());
    }

    /// Against eq. 18 with the two-dimensional window written out, and the covariances as sums of products of
    /// differences.
    #[test]
    fn ssim_matches_its_definition() {
        let (height, width) = (14, 17);
        let a: Vec<f64> = noise(1, height, width, 3).data.iter().map(|&v| f64::from(v)).collect();
        let b: Vec<f64> = noise(1, height, width, 4)
            .data
            .iter()
            .zip(&a)
            .map(|(&n, a)| 0.7 * a + 0.3 * f64::from(n))
            .collect();
        let weight = |dy: usize, dx: usize| {
            let square = |d: usize| (d as f64 - 5.0).powi(2);
            (-(square(dy) + square(dx)) / 4.5).exp()
        };
        let places: Vec<(usize, usize)> = (0..11).flat_map(|y| (0..11).map(move |x| (y, x))).collect();
        let norm: f64 = places.iter().map(|&(y, x)| weight(y, x)).sum();
        let mut sum = 0.0;
        for (y, x) in (0..4).flat_map(|y| (0..7).map(move |x| (y, x))) {
            let mean = |f: &dyn Fn(usize) -> f64| -> f64 {
                places.iter().map(|&(v, u)| weight(v, u) / norm * f((y + v) * width + x + u)).sum()
            };
            let (mean_a, mean_b) = (mean(&|i| a[i]), mean(&|i| b[i]));
            let var_a = mean(&|i| (a[i] - mean_a).powi(2));
            let var_b = mean(&|i| (b[i] - mean_b).powi(2));
            let cov = mean(&|i| (a[i] - mean_a) * (b[i] - mean_b));
            sum += (2.0 * mean_a * mean_b + 1e-4) * (2.0 * cov + 9e-4)
                / ((mean_a.powi(2) + mean_b.powi(2) + 1e-4) * (var_a + var_b + 9e-4));
        }
        let found = ssim(&a, &b, width).unwrap();
        assert!((found - sum / 28.0).abs() < 1e-12, "{found}");
        assert!(found > 0.3 && found < 0.99, "{found}");
        assert_eq!(ssim(&a, &b, 0), None);
        assert_eq!(ssim(&a[..17 * 10], &b[..17 * 10], width), None);
    }

    #[test]
    fn streaming_equals_the_whole() {
        let (truth, result) = (noise(5, 16, 16, 5), noise(5, 16, 16, 6));
        let mut comparison = Comparison::default();
        for t in 0..5 {
            comparison.add(truth.plane(t), result.plane(t));
        }
        let (streamed, whole) = (comparison.measures(), compare(&truth, &result).unwrap());
        assert!(
            (streamed.psnr_mu - whole.psnr_mu).abs() < 1e-12 && (streamed.psnr - whole.psnr).abs() < 1e-12
        );
        assert!((streamed.ssim_mu.unwrap() - whole.ssim_mu.unwrap()).abs() < 1e-12);
    }

    #[test]
    fn different_extents_are_refused() {
        let error = compare(&Video::black(2, 3, 4), &Video::black(2, 3, 5)).unwrap_err().to_string();
        assert!(error.contains("2×3×4") && error.contains("2×3×5"), "{error}");
        assert!(compare(&Video::black(0, 3, 4), &Video::black(0, 3, 4)).is_err());
    }

    #[test]
    fn contrast_of_a_passage() {
        assert!((temporal_contrast([0.2, 0.3, 0.1, 0.25]) - 0.5).abs() < 1e-7);
        for (series, contrast) in [(&[0.0, 0.0][..], 0.0), (&[], 0.0), (&[0.0, 0.1], 1.0)] {
            assert!((temporal_contrast(series.iter().copied()) - contrast).abs() < 1e-12);
        }
    }
}

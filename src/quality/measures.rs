//! PSNR, SSIM and temporal contrast, over everything and where they are worst.

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
/// Height and width of a patch, as far as the frame has them.
const PATCH: usize = 16;
/// Largest part of a video's pixels that may be clipped.
const MOSTLY: f64 = 0.5;
/// Least peak of the truth: below one count of 10 bits in the shortest exposure, errors are small whatever the result.
const LEAST_PEAK: f64 = 1e-3;

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

/// Measures, where they are worst, and how much of the values they leave out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Over everything.
    #[serde(flatten)]
    pub measures: Measures,
    /// Parts of the truth's and of the result's pixels that lie outside of [0, 1], to which they were clipped.
    pub clipped: [f64; 2],
    /// The frame with the lowest PSNR-µ; none where there is no error.
    pub worst_frame: Option<WorstFrame>,
    /// The patch of one frame with the lowest PSNR-µ; none where there is no error.
    pub worst_patch: Option<WorstPatch>,
}

/// The worst frame, which a mean over time hides.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorstFrame {
    /// Its number, from 0.
    pub frame: u64,
    /// Its PSNR of l(p), in dB.
    pub psnr_mu: f64,
}

/// The worst patch, which a mean over the frame hides. Patches lie side by side; the last ones end with the frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorstPatch {
    /// Its frame, from 0.
    pub frame: u64,
    /// Its first row.
    pub row: usize,
    /// Its first column.
    pub column: usize,
    /// Rows and columns: 16, or as many as a smaller frame has.
    pub size: [usize; 2],
    /// Its PSNR of l(p), in dB.
    pub psnr_mu: f64,
}

impl fmt::Display for Measures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PSNR-µ {:.2} dB, PSNR {:.2} dB", self.psnr_mu, self.psnr)?;
        self.ssim_mu.map_or(Ok(()), |ssim| write!(f, ", SSIM-µ {ssim:.4}"))
    }
}

impl fmt::Display for Evaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.measures)?;
        if let Some(WorstFrame { frame, psnr_mu }) = self.worst_frame {
            write!(f, "\nworst frame: {frame}, PSNR-µ {psnr_mu:.2} dB")?;
        }
        if let Some(WorstPatch { frame, row, column, size: [height, width], psnr_mu }) = self.worst_patch {
            write!(
                f,
                "\nworst patch of {height}×{width}: frame {frame}, row {row}, column {column}, PSNR-µ {psnr_mu:.2} dB"
            )?;
        }
        if self.clipped != [0.0; 2] {
            let [truth, result] = self.clipped.map(|part| 100.0 * part);
            write!(f, "\nclipped to 0…1: {truth:.2}% of the truth's pixels, {result:.2}% of the result's")?;
        }
        Ok(())
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
    frames: u64,
    /// Pixels of truth and result that were clipped.
    clipped: [u64; 2],
    /// Pixels that differ, and are the same once clipped.
    hidden: u64,
    /// Largest value of the truth.
    peak: f32,
    worst_frame: Option<(u64, SquaredError)>,
    worst_patch: Option<(Place, SquaredError)>,
}

/// Where a patch lies.
#[derive(Clone, Copy, Debug)]
struct Place {
    frame: u64,
    row: usize,
    column: usize,
    size: [usize; 2],
}

impl Comparison {
    /// Adds one frame of irradiance. Values are clipped to [0, 1], the range of p.
    pub fn add(&mut self, truth: Plane<'_>, result: Plane<'_>) {
        let width = truth.extent().width;
        for (&a, &b) in truth.values().iter().zip(result.values()) {
            let clipped = [a, b].map(|p| p.clamp(0.0, 1.0));
            for (count, (p, clipped)) in self.clipped.iter_mut().zip([a, b].into_iter().zip(clipped)) {
                *count += u64::from(p != clipped);
            }
            self.hidden += u64::from(a != b && clipped[0] == clipped[1]);
            self.peak = self.peak.max(a);
        }
        let clip = |frame: Plane<'_>| -> Vec<f64> {
            frame.values().iter().map(|&p| f64::from(p).clamp(0.0, 1.0)).collect()
        };
        let (mut truth, mut result) = (clip(truth), clip(result));
        self.linear.add(truth.iter().copied(), result.iter().copied());
        for p in truth.iter_mut().chain(&mut result) {
            *p = tone(*p);
        }
        let mut toned = SquaredError::default();
        toned.add(truth.iter().copied(), result.iter().copied());
        self.toned.merge(toned);
        self.worst_frame = worse(self.worst_frame, (self.frames, toned));
        for (row, column, size) in patches(truth.len() / width.max(1), width) {
            let mut error = SquaredError::default();
            for y in row..row + size[0] {
                let line = y * width + column..y * width + column + size[1];
                error.add(truth[line.clone()].iter().copied(), result[line].iter().copied());
            }
            let place = Place { frame: self.frames, row, column, size };
            self.worst_patch = worse(self.worst_patch, (place, error));
        }
        self.frames += 1;
        let (sum, windows) = ssim_sum(&truth, &result, width);
        self.ssim_sum += sum;
        self.ssim_windows += windows;
    }

    /// Adds the frames of another comparison, which follow on these.
    pub fn merge(&mut self, other: Self) {
        if let Some((frame, error)) = other.worst_frame {
            self.worst_frame = worse(self.worst_frame, (self.frames + frame, error));
        }
        if let Some((place, error)) = other.worst_patch {
            let place = Place { frame: self.frames + place.frame, ..place };
            self.worst_patch = worse(self.worst_patch, (place, error));
        }
        self.frames += other.frames;
        for (count, more) in self.clipped.iter_mut().zip(other.clipped) {
            *count += more;
        }
        self.hidden += other.hidden;
        self.peak = self.peak.max(other.peak);
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

    /// The measures, or an error where the range of the values makes them meaningless: they would flatter.
    pub fn evaluation(&self) -> Result<Evaluation, VideoError> {
        let evaluation = Evaluation {
            measures: self.measures(),
            clipped: self.clipped.map(|count| count as f64 / self.linear.count.max(1) as f64),
            worst_frame: self.worst_frame.map(|(frame, error)| WorstFrame { frame, psnr_mu: error.psnr() }),
            worst_patch: self.worst_patch.map(|(Place { frame, row, column, size }, error)| WorstPatch {
                frame,
                row,
                column,
                size,
                psnr_mu: error.psnr(),
            }),
        };
        let peak = f64::from(self.peak);
        for (name, part) in ["truth", "result"].into_iter().zip(evaluation.clipped) {
            if part > MOSTLY {
                return Err(VideoError::Range(format!(
                    "{:.1}% of the {name}'s pixels are outside of 0…1 (the truth's largest is {peak:.4}), where \
                     irradiance p would be clipped",
                    100.0 * part
                )));
            }
        }
        if self.linear.sum == 0.0 && self.hidden > 0 {
            return Err(VideoError::Range(format!(
                "truth and result differ in {} pixels, all of them outside of 0…1, where irradiance p would be clipped",
                self.hidden
            )));
        }
        if peak < LEAST_PEAK {
            return Err(VideoError::Range(format!(
                "the truth's largest value is {peak:e}: beside a peak of 1 any error is small"
            )));
        }
        Ok(evaluation)
    }
}

/// The worse of two places by mean error; where both are equally bad, the first. One without an error is none.
fn worse<P>(known: Option<(P, SquaredError)>, new: (P, SquaredError)) -> Option<(P, SquaredError)> {
    let least = known.as_ref().map_or(0.0, |(_, error)| error.mean());
    if new.1.mean() > least { Some(new) } else { known }
}

/// First row, first column and size of each patch of a frame.
fn patches(height: usize, width: usize) -> impl Iterator<Item = (usize, usize, [usize; 2])> {
    let size = [height.min(PATCH), width.min(PATCH)];
    let begins = |len: usize| (0..len).step_by(PATCH).map(move |begin| begin.min(len - len.min(PATCH)));
    begins(height).flat_map(move |row| begins(width).map(move |column| (row, column, size)))
}

/// Divides truth and result alike by the largest value of the truth, which is returned.
pub fn normalise(truth: &mut Video, result: &mut Video) -> Result<f32, VideoError> {
    let peak = truth.data.iter().copied().fold(0.0, f32::max);
    if peak == 0.0 {
        return Err(VideoError::Shape(
            "the truth is black throughout: there is no value to normalise by".into(),
        ));
    }
    for p in truth.data.iter_mut().chain(&mut result.data) {
        *p /= peak;
    }
    Ok(peak)
}

/// Measures of a whole video. Does not depend on the number of threads.
pub fn compare(truth: &Video, result: &Video) -> Result<Measures, VideoError> {
    Ok(comparison(truth, result)?.measures())
}

/// What a whole video is worth, or an error where its range makes no sense for irradiance p.
pub fn evaluate(truth: &Video, result: &Video) -> Result<Evaluation, VideoError> {
    comparison(truth, result)?.evaluation()
}

fn comparison(truth: &Video, result: &Video) -> Result<Comparison, VideoError> {
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
    Ok(all)
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
        let error = evaluate(&truth, &result).unwrap_err().to_string();
        assert!(error.contains("66.7% of the result's"), "{error}");
    }

    /// Nothing that differs is called perfect, and what is clipped is said.
    #[test]
    fn ranges_that_make_no_sense_are_refused() {
        let scaled = |mut video: Video, factor: f32| {
            video.data.iter_mut().for_each(|p| *p = *p * factor + 0.002 * factor);
            video
        };
        let pair = |factor: f32| (scaled(noise(2, 16, 16, 1), factor), scaled(noise(2, 16, 16, 2), factor));
        for (factor, said) in [(1000.0, "outside of 0…1"), (1e-4, "any error is small")] {
            let (mut truth, mut result) = pair(factor);
            let error = evaluate(&truth, &result).unwrap_err().to_string();
            assert!(error.contains(said) && error.contains("--normalise"), "{error}");
            let peak = truth.data.iter().copied().fold(0.0, f32::max);
            assert_eq!(normalise(&mut truth, &mut result).unwrap(), peak);
            let found = evaluate(&truth, &result).unwrap();
            // Two independent, uniform series differ by 1/6 in the mean square.
            assert!((found.measures.psnr - 7.78).abs() < 0.5, "{found}");
        }
        let (truth, mut result) = (scaled(noise(1, 16, 16, 1), 1.1), scaled(noise(1, 16, 16, 1), 1.1));
        result.data.iter_mut().filter(|p| **p > 1.0).for_each(|p| *p += 3.0);
        let error = evaluate(&truth, &result).unwrap_err().to_string();
        assert!(error.contains("truth and result differ"), "{error}");
        let mut black = Video::black(1, 4, 4);
        assert!(normalise(&mut black.clone(), &mut black).unwrap_err().to_string().contains("black"));
    }

    #[test]
    fn a_broken_corner_is_found() {
        let truth = Video::new(3, 40, 37, vec![0.5; 3 * 40 * 37]).unwrap();
        let mut result = truth.clone();
        result.data.iter_mut().for_each(|p| *p += 0.001);
        // The last corner of frame 1, which its patch reaches though 37 and 40 are no multiples of 16.
        for y in 36..40 {
            result.data[(40 + y) * 37 + 30..(40 + y) * 37 + 37].fill(0.0);
        }
        let found = evaluate(&truth, &result).unwrap();
        let (frame, patch) = (found.worst_frame.unwrap(), found.worst_patch.unwrap());
        assert_eq!((frame.frame, patch.frame, patch.row, patch.column, patch.size), (1, 1, 24, 21, [16, 16]));
        assert!(patch.psnr_mu < frame.psnr_mu && frame.psnr_mu < found.measures.psnr_mu, "{found}");
        // 28 of 256 pixels are off by l(0.5), the others by 2.3e-4.
        let expected = -10.0 * (28.0 / 256.0 * tone(0.5_f64).powi(2)).log10();
        assert!((patch.psnr_mu - expected).abs() < 0.01, "{} is not {expected}", patch.psnr_mu);
        let perfect = evaluate(&truth, &truth).unwrap();
        assert!(perfect.worst_frame.is_none() && perfect.worst_patch.is_none());
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

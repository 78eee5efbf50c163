//! The camera simulator: irradiance in, read-outs of a pixel-wise exposed sensor out (paper eq. 12).

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, Poisson};
use rayon::prelude::*;

use super::{Capture, CaptureInfo, PatternSpec, ResponseSpec, Timing};
use super::{Form, Pattern, Placement, Readout, Recording, Response, SensorError};
use crate::Result;
use crate::video::Counts;
use crate::video::Video;

/// Shot noise and read noise, both in electrons (design §2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Electrons at y = 1. Infinity: no noise at all.
    pub full_well_e: f64,
    /// Standard deviation of the read noise in electrons.
    pub read_noise_e: f64,
}

impl Default for Noise {
    /// The paper's sensor: 1 V swing over 110 µV/e⁻, 2.67 e⁻ rms.
    fn default() -> Self {
        Self { full_well_e: 9000.0, read_noise_e: 2.67 }
    }
}

impl Noise {
    /// No noise.
    pub const NONE: Self = Self { full_well_e: f64::INFINITY, read_noise_e: 0.0 };
}

/// A simulated camera.
#[derive(Clone, Debug)]
pub struct Sampler {
    pattern: Pattern,
    response: Response,
    /// Shot and read noise.
    pub noise: Noise,
    /// Bits per pixel value, 1 to 16.
    pub bit_depth: u32,
    /// Count at y = 0, the pedestal that the converter adds. At 0 it cuts noise off at black; above, counts keep it.
    pub black_level: u16,
    /// Duration of a frame in milliseconds.
    pub frame_period_ms: f64,
    /// What each frame of the capture holds.
    pub timing: Timing,
    /// Schedule time of the first frame.
    pub schedule_start: i64,
    /// How frames lie on the sensor.
    pub placement: Placement,
    /// Seed of the noise.
    pub seed: u64,
    /// Error of the black level that whoever reads the capture does not know of, as a fraction of white.
    pub black_error: f64,
    /// Error of the gain that whoever reads the capture does not know of: y is multiplied by 1 + this.
    pub gain_error: f64,
}

impl Sampler {
    /// A camera with the default noise, 10 bits and covering timing.
    pub fn new(pattern: Pattern, form: Form) -> Result<Self, SensorError> {
        let response = Response::new(form, pattern.shortest_exposure() as f64)?;
        Ok(Self {
            pattern,
            response,
            noise: Noise::default(),
            bit_depth: 10,
            black_level: 0,
            frame_period_ms: 1.0,
            timing: Timing::Covering,
            schedule_start: 0,
            placement: Placement::WHOLE,
            seed: 0,
            black_error: 0.0,
            gain_error: 0.0,
        })
    }

    /// When each pixel of the sensor integrates.
    pub fn pattern(&self) -> &Pattern {
        &self.pattern
    }

    /// From exposure to pixel value; it saturates at the pattern's shortest exposure.
    pub fn response(&self) -> &Response {
        &self.response
    }

    /// Largest count, of 1 to 16 bits.
    fn white(&self) -> f64 {
        f64::from((1u32 << self.bit_depth.min(16)) - 1)
    }

    /// What a capture says of itself.
    fn info(&self) -> CaptureInfo {
        let Noise { full_well_e, read_noise_e } = self.noise;
        let noisy = full_well_e.is_finite();
        CaptureInfo {
            pattern: PatternSpec::of(&self.pattern),
            timing: self.timing,
            schedule_start: self.schedule_start,
            tile_origin: self.placement.tile_origin,
            orientation: self.placement.orientation,
            bit_depth: self.bit_depth,
            black_level: f64::from(self.black_level),
            white_level: self.white(),
            frame_period_ms: self.frame_period_ms,
            response: ResponseSpec::Form(self.response.form().clone()),
            full_well_e: noisy.then_some(full_well_e),
            read_noise_e: noisy.then_some(read_noise_e),
            anchor: None,
            dead_pixels: Vec::new(),
            missing_count: None,
            frame_numbers: None,
            time_stamps_ms: None,
        }
    }

    /// The read-out that a frame of the capture holds.
    fn readout(&self, y: usize, x: usize, t: i64) -> Readout<'_> {
        let schedule = self.pattern.schedule(y, x);
        let covering = schedule.covering(t);
        match self.timing {
            Timing::Covering => covering,
            Timing::Hold => schedule.covering(covering.start - 1),
        }
    }

    /// Exposure value x of a read-out: light before the first and after the last frame of the video is taken to
    /// be that frame's.
    fn exposure_value(&self, video: &Video, pixel: usize, readout: &Readout) -> f64 {
        let last = video.frames as i64 - 1;
        let frame = |offset: &usize| {
            let t = (readout.start - self.schedule_start + *offset as i64).clamp(0, last) as usize;
            f64::from(video.data[t * video.frame_len() + pixel])
        };
        readout.shutter.open().iter().map(frame).sum()
    }

    /// Count of a read-out with exposure value x.
    fn count(&self, x: f64, rng: &mut ChaCha8Rng) -> u16 {
        let Noise { full_well_e, read_noise_e } = self.noise;
        let x = if full_well_e.is_finite() {
            let per_x = full_well_e / self.response.saturation();
            let expected = x * per_x;
            // There is no Poisson distribution of mean 0, and none of so many electrons that their noise is nothing.
            let shot = Poisson::new(expected).map_or(expected, |poisson| poisson.sample(rng));
            let read = Normal::new(0.0, read_noise_e).map_or(0.0, |normal| normal.sample(rng));
            (shot + read) / per_x
        } else {
            x
        };
        // Below black, a pedestal shows the response's odd continuation.
        let below_black = x < 0.0 && self.black_level > 0;
        let value = if below_black { -self.response.value(-x) } else { self.response.value(x) };
        let y = value * (1.0 + self.gain_error) + self.black_error;
        let (black, white) = (f64::from(self.black_level), self.white());
        (black + y * (white - black)).clamp(0.0, white).round() as u16
    }

    /// Samples a video of irradiance p. Every read-out has one noise draw, from a random stream of its own row
    /// and end, so that threads do not change it.
    pub fn sample(&self, video: &Video) -> Result<Capture> {
        if video.data.is_empty() {
            return Err(SensorError::Capture("the video has no pixels".into()).into());
        }
        // What no capture can say is refused before it is computed with.
        Recording::new(self.info(), [video.height, video.width], None)?;
        video.check_finite()?;
        let mut counts = vec![0u16; video.data.len()];
        let width = video.width;
        let mut rows: Vec<Vec<&mut [u16]>> = (0..video.height).map(|_| Vec::new()).collect();
        for (index, row) in counts.chunks_mut(width).enumerate() {
            rows[index % video.height].push(row);
        }
        let shown = Self { pattern: self.placement.shown(&self.pattern), ..self.clone() };
        rows.par_iter_mut().enumerate().for_each(|(y, frames)| shown.sample_row(video, y, frames));
        Capture::new(self.info(), [video.frames, video.height, width], Counts::U16(counts), None)
    }

    /// Samples row `y`; `frames` are its counts in each frame.
    fn sample_row(&self, video: &Video, y: usize, frames: &mut [&mut [u16]]) {
        // The end of the read-out whose count each pixel holds now.
        let mut held = vec![i64::MIN; video.width];
        for t in 0..frames.len() {
            // One stream a frame and row; pixels whose read-out begins to show draw from it in order. The read-out
            // that shows first may have begun before the video, so the first frame draws for all pixels.
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
            let now = self.schedule_start + t as i64;
            rng.set_stream(((now as u64) << 24) | y as u64);
            let (before, rest) = frames.split_at_mut(t);
            for (x, count) in rest[0].iter_mut().enumerate() {
                let readout = self.readout(y, x, now);
                if readout.end() == held[x] {
                    *count = before[t - 1][x];
                    continue;
                }
                held[x] = readout.end();
                let exposure = self.exposure_value(video, y * video.width + x, &readout);
                *count = self.count(exposure, &mut rng);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(frames: usize, p: f32) -> Video {
        Video { frames, height: 64, width: 64, data: vec![p; frames * 64 * 64] }
    }

    fn camera(form: Form) -> Sampler {
        Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), form).unwrap()
    }

    /// Static, unsaturated pixels scale with their exposure.
    #[test]
    fn noise_free_values_are_p_times_exposure() {
        let mut sampler = camera(Form::Linear);
        sampler.noise = Noise::NONE;
        sampler.bit_depth = 16;
        let capture = sampler.sample(&flat(16, 0.1)).unwrap();
        let values = capture.measurement();
        for (x, exposure) in [(0, 2.0), (1, 4.0), (2, 8.0), (3, 8.0)] {
            let expected = 0.1 * exposure / 2.0;
            assert!((values.frame(5)[x] - expected).abs() < 1e-4, "column {x}");
        }
    }

    /// The shortest pixel saturates just at p = 1, the longer ones below.
    #[test]
    fn shortest_exposure_saturates_at_the_anchor() {
        let mut sampler = camera(Form::Gamma(2.2));
        sampler.noise = Noise::NONE;
        let values = sampler.sample(&flat(16, 0.99)).unwrap().measurement();
        assert!(values.frame(5)[0] < 1.0 && values.frame(5)[1] == 1.0);
        let values = sampler.sample(&flat(16, 1.0)).unwrap().measurement();
        assert_eq!(values.frame(5)[0], 1.0);
    }

    /// Mean and variance of the electrons are those of shot and read noise.
    #[test]
    fn photon_statistics() {
        let mut sampler = camera(Form::Linear);
        sampler.bit_depth = 16;
        sampler.noise = Noise { full_well_e: 1000.0, read_noise_e: 5.0 };
        let p = 0.2;
        let values = sampler.sample(&flat(64, p)).unwrap().measurement();
        let electrons: Vec<f64> = (1..64)
            .step_by(2)
            .flat_map(|t| (0..64).step_by(4).map(move |x| (t, x)))
            .map(|(t, x)| f64::from(values.frame(t)[x]) * 1000.0)
            .collect();
        let n = electrons.len() as f64;
        let mean = electrons.iter().sum::<f64>() / n;
        let variance = electrons.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let expected = 1000.0 * f64::from(p);
        // Four standard errors of each.
        assert!((mean - expected).abs() < 4.0 * (225.0 / n).sqrt(), "mean {mean} over {n}");
        assert!((variance - 225.0).abs() < 4.0 * 225.0 * (2.0 / n).sqrt(), "variance {variance}");
    }

    /// One read-out has one noise draw, however many frames it covers.
    #[test]
    fn a_readout_is_drawn_once() {
        let values = camera(Form::Linear).sample(&flat(16, 0.1)).unwrap().measurement();
        let column = |x: usize| (0..16).map(|t| values.frame(t)[x]).collect::<Vec<_>>();
        let changes = |x: usize| column(x).windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert!(column(2)[..8].iter().all(|v| *v == column(2)[0]));
        assert!((6..=8).contains(&changes(0)), "{:?}", column(0));
        assert!(changes(2) <= 1);
    }

    /// Sample and hold delivers each read-out only when it has ended.
    #[test]
    fn hold_lags_by_the_exposure() {
        let mut video = Video::black(24, 2, 4);
        for t in 12..24 {
            video.frame_mut(t).fill(0.1);
        }
        let mut sampler = camera(Form::Linear);
        sampler.noise = Noise::NONE;
        let first = |timing| {
            let mut sampler = sampler.clone();
            sampler.timing = timing;
            let values = sampler.sample(&video).unwrap().measurement();
            (0..4).map(|x| (0..24).find(|&t| values.frame(t)[x] > 0.0).unwrap()).collect::<Vec<_>>()
        };
        assert_eq!(first(Timing::Covering), [11, 10, 8, 12]);
        assert_eq!(first(Timing::Hold), [13, 14, 16, 20]);
    }

    #[test]
    fn threads_do_not_change_the_noise() {
        let sampler = camera(Form::Linear);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| sampler.sample(&flat(16, 0.3)).unwrap().measurement())
        };
        assert_eq!(run(1), run(3));
    }

    /// In the dark, counts scatter around a pedestal; without one, what lies below black is cut off.
    #[test]
    fn a_pedestal_keeps_noise_below_black() {
        let statistics = |black_level: u16, form: Form| {
            let mut sampler = camera(form);
            sampler.noise = Noise { full_well_e: 200.0, read_noise_e: 2.67 };
            sampler.black_level = black_level;
            let capture = sampler.sample(&flat(16, 0.0)).unwrap();
            assert_eq!(capture.info.black_level, f64::from(black_level));
            let Counts::U16(counts) = capture.counts else { unreachable!() };
            let n = counts.len() as f64;
            let mean = counts.iter().map(|&c| f64::from(c)).sum::<f64>() / n;
            let variance = counts.iter().map(|&c| (f64::from(c) - mean).powi(2)).sum::<f64>() / n;
            [mean, variance.sqrt()]
        };
        let deviation = 2.67 / 200.0 * (1023.0 - 48.0);
        let [mean, spread] = statistics(48, Form::Linear);
        assert!((mean - 48.0).abs() < 0.5 && (spread / deviation - 1.0).abs() < 0.05, "{mean} ± {spread}");
        let [mean, spread] = statistics(0, Form::Linear);
        let deviation = 2.67 / 200.0 * 1023.0;
        // Half of a normal distribution, the other half at 0.
        assert!((mean / deviation - 0.399).abs() < 0.03 && spread < 0.65 * deviation, "{mean} ± {spread}");
        let [mean, spread] = statistics(400, Form::Gamma(2.2));
        assert!((mean - 400.0).abs() < 4.0 && spread > 50.0, "{mean} ± {spread}");
    }

    #[test]
    fn black_lies_below_white() {
        let mut sampler = camera(Form::Linear);
        sampler.black_level = 1023;
        assert!(sampler.sample(&flat(1, 0.5)).unwrap_err().to_string().contains("1023"));
    }
}

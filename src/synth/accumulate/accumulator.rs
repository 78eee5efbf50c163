//! What is remembered of each pixel, and how it is fused with the net's results.
//!
//! Changes, errors and their variances are those of the tone curve l, in which results are judged; l' = dl/dp takes
//! irradiance there.

use rayon::prelude::*;

use super::pooled::{LANES, Lanes, POOLED, pool};
use super::readings::{FrameReadings, Reading};
use crate::frame::Extent;
use crate::math::MU;

/// ln(1 + µ).
const LN: f32 = 8.517_393;
/// Share of the newest read-out in the mean of recent innovations.
const RECENT: f32 = 1.0 / 6.0;
/// Variance of that mean over the variance of one innovation.
const RECENT_VARIANCE: f32 = RECENT / (2.0 - RECENT);
/// Share of the newest read-out in what is averaged over recent ones to be told from noise.
const NEWEST: f32 = 1.0 / 8.0;
/// Variance of such an average over the variance of one value.
const AVERAGED: f32 = NEWEST / (2.0 - NEWEST);
/// How many standard deviations beyond its mean a pooled square may lie and pass for noise: of one innovation, of several,
/// and of one where the net's results are averaged, which saves less and so has to risk less.
const UNUSUAL: f32 = 5.0;
const UNUSUAL_OF_SEVERAL: f32 = 3.0;
const UNUSUAL_FOR_RESULTS: f32 = 3.0;
/// The same for the square of a single pixel, which no other pixel has to confirm.
const OUTLIER: f32 = 12.0;
/// Largest square of an innovation in l that counts.
const LARGEST: f32 = 0.1;
/// What of the unrest of the frame before is still believed.
const SUBSIDES: f32 = 0.8;
/// What a net's result is taken to be off by in l, at least and at most.
const NET_ERROR: [f32; 2] = [0.001, 0.02];
/// Share of the newest frame in the estimate of the net's error.
const NEWEST_ERROR: f32 = 0.1;
/// Frames of results that are averaged at most.
const MOST_RESULTS: f32 = 32.0;
/// Irradiance below which l' is taken to be constant, so that negative and dark values do not rule.
const DARK: f32 = 2e-4;

/// What is remembered of a pixel.
#[derive(Clone, Copy, Debug, Default)]
struct Pixel {
    /// Read-outs so far.
    readouts: u32,
    /// Mean of its read-outs, irradiance p, and σ² of that.
    mean: f32,
    variance: f32,
    /// Mean of recent innovations, in p.
    recent: f32,
    /// Variance in l by which it may have changed, for the mean of its read-outs and for that of the net's results.
    unrest: f32,
    unrest_of_results: f32,
    /// Mean of the net's results in l, over so many frames.
    result: f32,
    results: f32,
    /// Mean squared error of the net around here, in l.
    net_error: f32,
    /// Share of the mean of its read-outs in what is delivered.
    weight: f32,
}

/// Memory of the frames since it was begun.
#[derive(Debug)]
pub struct Accumulator {
    extent: Extent,
    /// Frames so far, and those in which nothing is believed yet.
    frames: usize,
    learning: usize,
    pixels: Vec<Pixel>,
    /// By pixel, what is pooled ([`Lane`]), and what that gives.
    statistics: Vec<Lanes>,
    rows: Vec<Lanes>,
    means: Vec<Lanes>,
}

/// What is pooled over the pixels around.
#[derive(Clone, Copy)]
enum Lane {
    /// Squared innovation beyond what noise explains.
    Surprise,
    /// What noise explains of it.
    Expected,
    /// Its mean over recent read-outs: what goes on for a while is seen in less of it.
    Lasting,
    /// The square of the mean of recent innovations beyond what noise explains.
    Drift,
    /// Of single pixels, what lies far beyond.
    Outlier,
    /// Product of an innovation and of what the net says beyond the memory: positive where the net is right.
    Testimony,
    /// Variance of that if the memory is right.
    TestimonyNoise,
    /// Squared difference of the net and the memory beyond what the memory's noise explains, where it is trusted.
    Difference,
    /// Whether it is trusted.
    Trusted,
}

const _: () = assert!(Lane::Trusted as usize + 1 == LANES);

/// Tone curve.
fn tone(p: f32) -> f32 {
    (MU as f32 * p.clamp(0.0, 1.0)).ln_1p() / LN
}

/// Its inverse.
fn irradiance(l: f32) -> f32 {
    (l * LN).exp_m1() / MU as f32
}

/// Square of its derivative.
fn slope_squared(p: f32) -> f32 {
    let slope = MU as f32 / ((1.0 + MU as f32 * p.max(DARK)) * LN);
    slope * slope
}

impl Accumulator {
    /// An empty memory of frames of `extent`, of a pattern that repeats every `period` frames.
    pub fn new(extent: Extent, period: usize) -> Self {
        let empty = || vec![[0.0; LANES]; extent.pixels()];
        Self {
            extent,
            frames: 0,
            // By then every pixel has had two read-outs.
            learning: 2 * period,
            pixels: vec![Pixel { unrest: 1.0, ..Pixel::default() }; extent.pixels()],
            statistics: empty(),
            rows: empty(),
            means: empty(),
        }
    }

    /// Goes on to the next frame, of which the net says `result` [y, x].
    pub fn advance(&mut self, frame: &FrameReadings<'_>, result: &[f32]) {
        let width = self.extent.width;
        let statistics = self.statistics.par_chunks_mut(width).zip(self.pixels.par_chunks_mut(width));
        statistics.enumerate().for_each(|(y, (statistics, pixels))| {
            let row = statistics.iter_mut().zip(pixels).zip(frame.row(y));
            row.for_each(|((lanes, pixel), reading)| pixel.compare(frame, reading, lanes));
        });
        pool(self.extent, &self.statistics, &mut self.rows, &mut self.means);
        let learns = self.frames < self.learning;
        let pooled = self.means.par_chunks(width).zip(result.par_chunks(width));
        let rows = self.pixels.par_chunks_mut(width).zip(self.statistics.par_chunks_mut(width)).zip(pooled);
        rows.enumerate().for_each(|(y, ((pixels, statistics), (pooled, result)))| {
            let row = pixels.iter_mut().zip(statistics).zip(pooled).zip(result).zip(frame.row(y));
            for ((((pixel, lanes), pooled), &result), reading) in row {
                let unrest = pixel.notice(pooled);
                pixel.take(frame, reading, unrest);
                pixel.average(tone(result), learns);
                pixel.weigh(frame, reading, learns, pooled, lanes);
            }
        });
        self.frames += 1;
    }

    /// Fuses the net's `result` [y, x] of the frame to which [`Self::advance`] went on with what is remembered. Where that is
    /// nothing, it stays as it is.
    pub fn fuse(&self, result: &mut [f32]) {
        result.par_iter_mut().zip(&self.pixels).for_each(|(result, pixel)| {
            if pixel.results > 1.0 || pixel.weight > 0.0 {
                let own = tone(pixel.mean);
                *result = irradiance(pixel.result + (own - pixel.result) * pixel.weight);
            }
        });
    }
}

impl Pixel {
    /// Holds a read-out that begins against what is expected.
    fn compare(&mut self, frame: &FrameReadings<'_>, reading: Reading, lanes: &mut Lanes) {
        if !reading.begins || self.readouts == 0 {
            return;
        }
        let slope = slope_squared(self.mean);
        let explained = self.variance + frame.variance(self.mean, reading.exposure);
        let off = reading.irradiance - self.mean;
        // A saturated pixel says only that there is at least so much.
        let innovation = if reading.saturated { off.max(0.0) } else { off };
        self.recent += RECENT * (innovation - self.recent);
        let expected = explained * slope;
        let surprise = (innovation * innovation * slope - expected).min(LARGEST);
        let drift = (self.recent * self.recent * slope - expected * RECENT_VARIANCE).min(LARGEST);
        lanes[Lane::Expected as usize] = expected;
        lanes[Lane::Surprise as usize] = surprise;
        let lasting = &mut lanes[Lane::Lasting as usize];
        *lasting += NEWEST * (surprise - *lasting);
        lanes[Lane::Drift as usize] = drift;
        let outlier = (surprise - OUTLIER * expected).max(drift - OUTLIER * expected * RECENT_VARIANCE);
        lanes[Lane::Outlier as usize] = outlier.max(0.0);
        if self.readouts >= 2 {
            let beyond = (self.result - tone(self.mean)).clamp(-0.1, 0.1);
            let seen = (innovation * slope.sqrt()).clamp(-0.3, 0.3);
            let testimony = &mut lanes[Lane::Testimony as usize];
            *testimony += NEWEST * (seen * beyond - *testimony);
            lanes[Lane::TestimonyNoise as usize] = expected * beyond * beyond * AVERAGED;
        }
    }

    /// By what variance in l the scene may just have moved away from what is remembered, as the pixels around show.
    fn notice(&mut self, pooled: &Lanes) -> f32 {
        let of = |lane: Lane| pooled[lane as usize];
        // Of the mean of squares of normal deviates, over their expectation.
        let deviation = (2.0 / POOLED as f32).sqrt() * of(Lane::Expected);
        let surprise = |unusual: f32| of(Lane::Surprise) - unusual * deviation;
        let drift = of(Lane::Drift) - UNUSUAL_OF_SEVERAL * deviation * RECENT_VARIANCE;
        let lasting = of(Lane::Lasting) - UNUSUAL_OF_SEVERAL * deviation * AVERAGED.sqrt();
        // One pixel is enough for all around it.
        let outlier = of(Lane::Outlier) * POOLED as f32;
        let unrest = surprise(UNUSUAL).max(lasting).max(drift).max(outlier).max(0.0);
        let of_results = unrest.max(surprise(UNUSUAL_FOR_RESULTS));
        self.unrest_of_results = of_results.max(SUBSIDES * self.unrest_of_results);
        self.unrest = if self.readouts == 0 { 1.0 } else { unrest.max(SUBSIDES * self.unrest) };
        unrest
    }

    /// Takes a read-out that begins into the mean of read-outs, by precision: a step of a Kalman filter whose process
    /// noise is `unrest`, in l.
    fn take(&mut self, frame: &FrameReadings<'_>, reading: Reading, unrest: f32) {
        if !reading.begins {
            return;
        }
        let Reading { irradiance, exposure, saturated, .. } = reading;
        if self.readouts == 0 {
            if !saturated {
                (self.mean, self.variance) = (irradiance, frame.variance(irradiance, exposure));
                self.readouts = 1;
            }
            return;
        }
        let noise = frame.variance(self.mean, exposure);
        self.variance += unrest / slope_squared(self.mean);
        if saturated {
            return;
        }
        let gain = self.variance / (self.variance + noise);
        self.mean += gain * (irradiance - self.mean);
        self.variance *= 1.0 - gain;
        // What the mean has followed is no longer news.
        self.recent *= 1.0 - gain;
        self.readouts = self.readouts.saturating_add(1);
    }

    /// Takes the net's result `l` into the mean of results.
    fn average(&mut self, l: f32, learns: bool) {
        let error = self.net_error.max(NET_ERROR[0] * NET_ERROR[0]);
        let forgotten =
            if learns { 1.0 } else { self.unrest_of_results / (self.unrest_of_results + error / 4.0) };
        self.results = (self.results * (1.0 - forgotten) + 1.0).min(MOST_RESULTS);
        // To the bit the result itself where it is the only one.
        self.result = if self.results == 1.0 { l } else { self.result + (l - self.result) / self.results };
    }

    /// Decides how far the mean of read-outs is to be believed, and notes what that is decided by in the next frame.
    fn weigh(
        &mut self,
        frame: &FrameReadings<'_>,
        reading: Reading,
        learns: bool,
        pooled: &Lanes,
        lanes: &mut Lanes,
    ) {
        let of = |lane: Lane| pooled[lane as usize];
        let trusted =
            self.readouts >= 2 && !reading.saturated && !frame.may_saturate(self.mean, reading.exposure);
        let own = self.variance * slope_squared(self.mean);
        let beyond = self.result - tone(self.mean);
        let [least, most] = NET_ERROR.map(|error| error * error);
        lanes[Lane::Difference as usize] = if trusted { (beyond * beyond - own).min(most) } else { 0.0 };
        lanes[Lane::Trusted as usize] = f32::from(trusted);
        let doubt = (of(Lane::TestimonyNoise) / POOLED as f32).max(0.0).sqrt();
        let stale = (of(Lane::Testimony) - doubt).max(0.0);
        // What says that the memory is out of date is no error of the net.
        let changed = self.unrest + stale;
        let difference = of(Lane::Difference) / of(Lane::Trusted).max(1e-3);
        self.net_error += NEWEST_ERROR * (difference - changed.min(most) - self.net_error);
        let net = self.net_error.clamp(least, most);
        self.weight = if trusted && !learns { net / (net + own + changed) } else { 0.0 };
    }
}

//! What a camera's pixel values say about irradiance, and how much of that is noise.

use crate::Result;
use crate::cpu::inverse_response;
use crate::frame::Extent;
use crate::network::SATURATED;
use crate::sensor::{Calibration, Readouts, Recording, SensorError};

/// Entries of the table of variances, over the root of x/x_sat: finer where it is dark.
const LEVELS: usize = 1024;

/// A camera as read-outs of single pixels need it.
#[derive(Debug)]
pub struct Readings {
    calibration: Calibration,
    readouts: Readouts,
    /// σ² of x in (p·frames)², at x = x_sat·(i/(LEVELS − 1))².
    variance: Vec<f32>,
    /// x_sat, and the x from which on a pixel counts as saturated, in p·frames.
    saturation: f32,
    saturated: f32,
    /// Whether each pixel [y, x] never has a value.
    dead: Option<Vec<bool>>,
}

impl Readings {
    /// Shot and read noise (design §2) and rounding to counts, of a camera that states them.
    pub fn new(recording: &Recording, calibration: &Calibration, dead: Option<Vec<bool>>) -> Result<Self> {
        let info = &recording.info;
        let stated = info.full_well_e.filter(|e| *e > 0.0).zip(info.read_noise_e);
        let (full_well, read_noise) = stated.ok_or_else(|| {
            SensorError::Capture(
                "accumulating needs to know the noise: give full_well_e and read_noise_e in its capture.json"
                    .into(),
            )
        })?;
        let response = &recording.response;
        let saturation = response.saturation();
        let electrons = full_well / saturation;
        let count = 1.0 / (info.white_level - info.black_level);
        let variance = (0..LEVELS).map(|i| {
            let x = saturation * (i as f64 / (LEVELS - 1) as f64).powi(2);
            // A count is this much of x here.
            let y = response.value(x);
            let (below, above) = ((y - count).max(0.0), (y + count).min(1.0));
            let step = (response.exposure(above) - response.exposure(below)) * count / (above - below);
            ((x * electrons + read_noise * read_noise) / (electrons * electrons) + step * step / 12.0) as f32
        });
        Ok(Self {
            calibration: calibration.clone(),
            readouts: Readouts::new(&recording.sensor_pattern()),
            variance: variance.collect(),
            saturation: saturation as f32,
            saturated: response.exposure(SATURATED) as f32,
            dead,
        })
    }

    /// Frames after which the pattern repeats.
    pub fn period(&self) -> usize {
        self.calibration.period
    }

    /// What the frame at schedule time `t` shows. Rows of `measured`, pixel values y, are `stride` long.
    pub fn frame<'a>(
        &'a self,
        t: i64,
        measured: &'a [f32],
        stride: usize,
        extent: Extent,
    ) -> FrameReadings<'a> {
        FrameReadings { readings: self, t, measured, stride, extent }
    }

    /// σ² of x, in (p·frames)².
    fn variance(&self, x: f32) -> f32 {
        let level = (x.max(0.0) / self.saturation).sqrt() * (LEVELS - 1) as f32;
        self.variance[(level as usize).min(LEVELS - 1)]
    }
}

/// One frame of read-outs.
#[derive(Clone, Copy, Debug)]
pub struct FrameReadings<'a> {
    readings: &'a Readings,
    t: i64,
    measured: &'a [f32],
    stride: usize,
    extent: Extent,
}

/// One read-out of a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// Irradiance p.
    pub irradiance: f32,
    /// Exposure in frames.
    pub exposure: f32,
    /// Whether it begins to show in this frame; never of a dead pixel.
    pub begins: bool,
    /// Whether the pixel saturates.
    pub saturated: bool,
}

impl<'a> FrameReadings<'a> {
    /// The read-outs along row `y`.
    pub fn row(self, y: usize) -> impl Iterator<Item = Reading> + use<'a> {
        let Self { readings, t, measured, stride, extent } = self;
        let exposures = readings.calibration.row(t, y).iter().cycle();
        let begins = readings.readouts.beginning_in_row(t, y).iter().cycle();
        let table = readings.calibration.inverse_response();
        let dead = readings.dead.as_ref().map(|dead| &dead[y * extent.width..][..extent.width]);
        measured[y * stride..][..extent.width].iter().zip(exposures).zip(begins).enumerate().map(
            move |(column, ((&value, &exposure), begins))| {
                let x = inverse_response(table, value);
                Reading {
                    irradiance: x / exposure,
                    exposure,
                    begins: begins.is_some() && !dead.is_some_and(|dead| dead[column]),
                    saturated: x >= readings.saturated,
                }
            },
        )
    }

    /// σ² of the irradiance that a read-out of `exposure` frames measures, where it is `irradiance`.
    pub fn variance(&self, irradiance: f32, exposure: f32) -> f32 {
        self.readings.variance(irradiance * exposure) / (exposure * exposure)
    }

    /// Whether noise could saturate a pixel of this exposure: then those of its read-outs that do not saturate are too dark in
    /// the mean.
    pub fn may_saturate(&self, irradiance: f32, exposure: f32) -> bool {
        let x = irradiance * exposure;
        x + 2.0 * self.readings.variance(x).sqrt() >= self.readings.saturated
    }
}

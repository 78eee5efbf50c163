//! Models of cameras to simulate: noise, levels, response and frame period, whatever the pattern.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Form, Noise, Pattern, Sampler, SensorError};
use crate::{At, Result};

/// A camera to simulate, apart from its pattern. What a JSON file leaves out is that of the `default` one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraModel {
    /// Electrons at y = 1; `None` (JSON: null): no noise at all.
    pub full_well_e: Option<f64>,
    /// Read noise in electrons rms.
    pub read_noise_e: f64,
    /// Count at y = 0, the pedestal that the converter adds. At 0 it cuts noise off at black; above, counts keep it.
    pub black_level: u16,
    /// Bits per pixel value, 1 to 16.
    pub bit_depth: u32,
    /// Duration of a frame in milliseconds.
    pub frame_period_ms: f64,
    /// From exposure to pixel value.
    pub response: Form,
}

impl Default for CameraModel {
    /// The paper's sensor (design §2).
    fn default() -> Self {
        let Noise { full_well_e, read_noise_e } = Noise::default();
        Self {
            full_well_e: Some(full_well_e),
            read_noise_e,
            black_level: 0,
            bit_depth: 10,
            frame_period_ms: 1.0,
            response: Form::Linear,
        }
    }
}

impl CameraModel {
    /// Names of the built-in cameras.
    pub const NAMES: [&str; 2] = ["default", "pe-cmos"];

    /// A built-in camera.
    pub fn built_in(name: &str) -> Result<Self, SensorError> {
        match name {
            "default" => Ok(Self::default()),
            // 36 dB a pixel, and a pedestal of more than 3.5 deviations of the read noise.
            "pe-cmos" => Ok(Self { full_well_e: Some(200.0), black_level: 48, ..Self::default() }),
            _ => Err(SensorError::Capture(format!(
                "no built-in camera '{name}'; there are {}, or name a JSON file",
                Self::NAMES.join(", ")
            ))),
        }
    }

    /// A built-in camera by name, or one from a JSON file where `name` ends in `.json`.
    pub fn load(name: &str) -> Result<Self> {
        let path = Path::new(name);
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json")) {
            let text = super::text::read_text(path).at(path)?;
            return serde_json::from_str(&text).map_err(|e| SensorError::Capture(e.to_string())).at(path);
        }
        Ok(Self::built_in(name)?)
    }

    /// The simulator of this camera with a pattern.
    pub fn sampler(&self, pattern: Pattern) -> Result<Sampler, SensorError> {
        let mut sampler = Sampler::new(pattern, self.response.clone())?;
        sampler.noise = match self.full_well_e {
            Some(full_well_e) => Noise { full_well_e, read_noise_e: self.read_noise_e },
            None => Noise::NONE,
        };
        sampler.black_level = self.black_level;
        sampler.bit_depth = self.bit_depth;
        sampler.frame_period_ms = self.frame_period_ms;
        Ok(sampler)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::video::{Counts, Video};

    fn pattern() -> Pattern {
        Pattern::built_in("mpve-1-4").unwrap()
    }

    /// In the dark, counts scatter about the pedestal by the read noise, which is not cut off: 2.67 e⁻ of the 200 that
    /// reach from count 48 to 1023.
    #[test]
    fn dark_counts_of_pe_cmos_scatter_about_its_pedestal() {
        let sampler = CameraModel::built_in("pe-cmos").unwrap().sampler(pattern()).unwrap();
        let capture = sampler.sample(&Video::black(16, 128, 128)).unwrap();
        assert_eq!((capture.info.black_level, capture.info.white_level), (48.0, 1023.0));
        assert_eq!((capture.info.full_well_e, capture.info.read_noise_e), (Some(200.0), Some(2.67)));
        // Columns of exposure 2 read out every other frame.
        let Counts::U16(counts) = &capture.counts else { panic!("the simulator writes 16 bits") };
        let value = |t: usize, i: usize| f64::from(counts[t * 128 * 128 + i]) - 48.0;
        let dark: Vec<f64> = (1..16)
            .step_by(2)
            .flat_map(|t| (0..64).flat_map(move |y| (0..32).map(move |x| (t, 2 * y * 128 + 4 * x))))
            .map(|(t, i)| value(t, i))
            .collect();
        let n = dark.len() as f64;
        let mean = dark.iter().sum::<f64>() / n;
        let deviation = (dark.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        let expected = 2.67 * 975.0 / 200.0;
        // Four standard errors of each; that 1 in 10⁴ values are cut off at count 0 changes less.
        assert!(mean.abs() < 4.0 * expected / n.sqrt(), "{mean} counts");
        assert!((deviation / expected - 1.0).abs() < 4.0 / (2.0 * n).sqrt(), "{deviation} for {expected}");
    }

    /// Light comes out the same whatever the levels; an error of the black level adds to them.
    #[test]
    fn a_pedestal_changes_no_pixel_value() {
        let mut camera = CameraModel { full_well_e: None, bit_depth: 16, ..CameraModel::default() };
        let video = Video { frames: 16, height: 2, width: 4, data: vec![0.1; 128] };
        for (black_level, form) in [(0, Form::Linear), (3000, Form::Linear), (3000, Form::Gamma(2.2))] {
            (camera.black_level, camera.response) = (black_level, form);
            let sampler = camera.sampler(pattern()).unwrap();
            let values = sampler.sample(&video).unwrap().measurement();
            for (x, exposure) in [(0, 2.0), (1, 4.0), (2, 8.0), (3, 8.0)] {
                let expected = sampler.response().value(0.1 * exposure) as f32;
                assert!((values.frame(9)[x] - expected).abs() < 2e-5, "{black_level}: column {x}");
            }
        }
    }

    #[test]
    fn files_say_what_differs_from_the_default() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.json");
        let load = |text: &str| {
            std::fs::write(&path, text).unwrap();
            CameraModel::load(path.to_str().unwrap())
        };
        let mine = load(
            r#"{"full_well_e": 5e4, "bit_depth": 12, "frame_period_ms": 0.25, "response": {"gamma": 2.2}}"#,
        );
        let expected = CameraModel {
            full_well_e: Some(5e4),
            bit_depth: 12,
            frame_period_ms: 0.25,
            response: Form::Gamma(2.2),
            ..CameraModel::default()
        };
        assert_eq!(mine.unwrap(), expected);
        assert_eq!(load(r#"{"full_well_e": null}"#).unwrap().full_well_e, None);
        let refusal = load(r#"{"full_wel_e": 200}"#).unwrap_err().to_string();
        assert!(refusal.contains("mine.json") && refusal.contains("full_wel_e"), "{refusal}");
        let refusal = CameraModel::load("what").unwrap_err().to_string();
        assert!(refusal.contains("pe-cmos"), "{refusal}");
        for name in CameraModel::NAMES {
            CameraModel::load(name).unwrap().sampler(pattern()).unwrap();
        }
    }

    /// What no capture can say is refused before anything is made.
    #[test]
    fn cameras_that_cannot_be_are_refused() {
        let error = |change: &dyn Fn(&mut Sampler)| {
            let mut sampler = CameraModel::default().sampler(pattern()).unwrap();
            change(&mut sampler);
            sampler.sample(&Video::black(3, 2, 4)).unwrap_err().to_string()
        };
        assert!(error(&|sampler| sampler.black_level = 1023).contains("black level 1023"));
        assert!(error(&|sampler| sampler.frame_period_ms = 0.0).contains("frame period"));
        for bits in [0, 17, 33, u32::MAX] {
            assert!(error(&|sampler| sampler.bit_depth = bits).contains("bit depth"));
        }
        for start in [i64::MAX, i64::MIN, i64::MAX - 1, 1 << 41] {
            assert!(error(&|sampler| sampler.schedule_start = start).contains("schedule start"), "{start}");
        }
    }
}

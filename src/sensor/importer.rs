//! Real recordings become captures, and checks for the most common mistakes.

use std::path::{Path, PathBuf};

use super::fit_response::{self, ResponseFit, fit_response};
use super::{Capture, CaptureFile, CaptureInfo, Recording};
use crate::Result;
use crate::math::spread;
use crate::video::begin_counts;
use crate::video::check_free;

/// Pixel values between which the exposure ratio is judged: above noise and black-level error, below the knee of
/// saturation.
const JUDGED: std::ops::Range<f32> = 0.04..0.9;

/// Largest change over time, relative to the mean, up to which a pixel counts as static.
const STATIC: f32 = 0.1;

/// Frames that are looked at: static parts stay static.
const LOOKS: usize = 16;

/// Least number of pixel pairs for a verdict.
const ENOUGH: usize = 64;

/// Least part of white that the brightest pixels of a recording are expected to reach.
const BRIGHT: f32 = 0.125;

/// How a recording is imported.
#[derive(Clone, Copy, Debug, Default)]
pub struct Importing {
    /// Whether response and black level are fitted to it (see [`fit_response`]).
    pub fit_response: bool,
    /// Whether files that are there are replaced.
    pub overwrite: bool,
}

/// What became of a recording.
#[derive(Debug)]
pub struct Imported {
    /// What is known of the capture that was written, without its frames.
    pub recording: Recording,
    /// Number of frames.
    pub frames: usize,
    /// Its files: counts and description.
    pub files: [PathBuf; 2],
    /// The fitted response, if one was asked for.
    pub fit: Option<ResponseFit>,
    /// What black and white level seem to be wrong with.
    pub levels: Option<String>,
    /// How static pixels scale with their exposure, where that could be judged.
    pub exposure: Option<RatioCheck>,
}

/// Writes a recording as a capture into `folder`: frame by frame, each as the exposures that cover it.
///
/// Memory does not depend on the length of the recording, none of whose files can be written over.
pub fn import(mut file: CaptureFile, folder: &Path, how: Importing) -> Result<Imported> {
    let files = Capture::files(folder);
    for target in &files {
        check_free(target, how.overwrite)?;
        file.check_not_itself(target)?;
    }
    let frames = file.frames;
    let mut described = file.covering_excerpt(&spread(frames, fit_response::LOOKS).collect::<Vec<_>>())?;
    let fit = if how.fit_response { Some(fit_response(&described)?) } else { None };
    if let Some(fit) = &fit {
        described = described.with_response(fit)?;
    }
    let few = file.covering_excerpt(&spread(frames, LOOKS).collect::<Vec<_>>())?;
    let exposure =
        check_exposure_ratio(&Capture { frames: few.frames, counts: few.counts, ..described.clone() });

    let recording = described.recording();
    let mut writer = begin_counts(&files[0], [frames, recording.height, recording.width], file.bits())?;
    let (mut levels, mut values) = (Levels::default(), vec![0.0; recording.extent().pixels()]);
    let mut covering = file.into_covering_counts();
    while let Some(counts) = covering.next()? {
        recording.info.pixel_values(&counts, None, &mut values, None);
        levels.add(&values);
        writer.push(&counts)?;
    }
    writer.finish()?;
    described.write_description(&files[1])?;
    Ok(Imported { levels: levels.warning(&recording.info), recording, frames, files, fit, exposure })
}

/// How the values of static pixels scale with their exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RatioCheck {
    /// Median of ln(x_long/x_short)/ln(e_long/e_short) over pairs of neighbouring pixels: 1 if the response is
    /// right.
    pub exponent: f64,
    /// Pairs that were judged.
    pub pairs: usize,
}

impl RatioCheck {
    /// What to tell the user, if the exponent is off by more than scene and noise explain.
    pub fn warning(&self) -> Option<String> {
        let off = (self.exponent - 1.0).abs() > 0.15;
        off.then(|| {
            format!(
                "static pixels do not scale with their exposure: doubling it multiplies the value by {:.2} instead \
                 of 2 (median of {} pairs). Is the recording gamma-encoded, or are response, black level or \
                 schedule start wrong?",
                self.exponent.exp2(),
                self.pairs
            )
        })
    }
}

/// What black and white level seem to be wrong with: no pixel gets far from black, or most are at white.
pub fn check_levels(capture: &Capture) -> Option<String> {
    let (mut levels, mut values) = (Levels::default(), vec![0.0; capture.height * capture.width]);
    for t in 0..capture.frames {
        capture.pixel_values(t, &mut values);
        levels.add(&values);
    }
    levels.warning(&capture.info)
}

/// What pixel values say of black and white level.
#[derive(Clone, Copy, Debug, Default)]
struct Levels {
    /// The largest value.
    most: f32,
    /// Values at white or above.
    white: usize,
    /// All values.
    all: usize,
}

impl Levels {
    /// Looks at the pixel values of a frame.
    fn add(&mut self, values: &[f32]) {
        self.most = values.iter().copied().fold(self.most, f32::max);
        self.white += values.iter().filter(|y| **y >= 1.0).count();
        self.all += values.len();
    }

    fn warning(self, info: &CaptureInfo) -> Option<String> {
        let Self { most, white, all } = self;
        let levels =
            format!("are black level {} and white level {} right?", info.black_level, info.white_level);
        if most < BRIGHT {
            Some(format!("no pixel gets beyond {:.1}% of white: {levels}", 100.0 * most))
        } else if 2 * white > all {
            Some(format!(
                "{:.0}% of the pixels are at white or above: {levels}",
                100.0 * white as f64 / all as f64
            ))
        } else {
            None
        }
    }
}

/// Compares neighbouring static pixels of different exposure; `None` where there are too few of them.
pub fn check_exposure_ratio(capture: &Capture) -> Option<RatioCheck> {
    let Capture { frames, height, width, .. } = *capture;
    let len = height * width;
    let looks = spread(frames, LOOKS);
    let count = looks.len() as f32;
    let mut values = vec![0.0; len];
    let mut range = vec![(f32::INFINITY, f32::NEG_INFINITY, 0.0f32); len];
    for t in looks {
        capture.pixel_values(t, &mut values);
        for (range, &y) in range.iter_mut().zip(&values) {
            *range = (range.0.min(y), range.1.max(y), range.2 + y / count);
        }
    }
    // Mean exposure value and exposure of a static, well exposed pixel.
    let judged = |y: usize, x: usize| {
        let (least, most, mean) = range[y * width + x];
        let exposure = capture.pattern.schedule(y, x).exposure()?;
        let steady = most - least < STATIC * mean;
        let well_exposed = JUDGED.contains(&least) && JUDGED.contains(&most);
        (steady && well_exposed).then(|| (capture.response.exposure(f64::from(mean)), exposure as f64))
    };
    let mut exponents = Vec::new();
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let Some((value, exposure)) = judged(y, x) else { continue };
        for (ny, nx) in [(y, x + 1), (y + 1, x)] {
            if ny >= height || nx >= width {
                continue;
            }
            match judged(ny, nx) {
                Some((other, e)) if e != exposure => {
                    exponents.push((other / value).ln() / (e / exposure).ln());
                }
                _ => {}
            }
        }
    }
    if exponents.len() < ENOUGH {
        return None;
    }
    let middle = exponents.len() / 2;
    let exponent = *exponents.select_nth_unstable_by(middle, f64::total_cmp).1;
    Some(RatioCheck { exponent, pairs: exponents.len() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Form, Pattern, Sampler};
    use crate::video::Video;

    fn camera() -> Sampler {
        Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap()
    }

    /// A static scene with some texture.
    fn scene() -> Video {
        let frame: Vec<f32> = (0..32 * 32).map(|i| 0.06 + 0.02 * (i as f32 * 0.05).sin()).collect();
        Video { frames: 32, height: 32, width: 32, data: frame.repeat(32) }
    }

    #[test]
    fn linear_recordings_pass_and_gamma_encoded_ones_are_named() {
        let mut capture = camera().sample(&scene()).unwrap();
        let check = check_exposure_ratio(&capture).unwrap();
        assert!((check.exponent - 1.0).abs() < 0.03 && check.warning().is_none(), "{check:?}");
        // The same scene through a gamma that nobody told us of.
        let sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Gamma(2.2)).unwrap();
        capture.counts = sampler.sample(&scene()).unwrap().counts;
        let check = check_exposure_ratio(&capture).unwrap();
        assert!(check.warning().is_some(), "{check:?}");
    }

    #[test]
    fn wrong_levels_are_named() {
        let mut capture = camera().sample(&scene()).unwrap();
        assert_eq!(check_levels(&capture), None);
        capture.info.white_level = 65535.0;
        assert!(check_levels(&capture).unwrap().contains("white level 65535"));
        capture.info.white_level = 60.0;
        assert!(check_levels(&capture).unwrap().contains("at white or above"));
    }
}

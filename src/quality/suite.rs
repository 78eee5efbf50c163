//! The quality benchmark: the same deterministic clips for every method, from any folder of panoramas.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Serialize;

use super::{Measures, compare};
use crate::Result;
use crate::baseline::box_filter;
use crate::scene::{Moves, Panorama, Rendering, Speed, render, suite_clip};
use crate::sensor::{Capture, Form, Noise, Pattern, Sampler};
use crate::synth::Synthesizer;
use crate::video::Video;

/// How bright a clip is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Light {
    /// The sensor's full well at y = 1.
    Normal,
    /// A sixteenth of the photons.
    Low,
}

impl Light {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Normal, Self::Low];

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Low => "low",
        }
    }

    fn noise(self) -> Noise {
        let normal = Noise::default();
        match self {
            Self::Normal => normal,
            Self::Low => Noise { full_well_e: normal.full_well_e / 16.0, ..normal },
        }
    }
}

/// What the suite consists of.
#[derive(Clone, Debug)]
pub struct Suite {
    /// Pattern of the camera.
    pub pattern: Pattern,
    /// Frames per clip.
    pub frames: usize,
    /// Rows and columns.
    pub extent: [usize; 2],
    /// Seed of the clips and of the noise.
    pub seed: u64,
}

/// A way from capture to video.
pub enum Method {
    /// The box filter.
    Box,
    /// A net.
    Net(Box<Synthesizer>),
}

impl Method {
    fn video(&mut self, capture: &Capture) -> Result<Video> {
        match self {
            Self::Box => {
                Ok(box_filter(&capture.measurement(), &capture.calibration(), capture.info.schedule_start))
            }
            Self::Net(synthesizer) => Ok(synthesizer.video(capture)?.0),
        }
    }
}

/// Mean measures of one method.
#[derive(Clone, Debug, Serialize)]
pub struct Scores {
    /// Over all clips.
    pub overall: Measures,
    /// By class, such as `fast-pan-low`.
    pub classes: BTreeMap<String, Measures>,
}

/// What the suite found.
#[derive(Clone, Debug, Serialize)]
pub struct SuiteReport {
    /// Number of clips.
    pub clips: usize,
    /// Scores by name of the method.
    pub methods: BTreeMap<String, Scores>,
}

impl Suite {
    /// Clips that a folder of `panoramas` gives.
    pub fn clips(panoramas: usize) -> usize {
        panoramas * Speed::ALL.len() * Moves::ALL.len() * Light::ALL.len()
    }

    /// Runs all methods on all clips; `progress` hears of every finished clip. The same panoramas and seed give the
    /// same clips on any machine and any number of threads.
    pub fn run(
        &self,
        panoramas: &[Arc<Panorama>],
        methods: &mut [(String, Method)],
        mut progress: impl FnMut(usize),
    ) -> Result<SuiteReport> {
        let mut found: BTreeMap<String, BTreeMap<String, Vec<Measures>>> = BTreeMap::new();
        let mut clips = 0;
        for index in 0..panoramas.len() {
            for (s, speed) in Speed::ALL.into_iter().enumerate() {
                for (m, moves) in Moves::ALL.into_iter().enumerate() {
                    let seed = self.seed.wrapping_add(((index * 8 + s) * 8 + m) as u64 * 7919);
                    let truth = self.truth(panoramas, index, (speed, moves), seed);
                    for light in Light::ALL {
                        let capture = self.capture(&truth, light, seed)?;
                        let class = format!("{}-{}-{}", speed.name(), moves.name(), light.name());
                        for (name, method) in &mut *methods {
                            let measures = compare(&truth, &method.video(&capture)?)?;
                            found
                                .entry(name.clone())
                                .or_default()
                                .entry(class.clone())
                                .or_default()
                                .push(measures);
                        }
                        clips += 1;
                        progress(clips);
                    }
                }
            }
        }
        let methods = found
            .into_iter()
            .map(|(name, classes)| {
                let overall = mean(&classes.values().flatten().copied().collect::<Vec<_>>());
                let classes = classes.iter().map(|(class, all)| (class.clone(), mean(all))).collect();
                (name, Scores { overall, classes })
            })
            .collect();
        Ok(SuiteReport { clips, methods })
    }

    fn truth(&self, panoramas: &[Arc<Panorama>], index: usize, class: (Speed, Moves), seed: u64) -> Video {
        let Self { frames, extent, .. } = *self;
        let scene = suite_clip(panoramas, index, class, extent, frames, seed);
        let [height, width] = extent;
        let mut truth =
            render(&scene, Rendering { frames, height, width, instants: 8, positions: 1, seed }, || ());
        truth.normalise();
        truth
    }

    fn capture(&self, truth: &Video, light: Light, seed: u64) -> Result<Capture> {
        let mut sampler = Sampler::new(self.pattern.clone(), Form::Linear)?;
        sampler.noise = light.noise();
        sampler.seed = seed;
        sampler.sample(truth)
    }
}

/// Mean of each measure; of SSIM over the clips that have one.
fn mean(all: &[Measures]) -> Measures {
    let average = |value: &dyn Fn(&Measures) -> Option<f64>| {
        let values: Vec<f64> = all.iter().filter_map(value).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    Measures {
        psnr: average(&|m| Some(m.psnr)).unwrap_or(f64::NAN),
        psnr_mu: average(&|m| Some(m.psnr_mu)).unwrap_or(f64::NAN),
        ssim_mu: average(&|m| m.ssim_mu),
    }
}

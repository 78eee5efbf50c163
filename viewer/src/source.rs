//! What is looked at: a scene, a panorama, a capture or a video, and what each of them is opened as.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::{Map, Value};

use crate::camera::LiveCamera;
use pix2hdr::scene::{Moves, Panorama, Speed, procedural, suite_clip};
use pix2hdr::sensor::{Capture, CaptureFile, Finding, Recording, Sampler};
use pix2hdr::video::{self, Video};
use pix2hdr::{At, Error, Result};

/// Frames within which a panorama's movers pass through the picture.
const PASSAGE: usize = 512;

/// What the user wants to see.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceName {
    /// The name of a built-in scene.
    Scene(String),
    /// A file or folder: a capture, a video, or a panorama.
    Path(PathBuf),
}

impl SourceName {
    /// A source as a user writes it: the name of a built-in scene, or else a path.
    pub fn parse(text: &str) -> Self {
        if procedural::NAMES.contains(&text) { Self::Scene(text.to_owned()) } else { Self::Path(text.into()) }
    }
}

impl fmt::Display for SourceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scene(name) => f.write_str(name),
            Self::Path(path) => path.display().fmt(f),
        }
    }
}

/// How sources are opened.
#[derive(Clone, Debug)]
pub struct Opening {
    /// The simulated camera, for scenes, panoramas and videos.
    pub sampler: Sampler,
    /// Rows and columns of scenes and clips of panoramas.
    pub extent: [usize; 2],
    /// Seed of scenes and clips.
    pub seed: u64,
    /// Speed of clips of panoramas.
    pub speed: Speed,
    /// What replaces keys of a capture's JSON file.
    pub keys: Map<String, Value>,
    /// Ground truth of a capture.
    pub truth: Option<PathBuf>,
    /// Whether a video is shown as it is, instead of being sampled and synthesised.
    pub plain: bool,
}

/// An open source.
pub enum Opened {
    /// A simulated camera.
    Live(LiveCamera),
    /// A capture on disk, with its ground truth if there is one.
    File {
        /// What is known of it.
        recording: Box<Recording>,
        /// Number of frames.
        frames: usize,
        /// Where it is.
        path: PathBuf,
        /// Ground truth.
        truth: Option<Arc<Video>>,
        /// What contradicts its description.
        findings: Vec<Finding>,
    },
    /// A video, sampled by the simulated camera.
    Sampled(Box<Capture>, Arc<Video>),
    /// A video as it is.
    Plain(Arc<Video>),
}

impl Opened {
    /// Opens what is asked for.
    pub fn open(name: &SourceName, how: &Opening) -> Result<Self> {
        let [height, width] = how.extent;
        let live = |scene| LiveCamera::new(scene, how.sampler.clone(), how.extent, how.seed).map(Self::Live);
        match name {
            SourceName::Scene(name) => {
                live(procedural::by_name(name, height, width, how.seed).ok_or_else(|| {
                    Error::Usage(format!("no scene '{name}'; there are {}", procedural::NAMES.join(", ")))
                })?)
            }
            SourceName::Path(path) if !path.exists() => Err(Error::Usage(format!(
                "neither a file nor a built-in scene; scenes are {}",
                procedural::NAMES.join(", ")
            )))
            .at(path),
            SourceName::Path(path) if CaptureFile::is_at(path) => {
                let mut file = CaptureFile::open(path, &how.keys)?;
                let findings = file.first_look()?.findings();
                let [height, width] = [file.recording.height, file.recording.width];
                let truth = how.truth.as_ref().map(|path| truth(path, [file.frames, height, width]));
                Ok(Self::File {
                    recording: Box::new(file.recording),
                    frames: file.frames,
                    path: path.clone(),
                    truth: truth.transpose()?,
                    findings,
                })
            }
            SourceName::Path(path) => {
                let mut video = video::read(path)?;
                if video.frames == 1 && video.width == 2 * video.height && !how.plain {
                    let panoramas = [Arc::new(Panorama::read(path)?)];
                    let what = (how.speed, Moves::Both);
                    return live(Box::new(suite_clip(&panoramas, 0, what, how.extent, PASSAGE, how.seed)));
                }
                if how.plain {
                    return Ok(Self::Plain(Arc::new(video)));
                }
                let anchor = if video.data.iter().any(|p| *p > 1.0) { video.normalise() } else { 1.0 };
                let mut capture = how.sampler.sample(&video).at(path)?;
                capture.info.anchor = Some(f64::from(anchor));
                Ok(Self::Sampled(Box::new(capture), Arc::new(video)))
            }
        }
    }

    /// Rows and columns.
    pub fn extent(&self) -> Result<[usize; 2]> {
        Ok(match self {
            Self::Plain(video) => [video.height, video.width],
            other => {
                let recording = other.recording()?;
                [recording.height, recording.width]
            }
        })
    }

    /// What is known of the camera. A plain video has none.
    pub fn recording(&self) -> Result<Recording> {
        match self {
            Self::Live(camera) => camera.recording(0),
            Self::File { recording, .. } => Ok((**recording).clone()),
            Self::Sampled(capture, _) => Ok(capture.recording()),
            Self::Plain(_) => Err(Error::Usage("a plain video has no camera".into())),
        }
    }

    /// What of it contradicts its description.
    pub fn findings(&self) -> &[Finding] {
        match self {
            Self::File { findings, .. } => findings,
            Self::Live(_) | Self::Sampled(..) | Self::Plain(_) => &[],
        }
    }

    /// Number of frames; `None` for a live source.
    pub fn frames(&self) -> Option<usize> {
        match self {
            Self::Live(_) => None,
            Self::File { frames, .. } => Some(*frames),
            Self::Sampled(capture, _) => Some(capture.frames),
            Self::Plain(video) => Some(video.frames),
        }
    }
}

/// The ground truth of a capture.
fn truth(path: &Path, extents: [usize; 3]) -> Result<Arc<Video>> {
    let truth = video::read(path)?;
    if [truth.frames, truth.height, truth.width] != extents {
        let Video { frames, height, width, .. } = truth;
        let [t, y, x] = extents;
        let problem =
            format!("the truth of {frames}×{height}×{width} has not the size of the capture, {t}×{y}×{x}");
        return Err(Error::Usage(problem)).at(path);
    }
    Ok(Arc::new(truth))
}

//! How the engine is.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use crate::camera::POLICY;
use crate::frame::Frame;
use pix2hdr::sensor::Recording;

/// Frames of which the times are kept.
pub const HISTORY: usize = 240;

/// What is known of the source.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct About {
    /// Its name.
    pub name: String,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Number of frames; `None` for a live source.
    pub frames: Option<usize>,
    /// Duration of a frame.
    pub period_ms: f64,
    /// Name of the pattern, if there is a camera.
    pub pattern: Option<String>,
    /// What a live camera costs: its longest exposure in frames, and those of a result's window.
    pub latency: usize,
}

/// What the engine is doing.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Phase {
    /// It opens a source, or compiles shaders.
    #[default]
    Preparing,
    /// It synthesises.
    Running,
    /// All frames are there.
    Finished,
    /// It cannot, for this reason.
    Failed(String),
}

/// How the engine is.
#[derive(Clone, Debug, Default)]
pub struct Status {
    /// What it is doing.
    pub phase: Phase,
    /// What it does it with, in words; empty before that is known.
    pub executor: String,
    /// What is looked at.
    pub about: About,
    /// What is known of the camera. A plain video has none.
    pub recording: Option<Arc<Recording>>,
    /// What the user should know, besides failures.
    pub notice: Option<String>,
    /// Milliseconds of the net per frame: the last ones, oldest first.
    pub inference_ms: VecDeque<f32>,
    /// Part of the cells that was computed, frame by frame as above; 1 where nothing may be skipped.
    pub computed: VecDeque<f32>,
    /// When the last frames were delivered.
    pub delivered: VecDeque<Instant>,
    /// Frames that a live camera dropped.
    pub dropped: u64,
    /// Frames delivered since the source was opened.
    pub frames: u64,
    /// Frames of a window.
    pub hop: usize,
    /// What a live camera has delivered, until the first result is there.
    pub arriving: VecDeque<Arc<Frame>>,
}

impl Status {
    /// Frames delivered per second, over the last five seconds: they come in bursts, a window at a time.
    pub fn frames_per_s(&self, now: Instant) -> f64 {
        let age = |t: &Instant| now.saturating_duration_since(*t).as_secs_f64();
        let span = self.delivered.front().map_or(5.0, age).clamp(1.0, 5.0);
        self.delivered.iter().filter(|t| age(t) <= span).count() as f64 / span
    }

    /// The frame that a live camera, which has exposed so many, shows before there is a result.
    pub fn preview(&self, exposed: f64) -> Option<&Arc<Frame>> {
        let number = (exposed as usize).saturating_sub(POLICY.head_start());
        self.arriving.iter().rfind(|frame| frame.number <= number).or(self.arriving.front())
    }

    /// Median milliseconds per frame of the last ones.
    pub fn median_ms(&self) -> Option<f32> {
        let mut times: Vec<f32> = self.inference_ms.iter().copied().collect();
        times.sort_unstable_by(f32::total_cmp);
        times.get(times.len() / 2).copied()
    }

    /// Counts a frame that is delivered.
    pub(super) fn add(&mut self, frame: &Frame) {
        fn keep<T>(values: &mut VecDeque<T>, value: T, most: usize) {
            if values.len() == most {
                values.pop_front();
            }
            values.push_back(value);
        }
        keep(&mut self.inference_ms, 1e3 * frame.inference.as_secs_f32(), HISTORY);
        keep(&mut self.computed, frame.computed.as_ref().map_or(1.0, |c| c.fraction() as f32), HISTORY);
        // Two seconds at the highest rates that are of use.
        keep(&mut self.delivered, Instant::now(), 4096);
        self.frames += 1;
        self.arriving.clear();
    }
}

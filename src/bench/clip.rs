//! What is synthesised in a benchmark: a ground truth, and a capture of it.

use crate::Result;
use crate::baseline::box_filter;
use crate::frame::Frame;
use crate::network::Window;
use crate::quality::compare;
use crate::sensor::{Calibration, Capture, Form, Pattern, Sampler};
use crate::synth::windows;
use crate::video::Video;

/// A ground truth with a simulated capture of it.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Name of the scene.
    pub scene: String,
    /// Irradiance.
    pub truth: Video,
    /// What the camera delivers.
    pub capture: Capture,
    /// PSNR-µ of the box filter's result in dB.
    pub box_psnr_mu_db: f64,
}

impl Clip {
    /// Captures `truth` with the default camera of `pattern`.
    pub fn new(scene: &str, truth: Video, pattern: Pattern, seed: u64) -> Result<Self> {
        let mut sampler = Sampler::new(pattern, Form::Linear)?;
        sampler.seed = seed;
        let capture = sampler.sample(&truth)?;
        let start = capture.info.schedule_start;
        let filtered = box_filter(&capture.measurement(), &capture.calibration(), start);
        let box_psnr_mu_db = compare(&truth, &filtered)?.psnr_mu;
        Ok(Self { scene: scene.to_owned(), truth, capture, box_psnr_mu_db })
    }

    /// Rows and columns.
    pub fn extent(&self) -> [usize; 2] {
        [self.capture.height, self.capture.width]
    }

    /// Number of the last window that gives frames of the clip only, or of the first one if there is none.
    pub fn last_window(&self, window: Window) -> i64 {
        let start = self.capture.info.schedule_start;
        let end = start + self.capture.frames as i64;
        let first = windows::covering(window, start, self.capture.frames).start;
        (end.div_euclid(window.hop as i64) - 1).max(first)
    }

    /// The pixel values [t, y, x] that window `k` sees, extended to `wanted` rows and columns.
    pub fn window(&self, window: Window, k: i64, calibration: &Calibration, wanted: [usize; 2]) -> Video {
        let mut seen = Video::black(window.frames, wanted[0], wanted[1]);
        for (t, time) in windows::seen(window, k).enumerate() {
            let start = self.capture.info.schedule_start;
            let index = windows::stand_in(calibration, start, self.capture.frames, time);
            let mut values = vec![0.0; self.capture.height * self.capture.width];
            self.capture.pixel_values(index, &mut values);
            let frame = Frame::new(self.extent().into(), time, values);
            seen.frame_mut(t).copy_from_slice(windows::padded(frame, calibration, wanted.into()).values());
        }
        seen
    }
}

/// Rows and columns from (`y`, `x`) on of all frames.
pub(super) fn crop(video: &Video, [y, x]: [usize; 2], [height, width]: [usize; 2]) -> Video {
    let mut cropped = Vec::with_capacity(video.frames * height * width);
    for t in 0..video.frames {
        for row in y..y + height {
            cropped.extend_from_slice(&video.frame(t)[row * video.width + x..][..width]);
        }
    }
    Video { frames: video.frames, height, width, data: cropped }
}

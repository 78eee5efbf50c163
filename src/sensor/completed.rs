//! Recordings with gaps: frames that say when they were recorded, by number or time stamp.
//!
//! A frame that is missing is put together from those around it: a pixel has the count of a frame that the same read-out
//! covers. Where there is none, the read-out is missing, and the pixel keeps its last count, as [`Defects`](super::Defects)
//! do where no neighbour has a value.

use std::path::Path;

use super::{CaptureInfo, Pattern, Recording, Schedule, SensorError};
use crate::Result;
use crate::video::{Counts, ReadCounts};

/// How far a time stamp may be from a whole number of frame periods, in periods.
const JITTER: f64 = 0.25;

/// When each of so many frames was recorded, in frames behind the first one; nothing if the description does not say.
pub fn frame_times(info: &CaptureInfo, frames: usize, folder: Option<&Path>) -> Result<Option<Vec<usize>>> {
    let (given, period, what) = match (&info.frame_numbers, &info.time_stamps_ms) {
        (None, None) => return Ok(None),
        (Some(numbers), None) => (numbers, 1.0, "frame number"),
        (None, Some(stamps)) => (stamps, info.frame_period_ms, "time stamp"),
        (Some(_), Some(_)) => {
            let problem = "frame_numbers and time_stamps_ms say the same: keep one of them";
            return Err(SensorError::Capture(problem.into()).into());
        }
    };
    let numbers = given.numbers(folder)?;
    let fail = |problem: String| Err(SensorError::Capture(problem).into());
    if numbers.len() != frames {
        return fail(format!("{} {what}s for {frames} frames", numbers.len()));
    }
    let mut times: Vec<usize> = Vec::with_capacity(frames);
    for (frame, number) in numbers.iter().enumerate() {
        let time = (number - numbers[0]) / period;
        if (time - time.round()).abs() > JITTER {
            return fail(format!(
                "the {what} of frame {frame}, {number}, is no multiple of the frame period"
            ));
        }
        if times.last().is_some_and(|&last| time.round() <= last as f64) || !time.is_finite() {
            return fail(format!(
                "the {what} of frame {frame}, {number}, does not come after the one before"
            ));
        }
        // A bound on what a hostile file can make us compute.
        if time >= 2.0 * frames as f64 {
            return fail(format!(
                "more than half of the frames are missing by the {what} of frame {frame}, {number}"
            ));
        }
        times.push(time.round() as usize);
    }
    Ok(Some(times))
}

/// Counts of all frames from the first one to the last, some of which were not recorded.
#[derive(Debug)]
pub struct Completed {
    recorded: Box<dyn ReadCounts>,
    /// When each frame was recorded, ascending from 0.
    times: Vec<usize>,
    pattern: Pattern,
    start: i64,
}

impl Completed {
    /// Those of `recording`, whose frames were recorded at `times`.
    pub fn new(recorded: Box<dyn ReadCounts>, times: Vec<usize>, recording: &Recording) -> Self {
        let start = recording.info.schedule_start;
        Self { recorded, times, pattern: recording.pattern.clone(), start }
    }

    /// Whether each pixel of the tile shows in frame `t` what it shows in the recorded frame behind it.
    fn shows_next(&self, t: usize, [before, after]: [usize; 2]) -> Vec<bool> {
        let shows = |pixel: &Schedule| {
            let now = self.start + t as i64;
            let covering = pixel.covering(now);
            let behind = |frame: usize| now + frame as i64 - t as i64;
            behind(before) < covering.start && behind(after) < covering.end()
        };
        self.pattern.schedules().iter().map(shows).collect()
    }
}

impl ReadCounts for Completed {
    fn extents(&self) -> [usize; 3] {
        let [_, height, width] = self.recorded.extents();
        [self.times.last().map_or(0, |last| last + 1), height, width]
    }

    fn bits(&self) -> u32 {
        self.recorded.bits()
    }

    fn frame(&mut self, t: usize) -> Result<Counts> {
        let next = match self.times.binary_search(&t) {
            Ok(frame) => return self.recorded.frame(frame),
            Err(next) => next,
        };
        let next_shown = self.shows_next(t, [self.times[next - 1], self.times[next]]);
        let [_, height, width] = self.recorded.extents();
        let both = self.recorded.frame(next - 1)?.followed_by(self.recorded.frame(next)?);
        let (rows, cols, pixels) = (self.pattern.rows(), self.pattern.cols(), height * width);
        let place = |i: usize| i / width % rows * cols + i % width % cols;
        Ok(both.gather((0..pixels).map(|i| if next_shown[place(i)] { pixels + i } else { i })))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Map;

    use super::*;
    use crate::sensor::{Capture, CaptureFile, Finding, Form, Sampler, Timing};
    use crate::video::Video;

    /// A recording of which frames 9, 20 and 21 are missing, in a folder.
    fn recorded(timing: Timing, folder: &Path) -> Capture {
        let mut camera = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
        (camera.timing, camera.schedule_start) = (timing, 3);
        let value = |i: usize| (i * 7 % 91) as f32 / 90.0;
        let video = Video::new(40, 4, 8, (0..40 * 32).map(value).collect()).unwrap();
        let whole = camera.sample(&video).unwrap();
        let kept = (0..40).filter(|t| ![9, 20, 21].contains(t));
        let counts = whole.counts.gather(kept.flat_map(|t| t * 32..(t + 1) * 32));
        Capture { frames: 37, counts, ..whole.clone() }.write(folder).unwrap();
        whole
    }

    fn numbers() -> Vec<usize> {
        (0..40).filter(|t| ![9, 20, 21].contains(t)).map(|t| 100 + t).collect()
    }

    /// What a read-out shows in another frame too is not missing at all; what is, keeps its last count.
    #[test]
    fn missing_frames_are_put_together_from_their_neighbours() {
        let folder = tempfile::tempdir().unwrap();
        for timing in [Timing::Covering, Timing::Hold] {
            let whole = recorded(timing, folder.path());
            let stamps: Vec<f64> = numbers().iter().map(|&t| t as f64 + 0.1 * (t % 3) as f64).collect();
            for (key, value) in [
                ("frame_numbers", serde_json::json!(numbers())),
                ("time_stamps_ms", serde_json::json!(stamps)),
            ] {
                let keys: Map<_, _> = [(key.to_owned(), value)].into_iter().collect();
                let mut file = CaptureFile::open(folder.path(), &keys).unwrap();
                assert_eq!(file.frames, 40);
                let said = file.first_look().unwrap().findings();
                assert!(said.contains(&Finding::Missing { missing: 3, frames: 40 }), "{said:?}");
                let mut last = 0;
                for t in 0..40 {
                    let counts = file.counts(t).unwrap();
                    for i in 0..32 {
                        let found = counts.value(i);
                        let wanted = whole.counts.value(t * 32 + i);
                        let covering = whole.pattern.schedule(i / 8, i % 8).covering(3 + t as i64);
                        let shown = (covering.start - 3..covering.end() - 3)
                            .any(|t| (0..40).contains(&t) && ![9, 20, 21].contains(&t));
                        let wanted = if shown { wanted } else { whole.counts.value(last * 32 + i) };
                        assert_eq!(found, wanted, "{timing:?}, {key}: frame {t}, pixel {i}");
                    }
                    if numbers().contains(&(100 + t)) {
                        last = t;
                    }
                }
            }
        }
    }

    #[test]
    fn numbers_that_cannot_be_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        recorded(Timing::Covering, folder.path());
        let error = |key: &str, value: serde_json::Value| {
            let keys: Map<_, _> = [(key.to_owned(), value)].into_iter().collect();
            CaptureFile::open(folder.path(), &keys).unwrap_err().to_string()
        };
        let with = |frame: usize, number: f64| {
            let mut list: Vec<f64> = numbers().iter().map(|&t| t as f64).collect();
            list[frame] = number;
            serde_json::json!(list)
        };
        assert!(error("frame_numbers", serde_json::json!([1, 2])).contains("2 frame numbers for 37"));
        assert!(error("frame_numbers", with(7, 106.0)).contains("frame 7, 106"));
        assert!(error("frame_numbers", with(36, 1e9)).contains("more than half"));
        assert!(error("time_stamps_ms", with(36, 139.5)).contains("frame 36, 139.5"));
        assert!(error("frame_numbers", "../numbers.txt".into()).contains("beside"));
        std::fs::write(folder.path().join("numbers.txt"), "frame\n1\ntwo\n").unwrap();
        assert!(error("frame_numbers", "numbers.txt".into()).contains("line 3: 'two'"));
    }
}

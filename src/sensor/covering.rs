//! From sample and hold to the exposures that cover a frame (design §2).
//!
//! In each frame, a live camera delivers the read-out of each pixel that finished last. What covers frame t is known when
//! that exposure ends, so frame t has to wait for the longest one. Exposures that end behind the last frame are not known;
//! their frames keep the last value that is, of an exposure as long.

use std::borrow::Cow;
use std::collections::VecDeque;

use super::{Capture, CaptureInfo, Pattern, Recording, Schedule, Source, Timing};
use crate::Result;
use crate::frame::Frame;
use crate::video::Counts;

/// The values [y, x] of a frame, of which some can be taken from one frame and some from another.
pub(super) trait Pixels: Sized {
    /// The frame whose pixel `i` is that of frame `which(i)` of `frames`.
    fn gathered(frames: &VecDeque<Self>, which: impl Fn(usize) -> usize) -> Self;
}

impl Pixels for Vec<f32> {
    fn gathered(frames: &VecDeque<Self>, which: impl Fn(usize) -> usize) -> Self {
        (0..frames[0].len()).map(|i| frames[which(i)][i]).collect()
    }
}

impl Pixels for Counts {
    fn gathered(frames: &VecDeque<Self>, which: impl Fn(usize) -> usize) -> Self {
        let counts = (0..frames[0].len()).map(|i| frames[which(i)].value(i));
        match frames[0] {
            Self::U8(_) => Self::U8(counts.map(|count| count as u8).collect()),
            Self::U16(_) => Self::U16(counts.collect()),
        }
    }
}

/// Puts frames of covering exposures together from frames of held read-outs, as these arrive.
pub(super) struct Covering<P> {
    pattern: Pattern,
    /// Schedule time of the recording's first frame.
    start: i64,
    width: usize,
    /// Held frames from frame `first` on.
    known: VecDeque<P>,
    first: usize,
    /// Frames before the next one that are kept for the end of the recording.
    back: usize,
    ended: bool,
    /// The frame that comes next.
    next: usize,
}

impl<P: Pixels> Covering<P> {
    /// Of a recording of held read-outs, from frame `next` on.
    pub fn new(recording: &Recording, next: usize) -> Self {
        let Recording { info, pattern, width, .. } = recording;
        let (pattern, start, width) = (pattern.clone(), info.schedule_start, *width);
        // Where exposures of a pixel alternate, each was there a period ago at the latest.
        let alternate = pattern.schedules().iter().any(|pixel| pixel.exposure().is_none());
        let back = if alternate { pattern.period() } else { 0 };
        let first = next.saturating_sub(back);
        Self { pattern, start, width, known: VecDeque::new(), first, back, ended: false, next }
    }

    /// The frame with which held frames have to begin.
    pub fn first(&self) -> usize {
        self.first
    }

    /// The next frame, if there is one; `held` gives the held frames from [`Covering::first`] on, one after the other.
    pub fn next(&mut self, mut held: impl FnMut() -> Result<Option<P>>) -> Result<Option<P>> {
        let t = self.next;
        while !self.ended && self.first + self.known.len() <= t + self.pattern.longest_readout() {
            match held()? {
                Some(frame) => self.known.push_back(frame),
                None => self.ended = true,
            }
        }
        if t == self.first + self.known.len() {
            return Ok(None);
        }
        let (rows, cols) = (self.pattern.rows(), self.pattern.cols());
        let shown: Vec<usize> =
            self.pattern.schedules().iter().map(|pixel| self.shown(pixel, t) - self.first).collect();
        let place = |i: usize| i / self.width % rows * cols + i % self.width % cols;
        let frame = P::gathered(&self.known, |i| shown[place(i)]);
        self.next += 1;
        // The last frame stands in for those behind it.
        while self.known.len() > 1 && self.first + self.back < self.next {
            self.known.pop_front();
            self.first += 1;
        }
        Ok(Some(frame))
    }

    /// The known frame that shows what covers frame `t` of a pixel. Where that ends behind the last one, it is the last
    /// that shows an exposure as long, or the last of all.
    fn shown(&self, pixel: &Schedule, t: usize) -> usize {
        let (schedule, last) = (self.start + t as i64, self.first + self.known.len() - 1);
        let covering = pixel.covering(schedule);
        let end = t + (covering.end() - schedule) as usize;
        if end <= last {
            return end;
        }
        let shows_as_long = |frame: &usize| {
            // A frame shows the read-out before the one that covers it.
            let begun = pixel.covering(self.start + *frame as i64).start;
            pixel.covering(begun - 1).shutter.exposure() == covering.shutter.exposure()
        };
        (self.first..=last).rev().find(shows_as_long).unwrap_or(last)
    }
}

/// A source of covering exposures, made of one of held read-outs.
pub(super) struct HeldFrames<S> {
    held: S,
    recording: Recording,
    covering: Covering<Vec<f32>>,
    next: i64,
}

impl<S: Source> HeldFrames<S> {
    pub fn new(held: S) -> Self {
        let mut recording = held.recording().clone();
        recording.info.timing = Timing::Covering;
        let (covering, next) = (Covering::new(&recording, 0), recording.info.schedule_start);
        Self { held, recording, covering, next }
    }
}

impl<S: Source> Source for HeldFrames<S> {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn frames(&self) -> Option<usize> {
        self.held.frames()
    }

    fn next(&mut self) -> Result<Option<Frame>> {
        let values = self.covering.next(|| Ok(self.held.next()?.map(Frame::into_values)))?;
        let frame = values.map(|values| Frame::new(self.recording.extent(), self.next, values));
        self.next += 1;
        Ok(frame)
    }
}

/// A capture whose frames hold the exposure that covers them, from one that holds the last finished read-out.
#[must_use]
pub fn hold_to_covering(capture: &Capture) -> Cow<'_, Capture> {
    if capture.info.timing == Timing::Covering {
        return Cow::Borrowed(capture);
    }
    let len = capture.height * capture.width;
    let mut held = (0..capture.frames).map(|t| capture.counts.range(t * len..(t + 1) * len));
    let mut covering = Covering::new(&capture.recording(), 0);
    let frames = std::iter::from_fn(|| covering.next(|| Ok(held.next())).expect("memory does not fail"));
    let counts = frames.reduce(Counts::followed_by).expect("a capture has frames");
    let info = CaptureInfo { timing: Timing::Covering, ..capture.info.clone() };
    let (pattern, response) = (capture.pattern.clone(), capture.response.clone());
    Cow::Owned(Capture { info, pattern, response, counts, ..*capture })
}

#[cfg(test)]
mod tests {
    use serde_json::Map;

    use super::super::{CaptureFile, Form, Noise, Sampler};
    use super::*;
    use crate::video::Video;

    #[test]
    fn hold_becomes_covering() {
        let mut video = Video::black(40, 8, 8);
        for t in 0..40 {
            video.frame_mut(t).fill(0.2 + 0.01 * ((t * t) % 7) as f32);
        }
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let mut sampler = Sampler::new(pattern, Form::Linear).unwrap();
        sampler.noise = Noise::NONE;
        let covering = sampler.sample(&video).unwrap().measurement();
        sampler.timing = Timing::Hold;
        let held = sampler.sample(&video).unwrap();
        let converted = hold_to_covering(&held);
        let longest = converted.pattern.longest_readout();
        let measurement = converted.measurement();
        for t in 0..40 - longest {
            assert_eq!(measurement.frame(t), covering.frame(t), "frame {t}");
        }
    }

    /// In a static scene every read-out of one exposure has one value, so both timings say the same to the end, wherever a
    /// recording ends in the pattern's period, and frames by themselves say the same as in a row.
    #[test]
    fn the_end_keeps_the_exposure() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["interleaved", "mpve-1-4", "coded"] {
            let pattern = Pattern::built_in(name).unwrap();
            for (frames, start) in [(31, 0), (32, 3), (37, -5), (40, 8), (41, 1), (49, 0)] {
                let mut sampler = Sampler::new(pattern.clone(), Form::Linear).unwrap();
                (sampler.noise, sampler.schedule_start) = (Noise::NONE, start);
                let video = Video { frames, height: 4, width: 4, data: vec![0.1; frames * 16] };
                let covering = sampler.sample(&video).unwrap().measurement();
                sampler.timing = Timing::Hold;
                let held = sampler.sample(&video).unwrap();
                assert!(hold_to_covering(&held).measurement() == covering, "{name}: {frames} from {start}");
                held.write(folder.path()).unwrap();
                let mut file = CaptureFile::open(folder.path(), &Map::new()).unwrap();
                for t in [0, frames - 11, frames - 3, frames - 1] {
                    assert_eq!(file.pixel_values(t).unwrap(), covering.frame(t), "{name}: {t} of {frames}");
                }
            }
        }
    }
}

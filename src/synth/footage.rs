//! Frames as windows see them: only what is still needed of a recording, with stand-ins beyond its ends.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;

use super::windows;
use crate::Result;
use crate::frame::Frame;
use crate::sensor::{Calibration, SensorError};

/// The part of a recording that is in memory. Frames are padded to the size of the grid.
#[derive(Debug)]
pub struct Footage<'a> {
    arriving: Receiver<Result<Frame>>,
    calibration: &'a Calibration,
    /// Schedule time of the recording's first frame.
    start: i64,
    /// Frames from number `first` on.
    known: VecDeque<Arc<Frame>>,
    first: usize,
    ended: bool,
}

impl<'a> Footage<'a> {
    /// The recording that arrives, from schedule time `start` on.
    pub fn new(arriving: Receiver<Result<Frame>>, calibration: &'a Calibration, start: i64) -> Self {
        Self { arriving, calibration, start, known: VecDeque::new(), first: 0, ended: false }
    }

    /// Frames that have arrived so far.
    fn arrived(&self) -> usize {
        self.first + self.known.len()
    }

    /// Waits until `frames` frames have arrived or the recording has ended.
    fn wait(&mut self, frames: usize) -> Result<()> {
        while self.arrived() < frames && !self.ended {
            match self.arriving.recv() {
                Ok(frame) => self.known.push_back(Arc::new(frame?)),
                Err(_) => self.ended = true,
            }
        }
        Ok(())
    }

    /// Whether schedule time `t` lies within the recording. Waits until that is known.
    pub fn holds(&mut self, t: i64) -> Result<bool> {
        if t < self.start {
            return Ok(false);
        }
        self.wait((t - self.start) as usize + 1)?;
        Ok(t < self.start + self.arrived() as i64)
    }

    /// The part of schedule times `times` that lies within the recording.
    pub fn recorded(&mut self, times: Range<i64>) -> Result<Range<i64>> {
        self.holds(times.end - 1)?;
        Ok(times.start.max(self.start)..times.end.min(self.start + self.arrived() as i64))
    }

    /// The frame that windows see at schedule time `t`: the one that was recorded then, or its stand-in.
    pub fn frame(&mut self, t: i64) -> Result<Arc<Frame>> {
        let number = if self.holds(t)? {
            (t - self.start) as usize
        } else {
            // Before the first frame, only frames of the first period stand in.
            self.wait(self.calibration.period)?;
            if self.arrived() == 0 {
                return Err(SensorError::Capture("the recording has no frames".into()).into());
            }
            windows::stand_in(self.calibration, self.start, self.arrived(), t)
        };
        Ok(Arc::clone(&self.known[number - self.first]))
    }

    /// Forgets frames before schedule time `t`, but for those of the last period, which stand in behind the end.
    /// Frames that have not arrived yet are waited for, until the run is to `stop`.
    pub fn forget_before(&mut self, t: i64, stop: &AtomicBool) -> Result<()> {
        while self.start + (self.first as i64) < t && !stop.load(Ordering::Relaxed) {
            self.wait(self.first + self.calibration.period + 1)?;
            if self.known.len() <= self.calibration.period {
                break;
            }
            self.known.pop_front();
            self.first += 1;
        }
        Ok(())
    }
}

/// Consecutive frames.
pub struct Seen<'a> {
    /// Schedule time of `frames[0]`.
    pub first: i64,
    /// The frames.
    pub frames: &'a [Arc<Frame>],
}

impl Seen<'_> {
    /// The pixel values [y, x] of the frame at schedule time `t`.
    pub fn at(&self, t: i64) -> &[f32] {
        self.frame(t).values()
    }

    /// The frame at schedule time `t`.
    pub fn frame(&self, t: i64) -> &Arc<Frame> {
        &self.frames[(t - self.first) as usize]
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use super::*;
    use crate::sensor::{Form, Pattern, Response};

    /// A result that is gone on with needs no frame from far before it, however many there are.
    #[test]
    fn what_lies_before_is_forgotten_as_it_arrives() {
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let calibration = Calibration::new(&pattern, &Response::new(Form::Linear, 2.0).unwrap());
        let footage = |frames: usize| {
            let (send, arriving) = sync_channel(frames);
            let frame = |t: usize| Frame::new([1, 1].into(), t as i64 - 3, vec![t as f32]);
            (0..frames).for_each(|t| send.send(Ok(frame(t))).unwrap());
            Footage::new(arriving, &calibration, -3)
        };
        let go_on = AtomicBool::new(false);
        let mut long = footage(5000);
        long.forget_before(4000, &go_on).unwrap();
        assert!(long.known.len() <= calibration.period + 1, "{} frames are in memory", long.known.len());
        assert_eq!(long.frame(4000).unwrap().values()[0], 4003.0);
        // The last period stays, since it stands in behind the end.
        let mut short = footage(20);
        short.forget_before(4000, &go_on).unwrap();
        assert!(!short.holds(4000).unwrap());
        let stand_in = windows::stand_in(&calibration, -3, 20, 4000);
        assert_eq!(short.frame(4000).unwrap().values()[0], stand_in as f32);
        // A run that is to stop waits for nothing.
        let mut stopped = footage(20);
        stopped.forget_before(4000, &AtomicBool::new(true)).unwrap();
        assert_eq!(stopped.arrived(), 0);
    }
}

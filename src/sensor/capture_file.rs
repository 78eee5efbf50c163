//! Captures on disk, frame by frame.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::UNIX_EPOCH;

use serde_json::{Map, Value};

use super::capture::{ARRAY, described_in};
use super::completed::{Completed, frame_times};
use super::covering::{Covering, HeldFrames, Pixels};
use super::keys;
use super::text::read_text;
use super::{Capture, CaptureInfo, Inspection, Recording, SensorError, Source, Timing};
use crate::fingerprint::{Fingerprint, Fingerprinted};
use crate::frame::Frame;
use crate::math::spread;
use crate::video::{Counts, ReadCounts, check_size, open_counts};
use crate::video::{Outputs, counts_in, holds_counts};
use crate::{At, Error, Result};

/// Frames of a first look: some of all, and so many at the beginning, which show the schedule.
const LOOKS: usize = 16;
const FIRST: usize = 64;

/// A capture on disk, of which only what is asked for is read.
#[derive(Debug)]
pub struct CaptureFile {
    /// What is known of it.
    pub recording: Recording,
    /// Number of frames.
    pub frames: usize,
    /// The file of counts.
    pub array: PathBuf,
    counts: Box<dyn ReadCounts>,
    /// When each frame of the file was recorded, if some are missing and it says which.
    times: Option<Vec<usize>>,
}

impl Fingerprinted for CaptureFile {
    /// The file, unless it was written anew, and how it is read.
    fn mark(&self, fingerprint: &mut Fingerprint) -> Result<()> {
        let meta = std::fs::metadata(&self.array).at(&self.array)?;
        let modified = meta.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let path = std::fs::canonicalize(&self.array).at(&self.array)?;
        fingerprint.note("capture", path.display().to_string())?;
        fingerprint.note("capture_bytes", meta.len())?;
        fingerprint.note("capture_modified", modified.map(|time| time.as_secs()))?;
        // What a file held that the description only names.
        fingerprint.note("response", self.recording.response.form())?;
        fingerprint.note("info", &self.recording.info)?;
        self.times.iter().try_for_each(|times| fingerprint.note("frame_times", times))
    }
}

impl CaptureFile {
    /// Opens a capture: a `.npy` file with its `.json` beside it, or a folder that holds `capture.npy`.
    ///
    /// `overrides` replace keys of the JSON file; with enough of them no JSON file is needed.
    pub fn open(path: impl AsRef<Path>, overrides: &Map<String, Value>) -> Result<Self> {
        let path = path.as_ref();
        let array = if path.is_dir() { counts_in(path, ARRAY) } else { path.to_owned() };
        let counts = open_counts(&array)?;
        let [frames, height, width] = counts.extents();
        check_size(width, height).at(&array)?;
        let json = described_in(&array);
        let mut keys = match read_text(&json) {
            Ok(text) => keys::parse(&text).at(&json)?,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound && overrides.contains_key("pattern") => {
                Map::new()
            }
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                let problem = "missing; it says how to read the capture (or name a pattern with --pattern)";
                return Err(Error::from(SensorError::Capture(problem.into())).at(&json));
            }
            Err(e) => return Err(e).at(&json),
        };
        keys.extend(overrides.clone());
        // A bare array says nothing of its depth but its type.
        let depth = u64::from(counts.bits());
        let depth = keys.entry("bit_depth").or_insert(depth.into()).as_u64().unwrap_or(depth).clamp(1, 16);
        keys.entry("white_level").or_insert(((1u64 << depth) - 1).into());
        let described = if json.exists() { &json } else { &array };
        let info = keys::info(&keys).at(described)?;
        let mut recording = Recording::new(info, [height, width], array.parent()).at(described)?;
        let times = frame_times(&recording.info, frames, array.parent()).at(described)?;
        // From here on, no frame is missing.
        (recording.info.frame_numbers, recording.info.time_stamps_ms) = (None, None);
        let counts = match &times {
            Some(times) => Box::new(Completed::new(counts, times.clone(), &recording)),
            None => counts,
        };
        let [frames, ..] = counts.extents();
        Ok(Self { recording, frames, array, counts, times })
    }

    /// Whether `path` holds a capture: an array of counts, where a video has floating-point numbers.
    pub fn is_at(path: &Path) -> bool {
        if path.is_dir() { counts_in(path, ARRAY).exists() } else { holds_counts(path) }
    }

    /// Outputs that keep the capture's own files: a recording cannot be made again.
    pub fn outputs(&self, overwrite: bool) -> Outputs {
        Outputs::new(overwrite).reading([self.array.clone(), described_in(&self.array)])
    }

    /// Bits of a count's type: 8 or 16.
    pub fn bits(&self) -> u32 {
        self.counts.bits()
    }

    /// The counts of frame `t`, as they stand there.
    pub(super) fn counts(&mut self, t: usize) -> Result<Counts> {
        self.counts.frame(t)
    }

    /// The frames `which` as a capture of their own, to look at: its timing is only true of neighbouring frames.
    pub fn excerpt(&mut self, which: &[usize]) -> Result<Capture> {
        self.capture_of(self.recording.info.timing, which, Self::counts)
    }

    /// As [`CaptureFile::excerpt`], of frames that hold the exposures that cover them.
    pub(super) fn covering_excerpt(&mut self, which: &[usize]) -> Result<Capture> {
        self.capture_of(Timing::Covering, which, |file, t| file.covering(t, Self::counts))
    }

    /// The frames `which`, each of which `frame` reads, as a capture of their own.
    fn capture_of(
        &mut self,
        timing: Timing,
        which: &[usize],
        mut frame: impl FnMut(&mut Self, usize) -> Result<Counts>,
    ) -> Result<Capture> {
        let Recording { info, pattern, response, height, width, .. } = self.recording.clone();
        let mut counts = Counts::with_capacity(self.bits(), which.len() * height * width)?;
        for &t in which {
            counts = counts.followed_by(frame(self, t)?);
        }
        let info = CaptureInfo { timing, ..info };
        Ok(Capture { info, pattern, response, frames: which.len(), height, width, counts })
    }

    /// What covers frame `t`, of frames as they stand there, which `frame` reads.
    fn covering<P: Pixels>(
        &mut self,
        t: usize,
        mut frame: impl FnMut(&mut Self, usize) -> Result<P>,
    ) -> Result<P> {
        if self.recording.info.timing == Timing::Covering {
            return frame(self, t);
        }
        let mut covering = Covering::new(&self.recording, t);
        let mut times = covering.first()..self.frames;
        let held = || times.next().map(|t| frame(self, t)).transpose();
        Ok(covering.next(held)?.expect("the capture has frame t"))
    }

    /// Pixel values y in [0, 1] of the exposures that cover frame `t`, to look at: what is missing throughout is dark.
    pub fn pixel_values(&mut self, t: usize) -> Result<Vec<f32>> {
        self.covering(t, |file, t| {
            let counts = file.counts(t)?;
            let Recording { info, defects, .. } = &file.recording;
            let mut values = vec![0.0; counts.len()];
            info.pixel_values(&counts, defects.as_ref(), &mut values, None);
            Ok(values)
        })
    }

    /// The counts of all frames, as the exposures that cover them, while `inspection` sees them as they stand there.
    pub(super) fn into_covering_counts(self, inspection: Inspection) -> CoveringCounts {
        let held = self.recording.info.timing == Timing::Hold;
        CoveringCounts {
            inspection,
            covering: held.then(|| Covering::new(&self.recording, 0)),
            times: 0..self.frames,
            file: self,
        }
    }

    /// All frames, as the exposures that cover them.
    pub fn into_frames(self) -> Box<dyn Source> {
        self.into_inspected_frames().0
    }

    /// The same, which are held against the description as they are read.
    pub fn into_inspected_frames(self) -> (Box<dyn Source>, Arc<Mutex<Inspection>>) {
        let inspection = Arc::new(Mutex::new(self.inspection()));
        let Self { recording, frames, mut counts, .. } = self;
        let inspected = Arc::clone(&inspection);
        let frame = move |t| {
            let counts = counts.frame(t)?;
            inspected.lock().unwrap_or_else(PoisonError::into_inner).add(&counts);
            Ok(counts)
        };
        (CountedFrames::new(recording, frames, frame).covering(), inspection)
    }

    /// One that has seen nothing yet.
    fn inspection(&self) -> Inspection {
        self.inspection_of(&self.recording)
    }

    /// The same of what `recording` says of it.
    pub(super) fn inspection_of(&self, recording: &Recording) -> Inspection {
        let missing = self.times.as_ref().map_or(0, |times| self.frames - times.len());
        Inspection::new(recording, self.bits(), self.frames, missing)
    }

    /// Holds the first frames, and some of all, against the description: a look before the work, which sees all.
    pub fn first_look(&mut self) -> Result<Inspection> {
        let mut inspection = self.inspection();
        for t in spread(self.frames, LOOKS) {
            inspection.glance(&self.counts(t)?);
        }
        for t in 0..self.frames.min(FIRST) {
            inspection.follow(&self.counts(t)?);
        }
        Ok(inspection)
    }

    /// Holds all frames against the description.
    pub(super) fn inspect(&mut self) -> Result<Inspection> {
        let mut inspection = self.inspection();
        for t in 0..self.frames {
            inspection.add(&self.counts(t)?);
        }
        Ok(inspection)
    }
}

/// Counts of the exposures that cover frames, one frame after the other.
pub(super) struct CoveringCounts {
    file: CaptureFile,
    /// Frames that were not read yet.
    times: Range<usize>,
    /// What puts them together, where the file holds read-outs.
    covering: Option<Covering<Counts>>,
    /// What sees them.
    pub inspection: Inspection,
}

impl CoveringCounts {
    /// Those of the next frame, if there is one.
    pub fn next(&mut self) -> Result<Option<Counts>> {
        let Self { file, times, covering, inspection } = self;
        let mut read = || {
            let counts = times.next().map(|t| file.counts(t)).transpose()?;
            if let Some(counts) = &counts {
                inspection.add(counts);
            }
            Ok(counts)
        };
        match covering {
            Some(covering) => covering.next(read),
            None => read(),
        }
    }
}

impl Capture {
    /// Reads a whole capture into memory (see [`CaptureFile::open`]).
    pub fn read(path: impl AsRef<Path>, overrides: &Map<String, Value>) -> Result<Self> {
        let mut file = CaptureFile::open(path, overrides)?;
        file.excerpt(&(0..file.frames).collect::<Vec<_>>())
    }

    /// Its frames, as the exposures that cover them.
    pub fn frames(&self) -> Box<dyn Source + '_> {
        self.repeated(self.frames)
    }

    /// The same of a recording of so many `frames`, in which its own come again and again.
    pub fn repeated(&self, frames: usize) -> Box<dyn Source + '_> {
        let len = self.height * self.width;
        let counts = move |t: usize| {
            let t = t % self.frames;
            Ok(self.counts.range(t * len..(t + 1) * len))
        };
        CountedFrames::new(self.recording(), frames, counts).covering()
    }
}

/// Frames of counts, which `counts` gives, as they stand there.
struct CountedFrames<C> {
    recording: Recording,
    frames: usize,
    counts: C,
    next: usize,
    /// Values of the frame before, where there are defects to fill.
    before: Vec<f32>,
}

impl<'a, C: FnMut(usize) -> Result<Counts> + Send + 'a> CountedFrames<C> {
    fn new(recording: Recording, frames: usize, counts: C) -> Self {
        Self { recording, frames, counts, next: 0, before: Vec::new() }
    }

    /// The exposures that cover the frames.
    fn covering(self) -> Box<dyn Source + 'a> {
        match self.recording.info.timing {
            Timing::Covering => Box::new(self),
            Timing::Hold => Box::new(HeldFrames::new(self)),
        }
    }
}

impl<C: FnMut(usize) -> Result<Counts> + Send> Source for CountedFrames<C> {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn frames(&self) -> Option<usize> {
        Some(self.frames)
    }

    fn next(&mut self) -> Result<Option<Frame>> {
        if self.next == self.frames {
            return Ok(None);
        }
        let counts = (self.counts)(self.next)?;
        let Recording { info, defects, .. } = &self.recording;
        let mut values = vec![0.0; counts.len()];
        let last = Some(&self.before[..]).filter(|before| !before.is_empty());
        info.pixel_values(&counts, defects.as_ref(), &mut values, last);
        if defects.is_some() {
            values.clone_into(&mut self.before);
        }
        let time = info.schedule_start + self.next as i64;
        self.next += 1;
        Ok(Some(Frame::new(self.recording.extent(), time, values)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Form, Pattern, Sampler, hold_to_covering};
    use super::*;
    use crate::video::Video;

    fn capture(timing: Timing, frames: usize) -> Capture {
        let mut sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
        (sampler.timing, sampler.schedule_start) = (timing, 3);
        let value = |i: usize| (i % 91) as f32 / 90.0;
        sampler.sample(&Video::new(frames, 4, 6, (0..frames * 24).map(value).collect()).unwrap()).unwrap()
    }

    fn all(mut source: Box<dyn Source + '_>) -> Vec<Vec<f32>> {
        let frames = std::iter::from_fn(|| source.next().unwrap());
        let frames: Vec<Frame> = frames.collect();
        assert_eq!(source.frames(), Some(frames.len()));
        for (frame, time) in frames.iter().zip(3..) {
            assert_eq!((frame.extent(), frame.time()), ([4, 6].into(), time));
        }
        frames.into_iter().map(Frame::into_values).collect()
    }

    /// Piece by piece, from a file or from memory, the frames are those of the whole.
    #[test]
    fn pieces_equal_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        for timing in [Timing::Covering, Timing::Hold] {
            for frames in [1, 3, 8, 9, 40] {
                let capture = capture(timing, frames);
                let whole = hold_to_covering(&capture).measurement();
                let whole: Vec<Vec<f32>> = (0..frames).map(|t| whole.frame(t).to_vec()).collect();
                assert_eq!(all(capture.frames()), whole, "{timing:?}, {frames} frames in memory");
                capture.write(folder.path()).unwrap();
                let mut file = CaptureFile::open(folder.path(), &Map::new()).unwrap();
                let excerpt = file.excerpt(&[frames - 1, 0]).unwrap();
                let frame = |t: usize| capture.counts.range(t * 24..(t + 1) * 24);
                assert_eq!(excerpt.counts, frame(frames - 1).followed_by(frame(0)));
                for (t, whole) in whole.iter().enumerate() {
                    assert_eq!(file.pixel_values(t).unwrap(), *whole, "{timing:?}, frame {t} of {frames}");
                }
                assert_eq!(all(file.into_frames()), whole, "{timing:?}, {frames} frames from a file");
            }
        }
    }
}

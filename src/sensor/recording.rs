//! Recordings frame by frame: what a file, a capture in memory or a live camera delivers.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::capture::ARRAY;
use super::defects::Defects;
use super::{Calibration, Capture, CaptureInfo, Pattern, Response, Schedule, SensorError, Timing};
use crate::video::check_size;
use crate::video::npy::{Counts, CountsReader};
use crate::{At, Error, Result};

/// What is known of a recording before its frames.
#[derive(Clone, Debug)]
pub struct Recording {
    /// What the file says about it.
    pub info: CaptureInfo,
    /// When each pixel integrates.
    pub pattern: Pattern,
    /// From exposure to pixel value; saturates at the pattern's shortest exposure.
    pub response: Response,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Pixels and read-outs without a value, which are filled.
    pub defects: Option<Defects>,
}

/// Frames one after the other.
pub trait FrameSource: Send {
    /// What is known of the recording.
    fn recording(&self) -> &Recording;

    /// Writes the pixel values y in [0, 1] of the next frame, [y, x], to `values`; `false` after the last frame. Each
    /// pixel holds the exposure that covers the frame ([`Timing::Covering`]).
    fn next(&mut self, values: &mut [f32]) -> Result<bool>;
}

impl Recording {
    /// Interprets `info` for frames of [rows, columns]; a response in a CSV file is looked for in `folder`.
    pub fn new(info: CaptureInfo, [height, width]: [usize; 2], folder: Option<&Path>) -> Result<Self> {
        let pattern = info.pattern.pattern()?;
        let response = Response::new(info.response.form(folder)?, pattern.shortest_exposure() as f64)?;
        let fail = |problem: String| Err(SensorError::Capture(problem).into());
        if height < pattern.rows() || width < pattern.cols() {
            return fail(format!(
                "{height}×{width} pixels are fewer than the {}×{} of the pattern's tile",
                pattern.rows(),
                pattern.cols()
            ));
        }
        let CaptureInfo { bit_depth, black_level, white_level, frame_period_ms, .. } = info;
        if !(1..=16).contains(&bit_depth) {
            return fail(format!("a bit depth of {bit_depth}"));
        }
        // Less than a count apart, levels say nothing; too far apart, every pixel is black.
        if !(1.0..=1e9).contains(&(white_level - black_level)) {
            return fail(format!("black level {black_level} is not below white level {white_level}"));
        }
        let CaptureInfo { full_well_e, read_noise_e, anchor, .. } = info;
        for (key, value, least) in [
            ("full_well_e", full_well_e, f64::MIN_POSITIVE),
            ("read_noise_e", read_noise_e, 0.0),
            ("anchor", anchor, f64::from(f32::MIN_POSITIVE)),
        ] {
            if value.is_some_and(|value| !(least..=f64::from(f32::MAX)).contains(&value)) {
                return fail(format!("{key} of {}", value.unwrap_or_default()));
            }
        }
        if !(frame_period_ms.is_finite() && frame_period_ms > 0.0) {
            return fail(format!("a frame period of {frame_period_ms} ms"));
        }
        if info.schedule_start.unsigned_abs() > 1 << 40 {
            return fail(format!("a schedule start of {}", info.schedule_start));
        }
        let defects = info.defects(&pattern, [height, width])?;
        Ok(Self { info, pattern, response, height, width, defects })
    }

    /// Tables for the kernels.
    pub fn calibration(&self) -> Calibration {
        Calibration::new(&self.pattern, &self.response)
    }
}

/// A capture on disk, of which only what is asked for is read.
#[derive(Debug)]
pub struct CaptureFile {
    /// What is known of it.
    pub recording: Recording,
    /// Number of frames.
    pub frames: usize,
    /// The file of counts.
    pub array: PathBuf,
    counts: CountsReader,
}

impl CaptureFile {
    /// Opens a capture: a `.npy` file with its `.json` beside it, or a folder that holds `capture.npy`.
    ///
    /// `overrides` replace keys of the JSON file; with enough of them no JSON file is needed.
    pub fn open(path: impl AsRef<Path>, overrides: &Map<String, Value>) -> Result<Self> {
        let path = path.as_ref();
        let array = if path.is_dir() { path.join(ARRAY) } else { path.to_owned() };
        let counts = CountsReader::open(&array)?;
        let [frames, height, width] = counts.extents();
        check_size(width, height).at(&array)?;
        let json = array.with_extension("json");
        let mut keys = match super::read_text(&json) {
            Ok(text) => serde_json::from_str::<Map<String, Value>>(&text)
                .map_err(|e| SensorError::Capture(e.to_string()))
                .at(&json)?,
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
        let depth = if counts.is_u8() { 8 } else { 16 };
        let depth = keys.entry("bit_depth").or_insert(depth.into()).as_u64().unwrap_or(depth).clamp(1, 16);
        keys.entry("white_level").or_insert(((1u64 << depth) - 1).into());
        let info: CaptureInfo = serde_json::from_value(Value::Object(keys))
            .map_err(|e| SensorError::Capture(e.to_string()))
            .at(&json)?;
        let described = if json.exists() { &json } else { &array };
        let recording = Recording::new(info, [height, width], array.parent()).at(described)?;
        Ok(Self { recording, frames, array, counts })
    }

    /// The frames `which` as a capture of their own, to look at: its timing is only true of neighbouring frames.
    pub fn excerpt(&mut self, which: &[usize]) -> Result<Capture> {
        let Recording { info, pattern, response, height, width, .. } = self.recording.clone();
        let frames = which.iter().map(|&t| self.counts.frame(t)).collect::<Result<Vec<_>>>()?;
        let counts = frames.into_iter().reduce(Counts::followed_by).unwrap_or(Counts::U8(Vec::new()));
        Ok(Capture { info, pattern, response, frames: which.len(), height, width, counts })
    }

    /// Pixel values y in [0, 1] of the exposures that cover frame `t`, to look at: what is missing throughout is dark.
    pub fn pixel_values(&mut self, t: usize) -> Result<Vec<f32>> {
        let Recording { info, pattern, height, width, defects, .. } = &self.recording;
        let shown = match info.timing {
            Timing::Covering => vec![t; pattern.schedules().len()],
            Timing::Hold => shown_in(pattern, info.schedule_start, t, self.frames - 1),
        };
        let mut values = vec![0.0; height * width];
        let mut frame = values.clone();
        for (i, &which) in shown.iter().enumerate() {
            if shown[..i].contains(&which) {
                continue;
            }
            info.pixel_values(&self.counts.frame(which)?, defects.as_ref(), &mut frame, None);
            for (i, value) in values.iter_mut().enumerate() {
                if shown[place(pattern, i, *width)] == which {
                    *value = frame[i];
                }
            }
        }
        Ok(values)
    }

    /// All frames, as the exposures that cover them.
    pub fn into_frames(self) -> Box<dyn FrameSource> {
        let file = FileFrames { file: self, next: 0, before: Vec::new() };
        match file.file.recording.info.timing {
            Timing::Covering => Box::new(file),
            Timing::Hold => Box::new(HeldFrames::new(file)),
        }
    }
}

/// Frames of a file as they stand there.
struct FileFrames {
    file: CaptureFile,
    next: usize,
    /// Values of the frame before, where there are defects to fill.
    before: Vec<f32>,
}

/// Values of a frame, of which the frame before is remembered if there are defects.
fn filled(recording: &Recording, counts: &Counts, values: &mut [f32], before: &mut Vec<f32>) {
    let Recording { info, defects, .. } = recording;
    let last = Some(&before[..]).filter(|before| !before.is_empty());
    info.pixel_values(counts, defects.as_ref(), values, last);
    if defects.is_some() {
        values.clone_into(before);
    }
}

impl FrameSource for FileFrames {
    fn recording(&self) -> &Recording {
        &self.file.recording
    }

    fn next(&mut self, values: &mut [f32]) -> Result<bool> {
        if self.next == self.file.frames {
            return Ok(false);
        }
        let counts = self.file.counts.frame(self.next)?;
        filled(&self.file.recording, &counts, values, &mut self.before);
        self.next += 1;
        Ok(true)
    }
}

impl Capture {
    /// What is known of it besides its frames.
    pub fn recording(&self) -> Recording {
        let extent = [self.height, self.width];
        Recording {
            defects: self.info.defects(&self.pattern, extent).expect("they were checked when it was made"),
            info: self.info.clone(),
            pattern: self.pattern.clone(),
            response: self.response.clone(),
            height: self.height,
            width: self.width,
        }
    }

    /// Its frames, as the exposures that cover them.
    pub fn frames(&self) -> Box<dyn FrameSource + '_> {
        let frames = MemoryFrames { recording: self.recording(), capture: self, next: 0, before: Vec::new() };
        match self.info.timing {
            Timing::Covering => Box::new(frames),
            Timing::Hold => Box::new(HeldFrames::new(frames)),
        }
    }
}

/// Frames of a capture in memory as they stand there.
struct MemoryFrames<'a> {
    recording: Recording,
    capture: &'a Capture,
    next: usize,
    before: Vec<f32>,
}

impl FrameSource for MemoryFrames<'_> {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn next(&mut self, values: &mut [f32]) -> Result<bool> {
        if self.next == self.capture.frames {
            return Ok(false);
        }
        let len = values.len();
        let counts = self.capture.counts.range(self.next * len..(self.next + 1) * len);
        filled(&self.recording, &counts, values, &mut self.before);
        self.next += 1;
        Ok(true)
    }
}

/// The frame of a recording of held read-outs, up to frame `last`, that shows what covers frame `t`, for each pixel of
/// the pattern's tile.
fn shown_in(pattern: &Pattern, start: i64, t: usize, last: usize) -> Vec<usize> {
    let schedule = start + t as i64;
    let end = |pixel: &Schedule| t + (pixel.covering(schedule).end() - schedule) as usize;
    pattern.schedules().iter().map(|pixel| end(pixel).min(last)).collect()
}

/// The place of pixel `i` of a frame in the pattern's tile.
fn place(pattern: &Pattern, i: usize, width: usize) -> usize {
    i / width % pattern.rows() * pattern.cols() + i % width % pattern.cols()
}

/// Frames that hold the exposure that covers them, made of frames that hold the last finished read-out: frame t has
/// to wait for the end of its longest exposure. Exposures that end behind the last frame are not known; their
/// frames keep the last value that is.
struct HeldFrames<S> {
    held: S,
    recording: Recording,
    /// Held frames from frame `first` on.
    known: VecDeque<Vec<f32>>,
    first: usize,
    ended: bool,
    next: usize,
}

impl<S: FrameSource> HeldFrames<S> {
    fn new(held: S) -> Self {
        let mut recording = held.recording().clone();
        recording.info.timing = Timing::Covering;
        Self { held, recording, known: VecDeque::new(), first: 0, ended: false, next: 0 }
    }
}

impl<S: FrameSource> FrameSource for HeldFrames<S> {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn next(&mut self, values: &mut [f32]) -> Result<bool> {
        let Recording { pattern, info, width, .. } = &self.recording;
        let t = self.next;
        while !self.ended && self.first + self.known.len() <= t + pattern.longest_readout() {
            let mut frame = vec![0.0; values.len()];
            if self.held.next(&mut frame)? {
                self.known.push_back(frame);
            } else {
                self.ended = true;
            }
        }
        if t == self.first + self.known.len() {
            return Ok(false);
        }
        let last = self.first + self.known.len() - 1;
        let shown = shown_in(pattern, info.schedule_start, t, last);
        for (i, value) in values.iter_mut().enumerate() {
            *value = self.known[shown[place(pattern, i, *width)] - self.first][i];
        }
        self.next += 1;
        // The last frame stands in for those behind it.
        if self.known.len() > 1 {
            self.known.pop_front();
            self.first += 1;
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Form, Sampler, hold_to_covering};
    use super::*;
    use crate::video::Video;

    fn capture(timing: Timing, frames: usize) -> Capture {
        let mut sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
        (sampler.timing, sampler.schedule_start) = (timing, 3);
        let value = |i: usize| (i % 91) as f32 / 90.0;
        sampler.sample(&Video::new(frames, 4, 6, (0..frames * 24).map(value).collect()).unwrap()).unwrap()
    }

    fn all(mut source: Box<dyn FrameSource + '_>) -> Vec<Vec<f32>> {
        let mut frames = Vec::new();
        let mut values = vec![0.0; 24];
        while source.next(&mut values).unwrap() {
            frames.push(values.clone());
        }
        frames
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

//! Streaming gives what a whole capture gives, frame by frame, in bounded memory, and can be taken up again.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use pix2hdr::frame::Frame;
use pix2hdr::network::{Model, Precision, presets};
use pix2hdr::sensor::{Capture, CaptureFile, Form, Pattern, Recording, Sampler, Source, Timing};
use pix2hdr::synth::{Backend, ExecutorChoice, Settings, Skip, Synthesizer};
use pix2hdr::video::Video;
use pix2hdr::{Error, Result};
use serde_json::Map;

fn model() -> Model {
    Model::random(presets::by_name("tiny").unwrap().graph().unwrap(), 5).unwrap()
}

fn capture(frames: usize, timing: Timing) -> Capture {
    let mut sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
    (sampler.timing, sampler.schedule_start) = (timing, 5);
    let pixel = |i: usize| {
        let (t, y, x) = (i / 320, i / 20 % 16, i % 20);
        let left = t / 5 % 20;
        if (left..left + 3).contains(&x) && y < 6 { 0.8 } else { 0.1 + 0.01 * ((x * y) % 17) as f32 }
    };
    sampler.sample(&Video::new(frames, 16, 20, (0..frames * 320).map(pixel).collect()).unwrap()).unwrap()
}

fn synthesizer(capture: &Capture, skip: Skip) -> Synthesizer {
    let backend = Backend::choose(ExecutorChoice::Cpu, None, Precision::F32).unwrap();
    let settings = Settings { skip, ..Settings::default() };
    Synthesizer::new(&model(), capture.calibration(), [16, 20], &backend, &settings).unwrap()
}

/// Frames with their numbers.
fn stream(synthesizer: &mut Synthesizer, source: &mut dyn Source, from: usize) -> Vec<(usize, Vec<f32>)> {
    let frames = Mutex::new(Vec::new());
    synthesizer
        .stream(source, from, |frame| {
            frames.lock().unwrap().push((frame.number, frame.frame.values().to_vec()));
            Ok(())
        })
        .unwrap();
    frames.into_inner().unwrap()
}

/// A file read piece by piece gives the video of the capture in memory, whatever its length and timing.
#[test]
fn a_file_gives_what_memory_gives() {
    let folder = tempfile::tempdir().unwrap();
    for timing in [Timing::Covering, Timing::Hold] {
        for frames in [1, 2, 7, 8, 41, 130] {
            let capture = capture(frames, timing);
            capture.write(folder.path()).unwrap();
            let file = CaptureFile::open(folder.path(), &Map::new()).unwrap();
            let mut synthesizer = synthesizer(&capture, Skip::Off);
            let (video, report) = synthesizer.video(&capture).unwrap();
            assert_eq!(report.frames, frames);
            let streamed = stream(&mut synthesizer, &mut *file.into_frames(), 0);
            assert_eq!(streamed.len(), frames);
            for (number, (streamed, values)) in streamed.iter().enumerate() {
                assert_eq!(
                    (*streamed, &values[..]),
                    (number, video.frame(number)),
                    "{timing:?}, {frames} frames"
                );
            }
        }
    }
}

/// A run that begins in the middle delivers the same bits as one that began with the first frame.
#[test]
fn a_run_that_begins_later_gives_the_same() {
    let capture = capture(2200, Timing::Covering);
    for skip in [Skip::Off, Skip::Exact, Skip::Bounded(0.002)] {
        let mut synthesizer = synthesizer(&capture, skip);
        let whole = stream(&mut synthesizer, &mut *capture.frames(), 0);
        for from in [1, 39, 40, 1000, 1300, 2199] {
            let rest = stream(&mut synthesizer, &mut *capture.frames(), from);
            assert!(rest == whole[from..], "{skip:?} from frame {from}");
        }
    }
}

/// A run that is stopped has delivered whole frames in order, and stops soon.
#[test]
fn a_stopped_run_leaves_a_beginning() {
    let capture = capture(2000, Timing::Covering);
    let mut synthesizer = synthesizer(&capture, Skip::Off);
    let whole = stream(&mut synthesizer, &mut *capture.frames(), 0);
    let stop = synthesizer.stop();
    let delivered = Mutex::new(Vec::new());
    let report = synthesizer
        .stream(&mut *capture.frames(), 0, |frame| {
            if frame.number == 100 {
                stop.store(true, Ordering::Relaxed);
            }
            delivered.lock().unwrap().push((frame.number, frame.frame.values().to_vec()));
            Ok(())
        })
        .unwrap();
    let delivered = delivered.into_inner().unwrap();
    assert_eq!(report.frames, delivered.len());
    assert!((101..1000).contains(&report.frames), "{} frames", report.frames);
    assert!(delivered == whole[..delivered.len()]);
}

/// A source without an end in sight, which counts how far it is ahead of what was delivered.
struct Long<'a> {
    recording: Recording,
    read: usize,
    frames: usize,
    delivered: &'a AtomicUsize,
    most_ahead: &'a AtomicUsize,
    fails_at: usize,
}

impl Source for Long<'_> {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn frames(&self) -> Option<usize> {
        None
    }

    fn next(&mut self) -> Result<Option<Frame>> {
        if self.read == self.fails_at {
            return Err(Error::Usage("the camera is gone".into()));
        }
        if self.read == self.frames {
            return Ok(None);
        }
        let extent = self.recording.extent();
        let time = self.recording.info.schedule_start + self.read as i64;
        let frame = Frame::new(extent, time, vec![(self.read % 8) as f32 / 8.0; extent.pixels()]);
        self.read += 1;
        let ahead = self.read - self.delivered.load(Ordering::SeqCst);
        self.most_ahead.fetch_max(ahead, Ordering::SeqCst);
        Ok(Some(frame))
    }
}

/// However long a recording is, only some hundred frames of it are in memory, also where they are taken slowly.
#[test]
fn memory_does_not_grow_with_the_length() {
    let capture = capture(8, Timing::Covering);
    let (delivered, most_ahead) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let mut source = Long {
        recording: capture.recording(),
        read: 0,
        frames: 3000,
        delivered: &delivered,
        most_ahead: &most_ahead,
        fails_at: usize::MAX,
    };
    let report = synthesizer(&capture, Skip::Off)
        .stream(&mut source, 0, |frame| {
            if frame.number % 500 == 0 {
                std::thread::sleep(std::time::Duration::from_millis(50));
            }
            delivered.fetch_add(1, Ordering::SeqCst);
            Ok(())
        })
        .unwrap();
    assert_eq!(report.frames, 3000);
    let most = most_ahead.load(Ordering::SeqCst);
    assert!(most < 400, "{most} frames were in memory at once");
}

/// What goes wrong at either end ends the run with its own words.
#[test]
fn failures_at_both_ends_are_told() {
    let capture = capture(8, Timing::Covering);
    let (delivered, most_ahead) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let source = |fails_at| Long {
        recording: capture.recording(),
        read: 0,
        frames: 3000,
        delivered: &delivered,
        most_ahead: &most_ahead,
        fails_at,
    };
    let mut synthesizer = synthesizer(&capture, Skip::Off);
    let gone = synthesizer.stream(&mut source(500), 0, |_| Ok(())).unwrap_err();
    assert!(gone.to_string().contains("the camera is gone"));
    let full = synthesizer.stream(&mut source(usize::MAX), 0, |frame| match frame.number {
        700 => Err(Error::Usage("the disk is full".into())),
        _ => Ok(()),
    });
    assert!(full.unwrap_err().to_string().contains("the disk is full"));
    // And the next run is a whole one again.
    assert_eq!(synthesizer.video(&capture).unwrap().1.frames, 8);
}

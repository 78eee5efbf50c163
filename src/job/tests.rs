use std::sync::atomic::Ordering;

use super::*;
use crate::fingerprint::Fingerprint;
use crate::frame::Frame;
use crate::network::{Model, presets};
use crate::sensor::{Capture, Form, Pattern, Recording, Sampler, Source};
use crate::synth::{Backend, ExecutorChoice, Skip, Synthesizer};
use crate::video::{self, Video, Writing};
use crate::{Error, Result};

const EXTENTS: [usize; 3] = [150, 12, 16];

fn capture() -> Capture {
    let [frames, height, width] = EXTENTS;
    let pixel = |i: usize| (i * 7919 / 13 % 1000) as f32 / 1000.0;
    let video = Video::new(frames, height, width, (0..frames * height * width).map(pixel).collect()).unwrap();
    Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap().sample(&video).unwrap()
}

fn model() -> Model {
    Model::random(presets::by_name("tiny").unwrap().graph().unwrap(), 5).unwrap()
}

fn settings() -> Settings {
    Settings { executor: ExecutorChoice::Cpu, hop: Some(8), ..Settings::default() }
}

fn job<'a>(source: Box<dyn Source + 'a>, settings: Settings) -> Job<'a> {
    Job::with(source, settings, model(), Backend::Cpu).unwrap()
}

fn whole(capture: &Capture) -> Video {
    let extent = [capture.height, capture.width];
    let calibration = capture.calibration();
    let mut synthesizer =
        Synthesizer::new(&model(), calibration, extent, &Backend::Cpu, &settings()).unwrap();
    synthesizer.video(capture).unwrap().0
}

/// All sinks of a tuple see all frames, in order, and what they make of them comes back.
#[test]
fn sinks_are_put_together() {
    let capture = capture();
    let memory = InMemory::new(capture.frames, capture.recording().extent());
    let (mut numbers, mut told) = (Vec::new(), 0);
    let each = Each(|result: &crate::synth::ResultFrame| {
        assert_eq!(result.frame.time(), result.number as i64);
        numbers.push(result.number);
        Ok(())
    });
    let sinks = (memory, None::<InMemory>, each);
    let outcome = job(capture.frames(), settings()).run(sinks, |done| told = done).unwrap();
    let (video, nothing, ()) = outcome.output;
    assert!(video == whole(&capture) && nothing.is_none());
    assert_eq!((outcome.report.frames, outcome.summary.frames, told), (150, 150, 150));
    assert_eq!(numbers, (0..150).collect::<Vec<_>>());
}

/// A job that is stopped leaves its frames; another one completes them to the same bytes, if it would have made them.
#[test]
fn a_job_is_gone_on_with() {
    let (capture, folder) = (capture(), tempfile::tempdir().unwrap());
    let begin = |job: &Job<'_>, name: &str, begin: Begin| -> Result<Resumable> {
        let (target, how) = (folder.path().join(name), Writing { half: false, ..Writing::default() });
        let mut made = Fingerprint::of(job)?;
        made.add(&how)?;
        let (result, warning) = Resumable::begin(&target, EXTENTS, how, begin, &made)?;
        assert!(warning.is_none(), "{warning:?}");
        Ok(result)
    };
    for name in ["a.npy", "folder"] {
        let first = job(capture.frames(), settings());
        let (result, stop) = (begin(&first, name, Begin::Anew).unwrap(), first.stop());
        let stopped = first.run(result, |done| stop.store(done >= 20, Ordering::Relaxed)).unwrap_err();
        assert!(matches!(stopped.error, Error::Stopped), "{stopped:?}");
        let left = stopped.left.unwrap().unwrap();
        assert!((20..150).contains(&left.done) && left.frames == 150, "{left:?}");
        assert!(left.to_string().contains("--resume") && left.partial.exists(), "{left}");
        // Not as it was begun.
        let refused = |other: Settings| {
            let job = job(capture.frames(), other);
            begin(&job, name, Begin::WhereItStopped).err().unwrap()
        };
        for (other, key) in [
            (Settings { hop: Some(16), ..settings() }, "hop"),
            (Settings { skip: Skip::Bounded(0.5), ..settings() }, "skip"),
        ] {
            let error = refused(other);
            let Some(ResumeError::Differs { key: differs, .. }) = error.cause() else { panic!("{error}") };
            assert_eq!(differs, key);
            assert!(error.to_string().contains(&format!("another {key}: ")), "{error}");
        }
        // Nor anew, unless that is said.
        let again = job(capture.frames(), settings());
        let error = begin(&again, name, Begin::Anew).err().unwrap();
        assert!(matches!(error.cause(), Some(ResumeError::Interrupted)), "{error}");
        let result = begin(&again, name, Begin::WhereItStopped).unwrap();
        assert_eq!(result.begun(), left.done);
        let outcome = again.run(result, |_| ()).unwrap();
        assert_eq!(outcome.report.frames, 150 - left.done);
        assert!(video::read(outcome.output).unwrap() == whole(&capture), "{name}");
    }
    let names = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(names, 2, "something is left beside the results");
}

/// A camera of which nobody knows when it ends.
struct Live<'a>(Box<dyn Source + 'a>, usize);

impl Source for Live<'_> {
    fn recording(&self) -> &Recording {
        self.0.recording()
    }

    fn frames(&self) -> Option<usize> {
        None
    }

    fn next(&mut self) -> Result<Option<Frame>> {
        match self.1.checked_sub(1) {
            Some(left) => {
                self.1 = left;
                self.0.next()
            }
            None => Ok(None),
        }
    }
}

/// Where nobody knows how many frames come, those that came are all.
#[test]
fn a_source_may_end_at_any_time() {
    let capture = capture();
    let mut count = 0;
    let each = Each(|_: &crate::synth::ResultFrame| {
        count += 1;
        Ok(())
    });
    let outcome = job(Box::new(Live(capture.frames(), 37)), settings()).run(each, |_| ()).unwrap();
    assert_eq!((outcome.report.frames, count), (37, 37));
}

/// What a sink cannot take ends the job, and is why it ended.
#[test]
fn a_failure_of_a_sink_is_told() {
    let capture = capture();
    let full = Each(|result: &crate::synth::ResultFrame| match result.number {
        9 => Err(Error::Usage("the disk is full".into())),
        _ => Ok(()),
    });
    let unfinished = job(capture.frames(), settings()).run(full, |_| ()).unwrap_err();
    assert!(unfinished.left.unwrap().is_none());
    assert!(unfinished.error.to_string().contains("the disk is full"));
}

/// The truth is compared frame by frame, and has to be that of the recording.
#[test]
fn the_truth_is_compared() {
    let (capture, folder) = (capture(), tempfile::tempdir().unwrap());
    let path = folder.path().join("truth.npy");
    video::write(&path, &whole(&capture), Writing { half: false, ..Writing::default() }).unwrap();
    let outcome =
        job(capture.frames(), settings()).run(Truth::open(&path, EXTENTS).unwrap(), |_| ()).unwrap();
    assert!(outcome.output.psnr.is_infinite(), "{}", outcome.output);
    let error = Truth::open(&path, [150, 12, 17]).err().unwrap().to_string();
    assert!(error.contains("150×12×16 is not the size of the capture, 150×12×17"), "{error}");
}

//! Jobs and what becomes of them.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::{Left, Sink, Summary, Warning};
use crate::fingerprint::{Fingerprint, Fingerprinted};
use crate::network::Model;
use crate::sensor::{Recording, Source};
use crate::synth::{Backend, Report, Settings, Synthesizer, check_fits};
use crate::{Error, Result};

/// A source and settings, made ready: what cannot work has been said.
pub struct Job<'a> {
    source: Box<dyn Source + 'a>,
    settings: Settings,
    model: Model,
    backend: Backend,
    synthesizer: Synthesizer,
    warnings: Vec<Warning>,
}

/// What a job made.
#[derive(Debug)]
pub struct Outcome<O> {
    /// What the sink made of the frames.
    pub output: O,
    /// What the run did.
    pub report: Report,
    /// The same in figures, with what it ran on.
    pub summary: Summary,
}

/// A job that ended before its recording did.
#[derive(Debug)]
pub struct Unfinished {
    /// Why: [`Error::Stopped`] if somebody asked for that.
    pub error: Error,
    /// What is there, if the sink keeps that; or why that could not be kept.
    pub left: Result<Option<Left>>,
}

impl From<Unfinished> for Error {
    fn from(unfinished: Unfinished) -> Self {
        unfinished.error
    }
}

impl Fingerprinted for Job<'_> {
    /// All but its source.
    fn mark(&self, fingerprint: &mut Fingerprint) -> Result<()> {
        fingerprint.add(&self.settings)?;
        fingerprint.add(&self.model)?;
        fingerprint.add(&self.backend)
    }
}

impl<'a> Job<'a> {
    /// Loads the net, chooses where it runs, and makes it ready for the recording.
    pub fn new(source: Box<dyn Source + 'a>, settings: Settings) -> Result<Self> {
        let model = settings.model(&source.recording().sensor_pattern())?;
        let backend = settings.backend()?;
        Self::with(source, settings, model, backend)
    }

    /// As [`Job::new`], with a net that is loaded and a place that is open, as `settings` name them.
    pub fn with(
        source: Box<dyn Source + 'a>,
        settings: Settings,
        model: Model,
        backend: Backend,
    ) -> Result<Self> {
        let recording = source.recording();
        let warnings = check_fits(&model, recording)?.map(Warning::Response).into_iter().collect();
        let calibration = recording.calibration();
        let synthesizer = Synthesizer::new(&model, calibration, recording.extent(), &backend, &settings)?;
        synthesizer.accept(recording)?;
        Ok(Self { source, settings, model, backend, synthesizer, warnings })
    }

    /// What is known of the recording.
    pub fn recording(&self) -> &Recording {
        self.source.recording()
    }

    /// What a user should know before the job runs.
    pub fn warnings(&self) -> &[Warning] {
        &self.warnings
    }

    /// Set it from anywhere to end the run after the window that is being computed.
    pub fn stop(&self) -> Arc<AtomicBool> {
        self.synthesizer.stop()
    }

    /// Synthesises what the source delivers, behind the frames that the sink has already. `progress` is told how many
    /// frames there are after each one.
    pub fn run<S: Sink>(
        mut self,
        mut sink: S,
        mut progress: impl FnMut(usize) + Send,
    ) -> Result<Outcome<S::Output>, Unfinished> {
        let begun = sink.begun();
        let wanted = self.source.frames().map(|frames| frames.saturating_sub(begun));
        let run = self.synthesizer.stream(&mut *self.source, begun, |result| {
            sink.take(&result)?;
            progress(result.number + 1);
            Ok(())
        });
        let report = match run {
            Ok(report) if wanted.is_none_or(|wanted| wanted == report.frames) => report,
            // What is there stays, whatever the reason.
            outcome => {
                let error = outcome.err().unwrap_or(Error::Stopped);
                return Err(Unfinished { error, left: sink.suspend() });
            }
        };
        match sink.finish(&report) {
            Ok(output) => {
                let summary = Summary::of(&self.settings, &self.model, &self.backend, &report);
                Ok(Outcome { output, report, summary })
            }
            Err(error) => Err(Unfinished { error, left: Ok(None) }),
        }
    }
}

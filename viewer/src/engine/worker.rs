//! The engine's thread: it does what the mailbox asks for, one run after the other.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use rayon::{ThreadPool, ThreadPoolBuilder};

use super::arrival::Arrival;
use super::delivery::{Delivery, Overheard, Passing, Pending};
use super::mailbox::Mailbox;
use super::status::{About, Phase, Status};
use crate::camera::{LiveCamera, LiveRun, POLICY, Shared};
use crate::clock::CameraClock;
use crate::frame::Frame;
use crate::lock::lock;
use crate::source::{Opened, Opening, SourceName};
use crate::store::{Generation, Store};
use pix2hdr::gpu::{Gpu, GpuError, Results};
use pix2hdr::network::{Model, Window};
use pix2hdr::sensor::{CaptureFile, Source};
use pix2hdr::synth::live::{self, Backlog};
use pix2hdr::synth::{Backend, Settings, Skip, Synthesizer, check_fits};
use pix2hdr::video::Video;
use pix2hdr::{Error, Result};

/// How often a lost GPU is opened again before the engine gives up.
const REBUILDS: usize = 3;

/// By how much the engine is nicer than the interface.
#[cfg(target_os = "linux")]
const NICENESS: i32 = 5;

/// What the thread shows to the interface.
pub(super) struct Visible {
    pub(super) store: Arc<Store>,
    /// The clock of a live camera.
    pub(super) clock: Arc<CameraClock>,
    pub(super) status: Arc<Mutex<Status>>,
    pub(super) arrival: Arc<Arrival>,
}

/// What the thread works with.
pub(super) struct Worker {
    visible: Visible,
    mailbox: Arc<Mailbox>,
    /// The GPU that draws the window, if it may synthesise too.
    shared: Option<Gpu>,
    /// What renders, samples and filters: in the common pool it would wait behind the net.
    beside: ThreadPool,
    opening: Opening,
    settings: Settings,
    name: Option<SourceName>,
    source: Option<Opened>,
    backend: Option<Backend>,
    synthesizer: Option<Synthesizer>,
    /// The frame that the next run of a file begins with.
    from: usize,
    /// What of a live camera is delivered and what dropped.
    backlog: Backlog,
    rebuilds: usize,
}

impl Worker {
    /// Works until the mailbox says that this is enough.
    pub(super) fn work(
        visible: Visible,
        mailbox: Arc<Mailbox>,
        opening: Opening,
        settings: Settings,
        shared: Option<Gpu>,
    ) {
        yield_to_the_interface();
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let beside = match ThreadPoolBuilder::new().num_threads(cores.div_ceil(2)).build() {
            Ok(pool) => pool,
            Err(error) => {
                lock(&visible.status).phase = Phase::Failed(format!("no threads for the engine: {error}"));
                return;
            }
        };
        let worker = Self {
            visible,
            mailbox,
            beside,
            opening,
            backend: shared.clone().map(|gpu| Backend::Gpu(gpu, settings.precision)),
            shared,
            settings,
            name: None,
            source: None,
            synthesizer: None,
            from: 0,
            backlog: Backlog::new(POLICY),
            rebuilds: 0,
        };
        worker.run_until_quit();
    }

    fn run_until_quit(mut self) {
        while let Some(generation) = self.read_mail() {
            let outcome = self.run(generation);
            match outcome {
                _ if !self.mailbox.is_empty() => continue,
                Err(error) if is_lost(&error) && self.rebuilds < REBUILDS => {
                    self.rebuilds += 1;
                    (self.backend, self.synthesizer) = (None, None);
                    self.from = self.visible.store.span().map_or(self.from, |[_, last]| last + 1);
                    lock(&self.visible.status).notice = Some(format!("{error}; the engine was built anew"));
                    continue;
                }
                Err(error) => {
                    if error.cause::<GpuError>().is_some() {
                        // What has failed once is not used for the next source, or after the next seek.
                        (self.backend, self.synthesizer) = (None, None);
                    }
                    self.say(Phase::Failed(error.to_string()));
                }
                Ok(()) => self.say(Phase::Finished),
            }
            self.mailbox.wait();
        }
    }

    fn say(&self, phase: Phase) {
        lock(&self.visible.status).phase = phase;
    }

    /// Takes in what was asked for, and empties the store; `None` to end the thread.
    fn read_mail(&mut self) -> Option<Generation> {
        let mailbox = Arc::clone(&self.mailbox);
        let mut letters = mailbox.letters();
        if letters.quit {
            return None;
        }
        if let Some(settings) = letters.settings.take()
            && settings != self.settings
        {
            let place =
                |settings: &Settings| (settings.executor, settings.adapter.clone(), settings.precision);
            if place(&settings) != place(&self.settings) {
                self.backend = None;
            }
            self.synthesizer = None;
            self.settings = settings;
            self.rebuilds = 0;
        }
        if std::mem::take(&mut letters.exchanged) {
            (self.backend, self.synthesizer, self.shared) = (None, None, letters.shared.take());
        }
        self.from = letters.seek.take().unwrap_or(self.from);
        let mut status = lock(&self.visible.status);
        if let Some(name) = letters.open.take() {
            (self.source, self.synthesizer) = (None, None);
            (self.from, self.rebuilds) = (0, 0);
            *status =
                Status { about: About { name: name.to_string(), ..About::default() }, ..Status::default() };
            self.name = Some(name);
        } else {
            status.phase = Phase::Preparing;
            status.inference_ms.clear();
            status.computed.clear();
        }
        Some(self.visible.store.restart(self.from))
    }

    /// Opens what is not open yet, and synthesises until the end of the source or the next request.
    fn run(&mut self, generation: Generation) -> Result<()> {
        let source = match (self.source.take(), &self.name) {
            (Some(source), _) => source,
            (None, Some(name)) => Opened::open(name, &self.opening)?,
            (None, None) => return Ok(()),
        };
        let outcome = self.prepare(&source).and_then(|()| self.play(&source, generation));
        self.source = Some(source);
        outcome
    }

    /// What the settings ask for. If that is the GPU that draws the window, it computes too.
    fn choose(&self) -> Result<Backend> {
        let Settings { executor, adapter, precision, .. } = &self.settings;
        let chosen = Backend::choose(*executor, adapter.as_deref(), *precision)?;
        Ok(match (&chosen, &self.shared) {
            (Backend::Gpu(gpu, precision), Some(shared))
                if gpu.adapter() == shared.adapter() && shared.check().is_ok() =>
            {
                Backend::Gpu(shared.clone(), *precision)
            }
            _ => chosen,
        })
    }

    /// Begins to keep results on the GPU, if it draws the window and computes whole frames: tiles, skipped cells, the
    /// views of an ensemble and frames of a crop are put together in main memory.
    fn keep_results(&self, synthesizer: &Synthesizer) -> Option<Arc<Results>> {
        let Some(Backend::Gpu(gpu, _)) = &self.backend else { return None };
        let results = gpu.results()?;
        let Settings { skip, ensemble, .. } = self.settings;
        let whole = skip == Skip::Off && ensemble <= 1 && synthesizer.whole_frames();
        results.begin(whole);
        whole.then(|| Arc::clone(results))
    }

    /// Makes a synthesizer for the source.
    fn prepare(&mut self, source: &Opened) -> Result<()> {
        let [height, width] = source.extent()?;
        {
            let mut status = lock(&self.visible.status);
            let About { name, .. } = std::mem::take(&mut status.about);
            status.about =
                About { name, height, width, frames: source.frames(), period_ms: 1.0, ..About::default() };
        }
        let Ok(recording) = source.recording() else {
            "shown as it is".clone_into(&mut lock(&self.visible.status).executor);
            return Ok(());
        };
        let mut model = Model::load_for(&self.settings.weights, &recording.sensor_pattern())?;
        let warning = check_fits(&model, &recording)?;
        let backend = match self.backend.take() {
            Some(backend) => backend,
            None => self.choose()?,
        };
        if self.settings.hop.is_none() {
            live::shorten(&mut model.graph)?;
        }
        {
            let mut status = lock(&self.visible.status);
            let place = backend.adapter().unwrap_or_else(|| "CPU".into());
            status.executor = format!("{} on {place}, {}", model.graph.name, backend.precision().name());
            let warnings: Vec<String> =
                warning.into_iter().chain(source.findings().iter().map(ToString::to_string)).collect();
            if !warnings.is_empty() {
                status.notice = Some(warnings.join("\n"));
            }
            status.recording = Some(Arc::new(recording.clone()));
            status.about.period_ms = recording.info.frame_period_ms;
            status.about.pattern = Some(recording.pattern.name().to_owned());
        }
        let synthesizer = match self.synthesizer.take() {
            Some(synthesizer) => synthesizer,
            None => {
                Synthesizer::new(&model, recording.calibration(), [height, width], &backend, &self.settings)?
            }
        };
        {
            let mut status = lock(&self.visible.status);
            status.hop = synthesizer.window().hop;
            // A live source has to wait for the end of its exposures, and for the window's frames behind.
            let Window { frames, lead, .. } = synthesizer.window();
            status.about.latency = recording.pattern.longest_readout() + frames - lead;
        }
        self.synthesizer = Some(synthesizer);
        self.backend = Some(backend);
        Ok(())
    }

    fn play(&mut self, source: &Opened, generation: Generation) -> Result<()> {
        let Some(mut synthesizer) = self.synthesizer.take() else {
            return match source {
                Opened::Plain(video) => {
                    self.show(video, generation);
                    Ok(())
                }
                _ => Ok(()),
            };
        };
        let outcome = match source {
            Opened::Live(camera) => self.live(camera, &mut synthesizer, generation),
            Opened::File { path, truth, .. } => {
                let frames = CaptureFile::open(path, &self.opening.keys).map(CaptureFile::into_frames);
                frames.and_then(|frames| self.file(frames, truth.as_ref(), &mut synthesizer, generation))
            }
            Opened::Sampled(capture, truth) => {
                self.file(capture.frames(), Some(truth), &mut synthesizer, generation)
            }
            Opened::Plain(_) => Ok(()),
        };
        self.synthesizer = Some(synthesizer);
        outcome
    }

    /// Shows a video as it is.
    fn show(&self, video: &Video, generation: Generation) {
        self.say(Phase::Running);
        for t in self.from..video.frames {
            let Video { height, width, .. } = *video;
            let ours = Some(video.frame(t).to_vec());
            let frame = Frame { number: t, height, width, ours, ..Frame::default() };
            if !self.visible.store.push_patiently(generation, frame) {
                break;
            }
            self.visible.arrival.announce();
        }
    }

    /// Synthesises the frames of a file.
    fn file(
        &self,
        frames: Box<dyn Source + '_>,
        truth: Option<&Arc<Video>>,
        synthesizer: &mut Synthesizer,
        generation: Generation,
    ) -> Result<()> {
        let pending = Pending::default();
        let mut heard = Overheard { frames, next: 0, from: self.from, truth, pending: &pending };
        let results = self.keep_results(synthesizer);
        let delivery = self.delivery(&heard, generation, 0, true, results);
        if !self.mailbox.arm(&synthesizer.stop()) {
            return Ok(());
        }
        self.say(Phase::Running);
        synthesizer.stream(&mut heard, self.from, |frame| delivery.deliver(frame, &pending)).map(drop)
    }

    /// Synthesises what a live camera sees. Where it drops frames, one recording ends and the next one begins.
    fn live(
        &mut self,
        camera: &LiveCamera,
        synthesizer: &mut Synthesizer,
        generation: Generation,
    ) -> Result<()> {
        let stop = synthesizer.stop();
        if lock(&self.visible.status).frames == 0 {
            self.backlog = Backlog::new(POLICY);
            self.visible.clock.set(POLICY.head_start() as f64, Instant::now());
        }
        loop {
            if !self.mailbox.arm(&stop) {
                return Ok(());
            }
            let (begin, dropped) = self.backlog.begin(self.visible.clock.exposed(Instant::now()));
            lock(&self.visible.status).dropped += dropped as u64;
            self.say(Phase::Running);
            let pending = Pending::default();
            let (clock, stop) = (Arc::clone(&self.visible.clock), Arc::clone(&stop));
            let shared = Shared { clock, stop, beside: &self.beside };
            let (status, [height, width]) = (Arc::clone(&self.visible.status), camera.extent());
            let mut frames = LiveRun::new(camera, begin, shared, |number, mosaic, truth| {
                let (mosaic, truth) = (mosaic.to_vec(), Some(truth.to_vec()));
                let mut status = lock(&status);
                if status.frames == 0 && status.arriving.len() < POLICY.head_start() {
                    let (mosaic, truth) = (Some(mosaic.clone()), truth.clone());
                    let frame = Frame { number, height, width, mosaic, truth, ..Frame::default() };
                    status.arriving.push_back(Arc::new(frame));
                }
                drop(status);
                lock(&pending).push_back(Passing { number, mosaic, truth });
            })?;
            let results = self.keep_results(synthesizer);
            let delivery = self.delivery(&frames, generation, begin, false, results);
            let outcome = synthesizer.stream(&mut frames, 0, |frame| delivery.deliver(frame, &pending));
            let delivered = delivery.count.load(Ordering::Relaxed) as usize;
            drop(frames);
            lock(&self.visible.status).dropped += self.backlog.end(delivered) as u64;
            outcome?;
        }
    }

    /// What takes results of `frames`.
    fn delivery(
        &self,
        frames: &dyn Source,
        generation: Generation,
        begin: usize,
        patient: bool,
        results: Option<Arc<Results>>,
    ) -> Delivery<'_> {
        let recording = frames.recording();
        Delivery {
            beside: &self.beside,
            store: &self.visible.store,
            status: &self.visible.status,
            arrival: &self.visible.arrival,
            results,
            calibration: recording.calibration(),
            schedule_start: recording.info.schedule_start,
            extent: [recording.height, recording.width],
            generation,
            begin,
            patient,
            count: AtomicU64::new(0),
        }
    }
}

/// Whether a GPU has gone.
fn is_lost(error: &Error) -> bool {
    error.cause().is_some_and(GpuError::is_lost)
}

/// Lowers the priority of this thread, and so of those that it starts: a window that software draws needs the same cores,
/// and a user notices the interface's milliseconds, not the engine's. Only Linux has priorities of threads that can be
/// had without privileges and inherited; elsewhere nothing is done.
fn yield_to_the_interface() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::nice(NICENESS) {
        tracing::info!("the engine keeps its priority: {error}");
    }
}

//! The thread that opens sources and synthesises. Nobody waits for it: requests are left in a mailbox, frames appear in
//! the [`Store`], and [`Status`] says how it is.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::camera::{BLOCK, HEAD_START, LiveCamera, LiveRun, Shared};
use crate::clock::CameraClock;
use crate::frame::{Computed, Frame};
use crate::source::{Opening, Request, Source};
use crate::store::{Generation, Store};
use pix2hdr::baseline::box_filter;
use pix2hdr::gpu::{Gpu, GpuError, Results};
use pix2hdr::network::{Graph, Model, Precision, Window};
use pix2hdr::sensor::{Calibration, CaptureFile, Recording};
use pix2hdr::synth::{self, Backend, ResultFrame, Skip, Synthesizer, check_fits};
use pix2hdr::video::Video;
use pix2hdr::{Error, Result};

/// Frames of which the times are kept.
pub const HISTORY: usize = 240;
/// How often a lost GPU is opened again before the engine gives up.
const REBUILDS: usize = 3;

/// By how much the engine is nicer than the interface.
#[cfg(target_os = "linux")]
const NICENESS: i32 = 5;

/// How long a viewer that is closed waits for the engine.
const FAREWELL: Duration = Duration::from_secs(2);
/// Result frames of a window, where the user says nothing and the net can do with fewer than its own number: a picture is
/// there sooner, and requests take effect sooner, for half as much computation again.
const HOP: usize = 32;

/// What of the engine can be changed while it runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Dials {
    /// Weights file or preset.
    pub weights: String,
    /// Where the net runs.
    pub executor: synth::ExecutorChoice,
    /// Part of an adapter's name.
    pub adapter: Option<String>,
    /// How features and weights are stored.
    pub precision: Precision,
    /// What may be left out.
    pub skip: Skip,
    /// Longest side of a tile in pixels.
    pub side: Option<usize>,
    /// Result frames of a window.
    pub hop: Option<usize>,
    /// Views of which the mean is taken.
    pub ensemble: usize,
}

/// What is known of the source.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct About {
    /// Its name.
    pub name: String,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Number of frames; `None` for a live source.
    pub frames: Option<usize>,
    /// Duration of a frame.
    pub period_ms: f64,
    /// Name of the pattern, if there is a camera.
    pub pattern: Option<String>,
    /// What a live camera costs: its longest exposure in frames, and those of a result's window.
    pub latency: usize,
}

/// What the engine is doing.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Phase {
    /// It opens a source, or compiles shaders.
    #[default]
    Preparing,
    /// It synthesises.
    Running,
    /// All frames are there.
    Finished,
    /// It cannot, for this reason.
    Failed(String),
}

/// How the engine is.
#[derive(Clone, Debug, Default)]
pub struct Status {
    /// What it is doing.
    pub phase: Phase,
    /// What it does it with, in words; empty before that is known.
    pub executor: String,
    /// What is looked at.
    pub about: About,
    /// What is known of the camera. A plain video has none.
    pub recording: Option<Arc<Recording>>,
    /// What the user should know, besides failures.
    pub notice: Option<String>,
    /// Milliseconds of the net per frame: the last ones, oldest first.
    pub inference_ms: VecDeque<f32>,
    /// Part of the cells that was computed, frame by frame as above; 1 where nothing may be skipped.
    pub computed: VecDeque<f32>,
    /// When the last frames were delivered.
    pub delivered: VecDeque<Instant>,
    /// Frames that a live camera dropped.
    pub dropped: u64,
    /// Frames delivered since the source was opened.
    pub frames: u64,
    /// Frames of a window.
    pub hop: usize,
    /// What a live camera has delivered, until the first result is there.
    pub arriving: VecDeque<Arc<Frame>>,
}

impl Status {
    /// Frames delivered per second, over the last five seconds: they come in bursts, a window at a time.
    pub fn frames_per_s(&self, now: Instant) -> f64 {
        let age = |t: &Instant| now.saturating_duration_since(*t).as_secs_f64();
        let span = self.delivered.front().map_or(5.0, age).clamp(1.0, 5.0);
        self.delivered.iter().filter(|t| age(t) <= span).count() as f64 / span
    }

    /// The frame that a live camera, which has exposed so many, shows before there is a result.
    pub fn preview(&self, exposed: f64) -> Option<&Arc<Frame>> {
        let number = (exposed as usize).saturating_sub(HEAD_START);
        self.arriving.iter().rfind(|frame| frame.number <= number).or(self.arriving.front())
    }

    /// Median milliseconds per frame of the last ones.
    pub fn median_ms(&self) -> Option<f32> {
        let mut times: Vec<f32> = self.inference_ms.iter().copied().collect();
        times.sort_unstable_by(f32::total_cmp);
        times.get(times.len() / 2).copied()
    }

    fn add(&mut self, frame: &Frame) {
        fn keep<T>(values: &mut VecDeque<T>, value: T, most: usize) {
            if values.len() == most {
                values.pop_front();
            }
            values.push_back(value);
        }
        keep(&mut self.inference_ms, 1e3 * frame.inference.as_secs_f32(), HISTORY);
        keep(&mut self.computed, frame.computed.as_ref().map_or(1.0, |c| c.fraction() as f32), HISTORY);
        // Two seconds at the highest rates that are of use.
        keep(&mut self.delivered, Instant::now(), 4096);
        self.frames += 1;
        self.arriving.clear();
    }
}

/// What was asked for and not done yet.
#[derive(Debug, Default)]
struct Mailbox {
    open: Option<Request>,
    dials: Option<Dials>,
    seek: Option<usize>,
    /// The GPU that draws the window, if it may synthesise too, and whether it is another one now.
    shared: Option<Gpu>,
    exchanged: bool,
    quit: bool,
    /// Ends the present run.
    stop: Arc<AtomicBool>,
}

impl Mailbox {
    fn is_empty(&self) -> bool {
        self.open.is_none() && self.dials.is_none() && self.seek.is_none() && !self.exchanged && !self.quit
    }
}

/// The engine's thread, as the interface sees it. Dropped, the thread ends after the window that is being computed.
pub struct Engine {
    /// The frames.
    pub store: Arc<Store>,
    /// The clock of a live camera.
    pub clock: Arc<CameraClock>,
    status: Arc<Mutex<Status>>,
    mailbox: Arc<(Mutex<Mailbox>, Condvar)>,
    news: Arc<News>,
    thread: Option<JoinHandle<()>>,
}

/// Who is told when a frame is there that was waited for.
#[derive(Default)]
struct News {
    awaited: AtomicBool,
    tell: Mutex<Option<Box<dyn Fn() + Send>>>,
}

impl News {
    fn is_out(&self) {
        if self.awaited.swap(false, Ordering::Relaxed)
            && let Some(tell) = &*lock(&self.tell)
        {
            tell();
        }
    }
}

impl Engine {
    /// Starts the thread. Frames take at most `bytes` bytes.
    pub fn start(opening: Opening, request: Request, dials: Dials, bytes: usize) -> Self {
        Self::with(opening, request, dials, bytes, None)
    }

    /// As [`Engine::start`]. Where the dials ask for what `shared` is, that computes, and results stay on it for the
    /// window that it draws.
    pub fn with(opening: Opening, request: Request, dials: Dials, bytes: usize, shared: Option<Gpu>) -> Self {
        let store = Arc::new(Store::new(bytes));
        let clock = Arc::new(CameraClock::new(Instant::now()));
        let status = Arc::new(Mutex::new(Status::default()));
        let mailbox = Arc::new((
            Mutex::new(Mailbox { open: Some(request), dials: Some(dials.clone()), ..Mailbox::default() }),
            Condvar::new(),
        ));
        let news = Arc::new(News::default());
        let work = {
            let news = Arc::clone(&news);
            let (store, clock, status) = (Arc::clone(&store), Arc::clone(&clock), Arc::clone(&status));
            let mailbox = Arc::clone(&mailbox);
            // A scene stays on the thread that opened it.
            move || {
                yield_to_the_interface();
                let cores = std::thread::available_parallelism().map_or(1, usize::from);
                let beside = match ThreadPoolBuilder::new().num_threads(cores.div_ceil(2)).build() {
                    Ok(pool) => pool,
                    Err(error) => {
                        lock(&status).phase = Phase::Failed(format!("no threads for the engine: {error}"));
                        return;
                    }
                };
                let worker = Worker {
                    beside,
                    store,
                    clock,
                    status,
                    mailbox,
                    news,
                    opening,
                    backend: shared.clone().map(|gpu| Backend::Gpu(gpu, dials.precision)),
                    shared,
                    dials,
                    request: None,
                    source: None,
                    synthesizer: None,
                    from: 0,
                    due: 0,
                    rebuilds: 0,
                };
                worker.work();
            }
        };
        let thread = std::thread::Builder::new().name("engine".into()).spawn(work);
        let thread = match thread {
            Ok(thread) => Some(thread),
            Err(error) => {
                lock(&status).phase = Phase::Failed(format!("no thread for the engine: {error}"));
                None
            }
        };
        Self { store, clock, status, mailbox, news, thread }
    }

    /// Whether frame `number` is there, or a later one. If not, [`Engine::on_news`] says when one is.
    pub fn is_there(&self, number: usize) -> bool {
        self.news.awaited.store(true, Ordering::Relaxed);
        let there = self.store.span().is_some_and(|[_, last]| last >= number);
        self.news.awaited.fetch_and(!there, Ordering::Relaxed);
        there
    }

    /// What is done when a frame is there that was waited for.
    pub fn on_news(&self, tell: impl Fn() + Send + 'static) {
        *lock(&self.news.tell) = Some(Box::new(tell));
    }

    /// Goes on from frame `at` of a file with another GPU, or none, that draws the window.
    pub fn share(&self, gpu: Option<Gpu>, at: usize) {
        self.ask(|mailbox| {
            mailbox.shared = gpu;
            mailbox.exchanged = true;
            mailbox.seek = Some(at);
        });
    }

    fn ask(&self, change: impl FnOnce(&mut Mailbox)) {
        let mut mailbox = lock(&self.mailbox.0);
        change(&mut mailbox);
        mailbox.stop.store(true, Ordering::Relaxed);
        // A run that waits for room in the store gives up.
        self.store.restart(mailbox.seek.unwrap_or(0));
        self.mailbox.1.notify_all();
    }

    /// Opens another source.
    pub fn open(&self, request: Request) {
        self.ask(|mailbox| {
            mailbox.open = Some(request);
            mailbox.seek = None;
        });
    }

    /// Changes the dials, and goes on from frame `at` of a file.
    pub fn tune(&self, dials: Dials, at: usize) {
        self.ask(|mailbox| {
            mailbox.dials = Some(dials);
            mailbox.seek = Some(at);
        });
    }

    /// Goes on from frame `at` of a file.
    pub fn seek(&self, at: usize) {
        self.ask(|mailbox| mailbox.seek = Some(at));
    }

    /// How it is.
    pub fn status(&self) -> Status {
        lock(&self.status).clone()
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.ask(|mailbox| mailbox.quit = true);
        // A window of a large net on a slow machine takes longer than a user who closes the viewer waits.
        let asked = Instant::now();
        while self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) && asked.elapsed() < FAREWELL {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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

/// What the thread works with.
struct Worker {
    store: Arc<Store>,
    clock: Arc<CameraClock>,
    status: Arc<Mutex<Status>>,
    mailbox: Arc<(Mutex<Mailbox>, Condvar)>,
    news: Arc<News>,
    /// The GPU that draws the window, if it may synthesise too.
    shared: Option<Gpu>,
    /// What renders, samples and filters: in the common pool it would wait behind the net.
    beside: ThreadPool,
    opening: Opening,
    dials: Dials,
    request: Option<Request>,
    source: Option<Source>,
    backend: Option<Backend>,
    synthesizer: Option<Synthesizer>,
    /// The frame that the next run of a file begins with.
    from: usize,
    /// The first frame of a live camera that is neither delivered nor dropped.
    due: usize,
    rebuilds: usize,
}

/// Pixel values and truth of a frame that is on its way through the net.
struct Passing {
    number: usize,
    mosaic: Vec<f32>,
    truth: Option<Vec<f32>>,
}

/// Frames on their way, in order. As many as [`Synthesizer::stream`] lets wait.
type Pending = Mutex<VecDeque<Passing>>;

impl Worker {
    fn work(mut self) {
        while let Some(generation) = self.read_mail() {
            let outcome = self.run(generation);
            let interrupted = !lock(&self.mailbox.0).is_empty();
            match outcome {
                _ if interrupted => continue,
                Err(error) if is_lost(&error) && self.rebuilds < REBUILDS => {
                    self.rebuilds += 1;
                    (self.backend, self.synthesizer) = (None, None);
                    self.from = self.store.span().map_or(self.from, |[_, last]| last + 1);
                    lock(&self.status).notice = Some(format!("{error}; the engine was built anew"));
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
            let (mailbox, arrived) = &*self.mailbox;
            let mut mailbox = lock(mailbox);
            while mailbox.is_empty() {
                mailbox = arrived.wait(mailbox).unwrap_or_else(PoisonError::into_inner);
            }
        }
    }

    fn say(&self, phase: Phase) {
        lock(&self.status).phase = phase;
    }

    /// Takes in what was asked for, and empties the store; `None` to end the thread.
    fn read_mail(&mut self) -> Option<Generation> {
        let mailbox = Arc::clone(&self.mailbox);
        let mut mailbox = lock(&mailbox.0);
        if mailbox.quit {
            return None;
        }
        if let Some(dials) = mailbox.dials.take()
            && dials != self.dials
        {
            let place = |dials: &Dials| (dials.executor, dials.adapter.clone(), dials.precision);
            if place(&dials) != place(&self.dials) {
                self.backend = None;
            }
            self.synthesizer = None;
            self.dials = dials;
            self.rebuilds = 0;
        }
        if std::mem::take(&mut mailbox.exchanged) {
            (self.backend, self.synthesizer, self.shared) = (None, None, mailbox.shared.take());
        }
        self.from = mailbox.seek.take().unwrap_or(self.from);
        let mut status = lock(&self.status);
        if let Some(request) = mailbox.open.take() {
            (self.source, self.synthesizer) = (None, None);
            (self.from, self.rebuilds) = (0, 0);
            *status =
                Status { about: About { name: request.name(), ..About::default() }, ..Status::default() };
            self.request = Some(request);
        } else {
            status.phase = Phase::Preparing;
            status.inference_ms.clear();
            status.computed.clear();
        }
        Some(self.store.restart(self.from))
    }

    /// Makes `stop` the flag that ends the run; `false` if something was asked for in the meantime.
    fn arm(&self, stop: &Arc<AtomicBool>) -> bool {
        let mut mailbox = lock(&self.mailbox.0);
        if !mailbox.is_empty() {
            return false;
        }
        stop.store(false, Ordering::Relaxed);
        mailbox.stop = Arc::clone(stop);
        true
    }

    /// Opens what is not open yet, and synthesises until the end of the source or the next request.
    fn run(&mut self, generation: Generation) -> Result<()> {
        let source = match (self.source.take(), &self.request) {
            (Some(source), _) => source,
            (None, Some(request)) => Source::open(request, &self.opening)?,
            (None, None) => return Ok(()),
        };
        let outcome = self.prepare(&source).and_then(|()| self.play(&source, generation));
        self.source = Some(source);
        outcome
    }

    /// What the dials ask for. If that is the GPU that draws the window, it computes too.
    fn choose(&self) -> Result<Backend> {
        let Dials { executor, adapter, precision, .. } = &self.dials;
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

    /// Begins to keep results on the GPU, if it draws the window and computes whole frames: tiles, skipped cells and the
    /// views of an ensemble are put together in main memory.
    fn keep_results(&self, synthesizer: &Synthesizer) -> Option<Arc<Results>> {
        let Some(Backend::Gpu(gpu, _)) = &self.backend else { return None };
        let results = gpu.results()?;
        let Dials { skip, ensemble, .. } = self.dials;
        let whole = skip == Skip::Off && ensemble <= 1 && synthesizer.grid().count() == 1;
        results.begin(whole);
        whole.then(|| Arc::clone(results))
    }

    /// Makes a synthesizer for the source.
    fn prepare(&mut self, source: &Source) -> Result<()> {
        let [height, width] = source.extent()?;
        {
            let mut status = lock(&self.status);
            let About { name, .. } = std::mem::take(&mut status.about);
            status.about =
                About { name, height, width, frames: source.frames(), period_ms: 1.0, ..About::default() };
        }
        let Ok(recording) = source.recording() else {
            "shown as it is".clone_into(&mut lock(&self.status).executor);
            return Ok(());
        };
        let mut model = Model::load_for(&self.dials.weights, &recording.pattern)?;
        let warning = check_fits(&model, &recording)?;
        let &Dials { skip, side, hop, ensemble, .. } = &self.dials;
        let backend = match self.backend.take() {
            Some(backend) => backend,
            None => self.choose()?,
        };
        if hop.is_none() {
            shorten(&mut model.graph)?;
        }
        {
            let mut status = lock(&self.status);
            let place = backend.adapter().unwrap_or_else(|| "CPU".into());
            status.executor = format!("{} on {place}, {}", model.graph.name, backend.precision().name());
            status.notice = warning.or(status.notice.take());
            status.recording = Some(Arc::new(recording.clone()));
            status.about.period_ms = recording.info.frame_period_ms;
            status.about.pattern = Some(recording.pattern.name().to_owned());
        }
        let settings = synth::Settings { tile: side, skip, hop, ensemble, ..synth::Settings::default() };
        let synthesizer = match self.synthesizer.take() {
            Some(synthesizer) => synthesizer,
            None => Synthesizer::new(&model, recording.calibration(), [height, width], &backend, &settings)?,
        };
        {
            let mut status = lock(&self.status);
            status.hop = synthesizer.window().hop;
            // A live source has to wait for the end of its exposures, and for the window's frames behind.
            let Window { frames, lead, .. } = synthesizer.window();
            status.about.latency = recording.pattern.longest_readout() + frames - lead;
        }
        self.synthesizer = Some(synthesizer);
        self.backend = Some(backend);
        Ok(())
    }

    fn play(&mut self, source: &Source, generation: Generation) -> Result<()> {
        let Some(mut synthesizer) = self.synthesizer.take() else {
            return match source {
                Source::Plain(video) => {
                    self.show(video, generation);
                    Ok(())
                }
                _ => Ok(()),
            };
        };
        let outcome = match source {
            Source::Live(camera) => self.live(camera, &mut synthesizer, generation),
            Source::File { path, truth, .. } => {
                let frames = CaptureFile::open(path, &self.opening.keys).map(CaptureFile::into_frames);
                frames.and_then(|frames| self.file(frames, truth.as_ref(), &mut synthesizer, generation))
            }
            Source::Sampled(capture, truth) => {
                self.file(capture.frames(), Some(truth), &mut synthesizer, generation)
            }
            Source::Plain(_) => Ok(()),
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
            if !self.store.push_patiently(generation, frame) {
                break;
            }
            self.news.is_out();
        }
    }

    /// Synthesises the frames of a file.
    fn file(
        &self,
        frames: Box<dyn pix2hdr::sensor::Source + '_>,
        truth: Option<&Arc<Video>>,
        synthesizer: &mut Synthesizer,
        generation: Generation,
    ) -> Result<()> {
        let pending = Pending::default();
        let mut heard = Overheard { frames, next: 0, from: self.from, truth, pending: &pending };
        let results = self.keep_results(synthesizer);
        let delivery = self.delivery(&heard, generation, 0, true, results);
        if !self.arm(&synthesizer.stop()) {
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
        if lock(&self.status).frames == 0 {
            self.due = 0;
            self.clock.set(HEAD_START as f64, Instant::now());
        }
        loop {
            if !self.arm(&stop) {
                return Ok(());
            }
            let begin = LiveCamera::beginning(self.clock.exposed(Instant::now())).max(self.due);
            lock(&self.status).dropped += (begin - self.due) as u64;
            self.say(Phase::Running);
            let pending = Pending::default();
            let (clock, stop) = (Arc::clone(&self.clock), Arc::clone(&stop));
            let shared = Shared { clock, stop, beside: &self.beside };
            let (status, [height, width]) = (Arc::clone(&self.status), camera.extent());
            let mut frames = LiveRun::new(camera, begin, shared, |number, mosaic, truth| {
                let (mosaic, truth) = (mosaic.to_vec(), Some(truth.to_vec()));
                let mut status = lock(&status);
                if status.frames == 0 && status.arriving.len() < HEAD_START {
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
            // A block that was begun and not delivered is dropped.
            self.due = (begin + delivered).next_multiple_of(BLOCK);
            lock(&self.status).dropped += (self.due - begin - delivered) as u64;
            outcome?;
        }
    }

    /// What takes results of `frames`.
    fn delivery(
        &self,
        frames: &dyn pix2hdr::sensor::Source,
        generation: Generation,
        begin: usize,
        patient: bool,
        results: Option<Arc<Results>>,
    ) -> Delivery<'_> {
        let recording = frames.recording();
        Delivery {
            beside: &self.beside,
            store: &self.store,
            status: &self.status,
            news: &self.news,
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

/// Shorter windows than the net's own, for nets that give the same frames for any.
fn shorten(graph: &mut Graph) -> Result<()> {
    let Window { frames, lead, hop } = graph.window;
    let [reach, ..] = graph.reach()?;
    if hop > HOP && lead >= reach && frames - hop - lead >= reach {
        graph.window = Window { frames: frames - hop + HOP, lead, hop: HOP };
    }
    Ok(())
}

/// Whether a GPU has gone.
fn is_lost(error: &Error) -> bool {
    error.cause().is_some_and(GpuError::is_lost)
}

/// A source whose frames are remembered until their results are there.
struct Overheard<'a> {
    frames: Box<dyn pix2hdr::sensor::Source + 'a>,
    next: usize,
    from: usize,
    truth: Option<&'a Arc<Video>>,
    pending: &'a Pending,
}

impl pix2hdr::sensor::Source for Overheard<'_> {
    fn recording(&self) -> &Recording {
        self.frames.recording()
    }

    fn frames(&self) -> Option<usize> {
        self.frames.frames()
    }

    fn next(&mut self) -> Result<Option<pix2hdr::frame::Frame>> {
        let Some(frame) = self.frames.next()? else { return Ok(None) };
        if self.next >= self.from {
            let truth = self.truth.map(|truth| truth.frame(self.next).to_vec());
            let mosaic = frame.values().to_vec();
            lock(self.pending).push_back(Passing { number: self.next, mosaic, truth });
        }
        self.next += 1;
        Ok(Some(frame))
    }
}

/// Where results go.
struct Delivery<'a> {
    beside: &'a ThreadPool,
    store: &'a Store,
    status: &'a Mutex<Status>,
    news: &'a News,
    /// Where results are that stay on the GPU.
    results: Option<Arc<Results>>,
    calibration: Calibration,
    schedule_start: i64,
    extent: [usize; 2],
    generation: Generation,
    /// The number of the run's first frame.
    begin: usize,
    /// Whether frames wait for room, instead of pushing the oldest out.
    patient: bool,
    /// Frames delivered.
    count: AtomicU64,
}

impl Delivery<'_> {
    /// Puts a result with all else that is known of its frame into the store.
    fn deliver(&self, result: ResultFrame, pending: &Pending) -> Result<()> {
        let number = self.begin + result.number;
        let passing = {
            let mut pending = lock(pending);
            while pending.front().is_some_and(|passing| passing.number < number) {
                pending.pop_front();
            }
            pending.pop_front()
        };
        let t = self.schedule_start + result.number as i64;
        let on_gpu = self.results.as_ref().and_then(|results| results.take(t));
        let (mosaic, truth) = passing.map_or((None, None), |passing| (Some(passing.mosaic), passing.truth));
        let [height, width] = self.extent;
        let filtered = match &mosaic {
            Some(mosaic) => {
                let video = Video::new(1, height, width, mosaic.clone())?;
                Some(self.beside.install(|| box_filter(&video, &self.calibration, t)).data)
            }
            None => None,
        };
        let frame = Frame {
            number,
            height,
            width,
            mosaic,
            filtered,
            ours: Some(
                Arc::try_unwrap(result.frame)
                    .map_or_else(|frame| frame.values().to_vec(), pix2hdr::frame::Frame::into_values),
            ),
            on_gpu,
            truth,
            computed: result.computed.map(|(active, slab)| Computed { active, slab, cell: result.cell }),
            inference: result.inference,
        };
        lock(self.status).add(&frame);
        let kept = if self.patient {
            self.store.push_patiently(self.generation, frame)
        } else {
            self.store.push(self.generation, frame)
        };
        if !kept {
            return Err(Error::Stopped);
        }
        self.count.fetch_add(1, Ordering::Relaxed);
        self.news.is_out();
        Ok(())
    }
}

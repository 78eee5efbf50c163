//! The thread that opens sources and synthesises. Nobody waits for it: what is asked for is left in a mailbox, frames
//! appear in the [`Store`], and [`Status`] says how it is.

mod arrival;
mod delivery;
mod mailbox;
mod status;
mod worker;

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use arrival::Arrival;
use mailbox::{Letters, Mailbox};
use worker::{Visible, Worker};

use crate::clock::CameraClock;
use crate::lock::lock;
use crate::source::{Opening, SourceName};
use crate::store::Store;
use pix2hdr::gpu::Gpu;
use pix2hdr::synth::Settings;

pub use status::{About, HISTORY, Phase, Status};

/// How long a viewer that is closed waits for the engine.
const FAREWELL: Duration = Duration::from_secs(2);

/// The engine's thread, as the interface sees it. Dropped, the thread ends after the window that is being computed.
pub struct Engine {
    /// The frames.
    pub store: Arc<Store>,
    /// The clock of a live camera.
    pub clock: Arc<CameraClock>,
    status: Arc<Mutex<Status>>,
    mailbox: Arc<Mailbox>,
    arrival: Arc<Arrival>,
    thread: Option<JoinHandle<()>>,
}

impl Engine {
    /// Starts the thread, which opens `source`. Frames take at most `bytes` bytes.
    pub fn start(opening: Opening, source: SourceName, settings: Settings, bytes: usize) -> Self {
        Self::with(opening, source, settings, bytes, None)
    }

    /// As [`Engine::start`]. Where the settings ask for what `shared` is, that computes, and results stay on it for the
    /// window that it draws.
    pub fn with(
        opening: Opening,
        source: SourceName,
        settings: Settings,
        bytes: usize,
        shared: Option<Gpu>,
    ) -> Self {
        let store = Arc::new(Store::new(bytes));
        let clock = Arc::new(CameraClock::new(Instant::now()));
        let status = Arc::new(Mutex::new(Status::default()));
        let mailbox = Arc::new(Mailbox::new(source));
        let arrival = Arc::<Arrival>::default();
        let visible = Visible {
            store: Arc::clone(&store),
            clock: Arc::clone(&clock),
            status: Arc::clone(&status),
            arrival: Arc::clone(&arrival),
        };
        // A scene stays on the thread that opened it, so the worker is made there.
        let work = {
            let mailbox = Arc::clone(&mailbox);
            move || Worker::work(visible, mailbox, opening, settings, shared)
        };
        let thread = std::thread::Builder::new().name("engine".into()).spawn(work);
        if let Err(error) = &thread {
            lock(&status).phase = Phase::Failed(format!("no thread for the engine: {error}"));
        }
        Self { store, clock, status, mailbox, arrival, thread: thread.ok() }
    }

    /// Whether frame `number` is there, or a later one. If not, [`Engine::on_arrival`] says when one is.
    pub fn is_there(&self, number: usize) -> bool {
        self.arrival.check(|| self.store.span().is_some_and(|[_, last]| last >= number))
    }

    /// What is done when a frame is there that was waited for.
    pub fn on_arrival(&self, tell: impl Fn() + Send + 'static) {
        self.arrival.on(tell);
    }

    /// Goes on from frame `at` of a file with another GPU, or none, that draws the window.
    pub fn share(&self, gpu: Option<Gpu>, at: usize) {
        self.ask(|letters| {
            letters.shared = gpu;
            letters.exchanged = true;
            letters.seek = Some(at);
        });
    }

    fn ask(&self, write: impl FnOnce(&mut Letters)) {
        self.mailbox.ask(|letters| {
            write(letters);
            // A run that waits for room in the store gives up.
            self.store.restart(letters.seek.unwrap_or(0));
        });
    }

    /// Opens another source.
    pub fn open(&self, source: SourceName) {
        self.ask(|letters| {
            letters.open = Some(source);
            letters.seek = None;
        });
    }

    /// Changes the settings, and goes on from frame `at` of a file.
    pub fn tune(&self, settings: Settings, at: usize) {
        self.ask(|letters| {
            letters.settings = Some(settings);
            letters.seek = Some(at);
        });
    }

    /// Goes on from frame `at` of a file.
    pub fn seek(&self, at: usize) {
        self.ask(|letters| letters.seek = Some(at));
    }

    /// How it is.
    pub fn status(&self) -> Status {
        lock(&self.status).clone()
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.ask(|letters| letters.quit = true);
        // A window of a large net on a slow machine takes longer than a user who closes the viewer waits.
        let asked = Instant::now();
        while self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) && asked.elapsed() < FAREWELL {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

//! What the interface asks of the engine: requests are left here, and nobody waits.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use crate::lock::lock;
use crate::source::SourceName;
use pix2hdr::gpu::Gpu;
use pix2hdr::synth::Settings;

/// What was asked for and not done yet.
#[derive(Debug, Default)]
pub(super) struct Letters {
    /// A source to open.
    pub(super) open: Option<SourceName>,
    /// How to synthesise from now on.
    pub(super) settings: Option<Settings>,
    /// The frame of a file to go on from.
    pub(super) seek: Option<usize>,
    /// The GPU that draws the window, if it may synthesise too, and whether it is another one now.
    pub(super) shared: Option<Gpu>,
    pub(super) exchanged: bool,
    /// Whether the thread is to end.
    pub(super) quit: bool,
    /// Ends the present run.
    stop: Arc<AtomicBool>,
}

impl Letters {
    fn is_empty(&self) -> bool {
        self.open.is_none() && self.settings.is_none() && self.seek.is_none() && !self.exchanged && !self.quit
    }
}

/// The mailbox.
#[derive(Debug, Default)]
pub(super) struct Mailbox {
    letters: Mutex<Letters>,
    arrived: Condvar,
}

impl Mailbox {
    /// A mailbox with what the engine begins with.
    pub(super) fn new(open: SourceName) -> Self {
        let letters = Letters { open: Some(open), ..Letters::default() };
        Self { letters: Mutex::new(letters), arrived: Condvar::new() }
    }

    /// What was asked for; nothing is added until it is let go.
    pub(super) fn letters(&self) -> MutexGuard<'_, Letters> {
        lock(&self.letters)
    }

    /// Asks for something, which ends the present run.
    pub(super) fn ask(&self, write: impl FnOnce(&mut Letters)) {
        let mut letters = self.letters();
        write(&mut letters);
        letters.stop.store(true, Ordering::Relaxed);
        self.arrived.notify_all();
    }

    /// Whether all was done that was asked for.
    pub(super) fn is_empty(&self) -> bool {
        self.letters().is_empty()
    }

    /// Waits until something is asked for.
    pub(super) fn wait(&self) {
        let mut letters = self.letters();
        while letters.is_empty() {
            letters = self.arrived.wait(letters).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Makes `stop` the flag that ends the run; `false` if something was asked for in the meantime.
    pub(super) fn arm(&self, stop: &Arc<AtomicBool>) -> bool {
        let mut letters = self.letters();
        if !letters.is_empty() {
            return false;
        }
        stop.store(false, Ordering::Relaxed);
        letters.stop = Arc::clone(stop);
        true
    }
}

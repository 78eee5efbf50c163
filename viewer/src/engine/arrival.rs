//! Who is told when a frame is there that was waited for.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::lock::lock;

/// A frame that somebody may wait for.
#[derive(Default)]
pub(super) struct Arrival {
    awaited: AtomicBool,
    tell: Mutex<Option<Box<dyn Fn() + Send>>>,
}

impl Arrival {
    /// What is done when a frame is there that was waited for.
    pub(super) fn on(&self, tell: impl Fn() + Send + 'static) {
        *lock(&self.tell) = Some(Box::new(tell));
    }

    /// Whether `is_there`. If not, the next frame is waited for.
    pub(super) fn check(&self, is_there: impl FnOnce() -> bool) -> bool {
        // In this order: a frame that comes in between is announced.
        self.awaited.store(true, Ordering::Relaxed);
        let there = is_there();
        self.awaited.fetch_and(!there, Ordering::Relaxed);
        there
    }

    /// Says that a frame is there.
    pub(super) fn announce(&self) {
        if self.awaited.swap(false, Ordering::Relaxed)
            && let Some(tell) = &*lock(&self.tell)
        {
            tell();
        }
    }
}

//! Ctrl-C.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::Result;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// Exit code of a program that Ctrl-C ended.
pub const INTERRUPTED: u8 = 130;

/// What Ctrl-C does: end the program at once, unless somebody has something to complete.
pub struct Interrupt {
    /// Whether the next one ends the program.
    ends: Arc<AtomicBool>,
}

impl Interrupt {
    /// Ctrl-C ends the program at once, with its exit code.
    pub fn install() -> Result<Self> {
        let ends = Arc::new(AtomicBool::new(true));
        for signal in [SIGINT, SIGTERM] {
            // In this order: the signal that says so is not the one that ends the program.
            flag::register_conditional_shutdown(signal, i32::from(INTERRUPTED), Arc::clone(&ends))?;
            flag::register(signal, Arc::clone(&ends))?;
        }
        Ok(Self { ends })
    }

    /// The next Ctrl-C sets `stop`; the one behind it ends the program.
    pub fn stops(&self, stop: &Arc<AtomicBool>) -> Result<()> {
        for signal in [SIGINT, SIGTERM] {
            flag::register(signal, Arc::clone(stop))?;
        }
        self.ends.store(false, Ordering::SeqCst);
        Ok(())
    }
}

//! Lines for the user.

use std::time::{Duration, Instant};

/// How long messages are shown.
pub(crate) const MESSAGE_TIME: Duration = Duration::from_secs(8);

/// A line for the user.
#[derive(Clone, Debug)]
pub(crate) struct Message {
    pub(crate) text: String,
    pub(crate) bad: bool,
    pub(crate) since: Instant,
}

impl Message {
    pub(crate) fn good(text: String) -> Self {
        Self { text, bad: false, since: Instant::now() }
    }

    pub(crate) fn bad(text: String) -> Self {
        Self { text, bad: true, since: Instant::now() }
    }
}

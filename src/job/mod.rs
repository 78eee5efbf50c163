//! The one way in which a recording is synthesised: a source, settings and a sink make a [`Job`], and it makes an outcome.
//!
//! [`Sink`] says what takes result frames; sinks are put together as tuples. [`Resumable`] writes a video that can be gone
//! on with, as [`Fingerprint`](crate::fingerprint::Fingerprint) allows; [`Sheet`] collects a contact sheet, [`Truth`]
//! compares, [`InMemory`] keeps all frames. Nothing here prints: warnings and failures are values.

mod in_memory;
mod resumable;
mod run;
mod sheet;
mod sink;
mod summary;
#[cfg(test)]
mod tests;
mod truth;
mod warning;

pub use crate::fingerprint::{Fingerprint, Fingerprinted};
pub use crate::synth::Settings;
pub use in_memory::InMemory;
pub use resumable::{Begin, Resumable, ResumeError};
pub use run::{Job, Outcome, Unfinished};
pub use sheet::{Sheet, contact_sheet, shown_frames};
pub use sink::{Each, Left, Sink};
pub use summary::Summary;
pub use truth::Truth;
pub use warning::Warning;

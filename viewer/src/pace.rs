//! How the interface keeps up.

use std::time::Instant;

use pix2hdr::system;

/// How the interface kept up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pace {
    /// Seconds since the window opened.
    pub seconds: f64,
    /// Passes of the interface.
    pub passes: usize,
    /// Milliseconds from one pass to the next: median, 95th percentile, largest.
    pub interval_ms: [f64; 3],
    /// Milliseconds that a pass took: median, 95th percentile, largest.
    pub pass_ms: [f64; 3],
    /// Milliseconds from the start to the first pass, and to the first picture, if there was one.
    pub start_ms: [Option<f64>; 2],
    /// Median milliseconds of the net per frame, of the last ones.
    pub net_ms: Option<f32>,
    /// Whether results are drawn where the GPU left them.
    pub on_gpu: bool,
    /// Frames that were delivered.
    pub frames: u64,
    /// Frames that the camera dropped.
    pub dropped: u64,
    /// Bytes of memory of the process after ten seconds (or half of the time), and at the end; `None` where the system
    /// does not say.
    pub memory: [Option<u64>; 2],
    /// What failed, if anything did.
    pub failure: Option<String>,
}

/// Times of the interface's passes.
pub(crate) struct Measured {
    pub(crate) begun: Instant,
    /// The first pass, and the first picture.
    pub(crate) first: [Option<Instant>; 2],
    pub(crate) intervals: Vec<f32>,
    pub(crate) passes: Vec<f32>,
    pub(crate) memory: Option<u64>,
}

impl Measured {
    /// Of a viewer that has been about to start since `begun`.
    pub(crate) fn new(begun: Instant) -> Self {
        Self { begun, first: [None; 2], intervals: Vec::new(), passes: Vec::new(), memory: None }
    }
}

/// Bytes of memory that the process holds, where the system says (Linux).
pub(crate) fn resident_bytes() -> Option<u64> {
    system::status("VmRSS:")
}

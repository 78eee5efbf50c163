//! What of the engine can be changed while it runs.

use pix2hdr::network::Precision;
use pix2hdr::synth::{self, Skip};

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

//! What a run did.

use std::time::Duration;

use super::skip::Skipped;

/// What a run did.
#[derive(Clone, Debug)]
pub struct Report {
    /// Result frames that were delivered.
    pub frames: usize,
    /// Windows.
    pub windows: usize,
    /// Tiles per window, where all of it is computed.
    pub tiles: usize,
    /// Time from one finished window to the next, everything included, for each result frame of it that was delivered.
    pub frame_times: Vec<Duration>,
    /// The executor, in words.
    pub executor: String,
    /// Operations of the convolutions per result frame, where all of it is computed.
    pub flop_per_frame: f64,
    /// Time of the whole run, from the first frame read to the last one delivered.
    pub wall: Duration,
    /// Part of it in which the executors computed or were waited for.
    pub inference: Duration,
    /// Part of it in which the gate chose what to compute.
    pub gating: Duration,
    /// What was left out, if that was allowed.
    pub skipping: Option<Skipped>,
}

impl Report {
    /// Median time per result frame in milliseconds.
    pub fn ms_per_frame(&self) -> f64 {
        self.quantile_ms(0.5)
    }

    /// A quantile over windows of the time per result frame, in milliseconds.
    pub fn quantile_ms(&self, quantile: f64) -> f64 {
        let mut times = self.frame_times.clone();
        times.sort_unstable();
        let index = ((times.len() as f64 * quantile) as usize).min(times.len().saturating_sub(1));
        times.get(index).map_or(0.0, |time| 1e3 * time.as_secs_f64())
    }

    /// Mean time per result frame in milliseconds, from the first frame read to the last one delivered.
    pub fn mean_ms(&self) -> f64 {
        1e3 * self.wall.as_secs_f64() / self.frames.max(1) as f64
    }
}

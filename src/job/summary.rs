//! A run in figures.

use serde::Serialize;

use crate::network::Model;
use crate::synth::{Backend, Report, Settings, Skipped};
use crate::system::version;

/// A run in figures, for reports.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Version of this program, with its commit.
    pub version: &'static str,
    /// All settings, as they were chosen.
    pub settings: Settings,
    /// The weights' digest in hexadecimal, as [`Model::digest`] has it.
    pub weights_digest: String,
    /// Weights file, or name of a preset.
    pub weights: String,
    /// Name of the net.
    pub net: String,
    /// `gpu` or `cpu`.
    pub executor: &'static str,
    /// Name of the adapter, if there is one.
    pub adapter: Option<String>,
    /// `f32` or `f16`.
    pub precision: &'static str,
    /// `off`, `exact` or `bounded`.
    pub skip: &'static str,
    /// Views of which the mean was taken.
    pub ensemble: usize,
    /// Result frames that were delivered.
    pub frames: usize,
    /// Windows.
    pub windows: usize,
    /// Tiles of a window, where all of it is computed.
    pub tiles: usize,
    /// Median over windows of the time per result frame.
    pub ms_per_frame_median: f64,
    /// Mean time per result frame, from the first frame read to the last one delivered.
    pub ms_per_frame_end_to_end: f64,
    /// 10⁹ operations of the convolutions per result frame, where all of it is computed.
    pub gflop_per_frame: f64,
    /// The executor, in words.
    pub ran_on: String,
    /// Time in which the executors computed or were waited for.
    pub inference_seconds: f64,
    /// What was left out, if that was allowed.
    pub skipped: Option<SkipSummary>,
}

/// What was left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SkipSummary {
    /// Share of the cells that were computed.
    pub cells_computed_fraction: f64,
    /// Operations, as a part of those without skipping.
    pub work_fraction: f64,
    /// Windows computed in whole.
    pub whole_windows: usize,
    /// Largest change of l that a kept result may hide.
    pub allowed_error: f64,
    /// Root mean square of the error of kept results, where it was checked.
    pub error_rms: Option<f64>,
    /// The largest of them.
    pub error_largest: Option<f64>,
    /// Where the noise comes from.
    pub noise: &'static str,
}

impl Summary {
    pub(super) fn of(settings: &Settings, model: &Model, backend: &Backend, run: &Report) -> Self {
        Self {
            version: version(),
            settings: settings.clone(),
            weights_digest: format!("{:016x}", model.digest()),
            weights: settings.weights.clone(),
            net: model.graph.name.clone(),
            executor: backend.name(),
            adapter: backend.adapter(),
            precision: backend.precision().name(),
            skip: settings.skip.name(),
            ensemble: settings.ensemble,
            frames: run.frames,
            windows: run.windows,
            tiles: run.tiles,
            ms_per_frame_median: run.ms_per_frame(),
            ms_per_frame_end_to_end: run.mean_ms(),
            gflop_per_frame: run.flop_per_frame / 1e9,
            ran_on: run.executor.clone(),
            inference_seconds: run.inference.as_secs_f64(),
            skipped: run.skipping.as_ref().map(SkipSummary::of),
        }
    }
}

impl SkipSummary {
    fn of(skipped: &Skipped) -> Self {
        let error_rms = skipped.audit.rms();
        Self {
            cells_computed_fraction: skipped.active_fraction(),
            work_fraction: skipped.work,
            whole_windows: skipped.whole_windows,
            allowed_error: skipped.allowed_error,
            error_rms,
            error_largest: error_rms.map(|_| skipped.audit.largest),
            noise: skipped.noise,
        }
    }
}

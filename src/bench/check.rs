//! How exact an executor is: against the oracle, which is the CPU executor at f64.

use super::Clip;
use super::clip::crop;
use crate::Result;
use crate::cpu::CpuExecutor;
use crate::cpu::bound::step_errors;
use crate::frame::Plane;
use crate::math::lcm;
use crate::network::{Executor, Inspect, Model, Plan, Precision};
use crate::quality::Comparison;
use crate::sensor::Calibration;
use crate::synth::windows;
use crate::video::Video;

/// An exact result reads as this many dB: the oracle's own result is rounded to f32, so more says nothing.
const MOST_DB: f64 = 200.0;

/// The exact result of one window, or of its middle where the whole would take too long.
pub struct Oracle {
    /// Number of the window.
    k: i64,
    /// Whether it is the whole frame.
    whole: bool,
    plan: Plan,
    calibration: Calibration,
    measurement: Video,
    schedule: i64,
    /// Frames that are results, of the clip's size if `whole`.
    exact: Video,
}

impl Oracle {
    /// Computes a window of `clip`, of which so much is taken that it needs at most `flop_limit` operations.
    pub fn new(model: &Model, clip: &Clip, flop_limit: f64) -> Result<Self> {
        let (graph, calibration) = (&model.graph, clip.capture.calibration());
        let [_, gy, gx] = graph.granularity()?;
        let unit = [lcm(gy, calibration.rows), lcm(gx, calibration.cols)];
        let [height, width] = clip.extent();
        let padded = [height.next_multiple_of(unit[0]), width.next_multiple_of(unit[1])];
        let mut size = padded;
        let mut plan = Plan::lower(model, size[0], size[1])?;
        while plan.flop() > flop_limit && size != unit {
            let longer = usize::from(size[1] > size[0]);
            let axis = if size[longer] > unit[longer] { longer } else { 1 - longer };
            size[axis] = (size[axis] / 2).next_multiple_of(unit[axis]);
            plan = Plan::lower(model, size[0], size[1])?;
        }
        let whole = size == padded;
        let k = clip.last_window(graph.window);
        let place = std::array::from_fn(|axis| (padded[axis] - size[axis]) / 2 / unit[axis] * unit[axis]);
        let measurement = crop(&clip.window(graph.window, k, &calibration, padded), place, size);
        let schedule = windows::seen(graph.window, k).start;
        let mut exact = Video::black(graph.window.hop, size[0], size[1]);
        let mut oracle = CpuExecutor::<f64>::new(plan.clone(), calibration.clone());
        oracle.run(&measurement.data, schedule, &mut exact.data)?;
        let exact = if whole { crop(&exact, [0, 0], clip.extent()) } else { exact };
        Ok(Self { k, whole, plan, calibration, measurement, schedule, exact })
    }

    /// Whether the window is whole, so that [`Oracle::psnr_of_video`] can be had.
    pub fn is_whole(&self) -> bool {
        self.whole
    }

    /// What an executor has to run to be compared.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// PSNR in dB of irradiance p, peak 1, of what an executor of [`Oracle::plan`] makes of the window.
    pub fn psnr_of_executor(&self, executor: &mut dyn Executor) -> Result<f64> {
        let mut result = vec![0.0; self.plan.result.shape.len()];
        executor.run(&self.measurement.data, self.schedule, &mut result)?;
        let pairs = self.exact.data.chunks(self.exact.frame_len()).zip(result.chunks(self.exact.frame_len()));
        Ok(psnr(pairs, self.exact.width))
    }

    /// PSNR in dB of irradiance p, peak 1, of the window's frames in a synthesised `video` of the clip.
    pub fn psnr_of_video(&self, clip: &Clip, video: &Video) -> f64 {
        let first = self.k * self.exact.frames as i64 - clip.capture.info.schedule_start;
        let pairs = (0..self.exact.frames).filter_map(|t| {
            let index = usize::try_from(first + t as i64).ok().filter(|index| *index < video.frames)?;
            Some((self.exact.frame(t), video.frame(index)))
        });
        psnr(pairs, self.exact.width)
    }

    /// The largest error of any step as a fraction of its bound, at the executor's precision.
    pub fn bound_fraction(&self, executor: &mut dyn Inspect, precision: Precision) -> Result<f64> {
        let errors =
            step_errors(executor, &self.calibration, &self.measurement.data, self.schedule, precision)?;
        Ok(errors.iter().map(|error| error.fraction).fold(0.0, f64::max))
    }
}

/// PSNR in dB, peak 1, of pairs of exact and computed frames.
pub(super) fn psnr<'a>(pairs: impl Iterator<Item = (&'a [f32], &'a [f32])>, width: usize) -> f64 {
    let plane = |values: &'a [f32]| Plane::new([values.len() / width, width], values);
    let mut comparison = Comparison::default();
    for (exact, result) in pairs {
        comparison.add(plane(exact), plane(result));
    }
    comparison.measures().psnr.min(MOST_DB)
}

//! One row of the benchmark: a net, where it runs and how, on a clip.

use std::collections::HashSet;
use std::time::{Duration, Instant};

use serde::Serialize;

use super::clip::crop;
use super::floors::Work;
use super::samples::repeat;
use super::{Clip, Floors, Oracle, Peak, Samples, machine};
use crate::Result;
use crate::gpu::{self, GpuExecutor, TensorFormats, Variant};
use crate::network::{Inspect, Model, Plan, Precision, Shape};
use crate::quality::compare;
use crate::sensor::Calibration;
use crate::synth::{Backend, Ensemble, Settings, Skip, Skipped, Synthesizer, poses, tiles::Grid, windows};
use crate::video::Video;

/// A sample takes at least this long, so that it outweighs the way to a device: short windows are computed several
/// times in one.
const SAMPLE: Duration = Duration::from_millis(2);

/// How much time is spent on a row.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// How long inference, and how long the whole job, is repeated.
    pub patience: Duration,
    /// Operations of the window that is compared with the oracle.
    pub check_flop: f64,
}

/// What is measured.
pub struct Case<'a> {
    /// What was chosen: weights, and what may be left out, in how many views.
    pub settings: &'a Settings,
    /// The net.
    pub model: &'a Model,
    /// Whether its weights were trained: random ones compute as fast, but what comes out is no picture.
    pub trained: bool,
    /// Where it runs.
    pub backend: &'a Backend,
    /// What that can do at most.
    pub peak: Peak,
    /// How GPU convolutions are divided, if that is not to be chosen by layer. Only inference is measured then.
    pub variant: Option<Variant>,
    /// How much time is spent.
    pub effort: Effort,
    /// Whether the time of each step is measured.
    pub per_layer: bool,
}

/// What was measured. A figure that was not is none.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the preset or weights file.
    pub preset: String,
    /// `trained` or `random`.
    pub weights: &'static str,
    /// `gpu` or `cpu`.
    pub executor: &'static str,
    /// Name of the adapter.
    pub adapter: Option<String>,
    /// `f32` or `f16`.
    pub precision: &'static str,
    /// `off`, `exact` or `bounded`.
    pub skip: &'static str,
    /// Views of which the mean is taken. Each is a window's work; errors against the oracle are those of one.
    pub ensemble: usize,
    /// Name of the scene.
    pub scene: String,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Frames of the clip.
    pub frames: usize,
    /// Inference alone, measurement and result staying where it is computed: median of the samples. With skipping, the
    /// windows of the whole job, since what is skipped depends on those before.
    pub ms_per_frame_median: f64,
    /// The same: 95 of 100 samples took no longer.
    pub ms_per_frame_p95: f64,
    /// Number of samples.
    pub samples: usize,
    /// Result frames per second, from the median.
    pub frames_per_s: f64,
    /// 10⁶ result pixels per second, from the median.
    pub mpixel_per_s: f64,
    /// Operations, bytes, and the times that they take at the peaks.
    #[serde(flatten)]
    pub floors: Floors,
    /// Operations per second as a fraction of the peak, from the median.
    pub peak_fraction: f64,
    /// Inference by the device's own clock (time stamps): median.
    pub device_ms_per_frame_median: Option<f64>,
    /// Processor time of inference, all threads together.
    pub processor_ms_per_frame: Option<f64>,
    /// Capture in memory to video in memory: upload, synthesis, read-back.
    pub end_to_end_ms_per_frame: Option<f64>,
    /// Share of the cells of the video (Architecture, Skipping) that were computed.
    pub tiles_computed_fraction: Option<f64>,
    /// PSNR-µ against the truth, in dB.
    pub psnr_mu_db: Option<f64>,
    /// PSNR-µ of the box filter, in dB.
    pub box_psnr_mu_db: f64,
    /// PSNR of irradiance against the f64 oracle, in dB.
    pub psnr_vs_oracle_db: Option<f64>,
    /// Largest error of a step as a fraction of its derived bound.
    pub max_error_bound_fraction: Option<f64>,
    /// Bytes of all tensors between the steps.
    pub activation_bytes: u64,
    /// Largest memory of the process while this row's times were measured, clip and program included, memory of a GPU
    /// not.
    pub peak_memory_bytes: Option<u64>,
    /// The steps of the most frequent tile, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub layers: Option<Vec<LayerTime>>,
}

impl Row {
    /// Name of the net, and in how many views.
    pub fn net(&self) -> String {
        if self.ensemble > 1 { format!("{} ×{}", self.preset, self.ensemble) } else { self.preset.clone() }
    }
}

/// Time of a step.
#[derive(Clone, Debug, Serialize)]
pub struct LayerTime {
    /// Name of the step.
    pub step: String,
    /// Its kernel.
    pub kernel: &'static str,
    /// Shape of its output, t×y×x×c.
    pub output: String,
    /// The shortest of several times, since other programs only ever make a step slower.
    pub ms_per_frame: f64,
    /// 10⁹ operations per second.
    pub gflop_per_s: f64,
    /// Operations per byte read and written.
    pub flop_per_byte: f64,
    /// The least time that its arithmetic and its bytes allow at the peaks.
    pub roofline_ms_per_frame: f64,
    /// How many times as long it took.
    pub times_roofline: f64,
}

/// A size of tile that occurs in a frame, ready to run.
struct PreparedTile {
    plan: Plan,
    executor: Box<dyn Inspect>,
    measurement: Video,
    /// How many tiles of the frame have this size.
    count: usize,
    /// How many windows make a sample.
    windows: usize,
}

/// One sample of inference: time of a window with all its tiles.
struct Sample {
    wall: Duration,
    device: Option<Duration>,
}

impl Case<'_> {
    /// Measures everything on a clip.
    pub fn measure(&self, clip: &Clip, oracle: &Oracle) -> Result<Row> {
        let calibration = clip.capture.calibration();
        let memory = machine::reset_peak_memory();
        let grid = Grid::fit(self.model, &calibration, clip.extent(), self.backend.limits(None))?;
        let whole = match self.variant {
            None => Some(self.end_to_end(clip, &calibration)?),
            Some(_) => None,
        };
        let mut tiles = self.tiles(clip, &grid, &calibration)?;
        let window = self.model.graph.window;
        let schedule = windows::seen(window, clip.last_window(window)).start;
        let hop = window.hop as f64;
        let inference = self.inference(&mut tiles, schedule)?;
        // What is skipped depends on the windows before, so only the whole job shows it.
        let (wall, frames) = match &whole {
            Some(whole) if self.settings.skip != Skip::Off => (&whole.frame_times, 1.0),
            _ => (&inference.wall, hop),
        };
        let peak_memory_bytes = memory.then(machine::peak_memory).flatten();

        let precision = self.backend.precision();
        let floors = self
            .peak
            .floors(tiles.iter().map(|tile| (&tile.plan, tile.count * self.settings.ensemble)), precision);
        let per_frame = |seconds: f64| 1e3 * seconds / hop;
        let wall_per_frame = |seconds: f64| 1e3 * seconds / frames;
        let median = wall_per_frame(wall.median());
        let mut checked = self.executor(oracle.plan().clone(), &calibration)?;
        let psnr_vs_oracle_db = match &whole {
            Some(whole) if oracle.is_whole() && self.settings.ensemble == 1 => {
                Some(oracle.psnr_of_video(clip, &whole.video))
            }
            // The executor by itself never skips.
            _ if self.settings.skip != Skip::Off => None,
            _ => Some(oracle.psnr_of_executor(&mut *checked)?),
        };
        let psnr_mu_db = match &whole {
            Some(whole) if self.trained => Some(compare(&clip.truth, &whole.video)?.psnr_mu),
            _ => None,
        };
        let layers = if self.per_layer { Some(self.layers(&mut tiles, schedule)?) } else { None };
        let [height, width] = clip.extent();
        Ok(Row {
            preset: self.settings.weights.clone(),
            weights: if self.trained { "trained" } else { "random" },
            executor: self.backend.name(),
            adapter: self.backend.adapter(),
            precision: precision.name(),
            skip: self.settings.skip.name(),
            ensemble: self.settings.ensemble,
            scene: clip.scene.clone(),
            width,
            height,
            frames: clip.capture.frames,
            ms_per_frame_median: median,
            ms_per_frame_p95: wall_per_frame(wall.quantile(0.95)),
            samples: wall.count(),
            frames_per_s: 1e3 / median,
            mpixel_per_s: 1e-3 * (width * height) as f64 / median,
            floors,
            peak_fraction: floors.arithmetic_floor_ms_per_frame / median,
            device_ms_per_frame_median: inference.device.map(|times| per_frame(times.median())),
            processor_ms_per_frame: inference.processor.map(per_frame),
            end_to_end_ms_per_frame: whole.as_ref().map(|whole| whole.ms_per_frame),
            tiles_computed_fraction: whole.as_ref().map(|whole| whole.computed),
            psnr_mu_db,
            box_psnr_mu_db: clip.box_psnr_mu_db,
            psnr_vs_oracle_db,
            max_error_bound_fraction: Some(oracle.bound_fraction(&mut *checked, precision)?),
            activation_bytes: tiles.iter().map(|tile| tile.slot_bytes(precision)).sum(),
            peak_memory_bytes,
            layers,
        })
    }

    fn executor(&self, plan: Plan, calibration: &Calibration) -> Result<Box<dyn Inspect>> {
        match (self.backend, self.variant) {
            (&Backend::Gpu(ref gpu, precision), Some(_)) => {
                let options = gpu::ExecutorOptions {
                    precision,
                    variant: self.variant,
                    ..gpu::ExecutorOptions::default()
                };
                Ok(Box::new(GpuExecutor::with_options(gpu, plan, calibration, &options)?))
            }
            _ => self.backend.executor(plan, calibration, true),
        }
    }

    /// The whole job.
    fn end_to_end(&self, clip: &Clip, calibration: &Calibration) -> Result<EndToEnd> {
        let extent = clip.extent();
        let mut synthesizer =
            Synthesizer::new(self.model, calibration.clone(), extent, self.backend, self.settings)?;
        // Every run gives the same.
        let (mut video, mut computed) = (Video::black(0, 0, 0), 1.0);
        let runs = repeat(self.effort.patience, || {
            let begun = Instant::now();
            let (result, report) = synthesizer.video(&clip.capture)?;
            video = result;
            computed = report.skipping.as_ref().map_or(1.0, Skipped::active_fraction);
            Ok((begun.elapsed(), report.frame_times))
        })?;
        let times = Samples::new(runs.iter().map(|(time, _)| *time).collect());
        let frame_times = Samples::new(runs.into_iter().flat_map(|(_, windows)| windows).collect());
        Ok(EndToEnd {
            video,
            ms_per_frame: 1e3 * times.median() / clip.capture.frames as f64,
            frame_times,
            computed,
        })
    }

    /// The sizes of tiles that a frame is cut into.
    fn tiles(&self, clip: &Clip, grid: &Grid, calibration: &Calibration) -> Result<Vec<PreparedTile>> {
        let window = self.model.graph.window;
        let seen = clip.window(window, clip.last_window(window), calibration, grid.extent());
        let poses = poses(&self.model.graph, calibration, self.settings.ensemble)?;
        let limits = self.backend.limits(None);
        let streams = limits.stream(self.model, grid, &poses)?;
        let mut tiles: Vec<PreparedTile> = Vec::new();
        for (row, col) in grid.tiles() {
            let size = [row.outer_len, col.outer_len];
            let known = tiles.iter_mut().find(|t| [t.measurement.height, t.measurement.width] == size);
            if let Some(tile) = known {
                tile.count += 1;
                continue;
            }
            let plan = limits.plan(self.model, size, streams)?;
            let executor = self.executor(plan.clone(), calibration)?;
            let executor = Ensemble::over(executor, &poses, window, size, calibration);
            let measurement = crop(&seen, [row.outer_start, col.outer_start], size);
            tiles.push(PreparedTile { plan, executor, measurement, count: 1, windows: 1 });
        }
        Ok(tiles)
    }

    /// Inference alone.
    fn inference(&self, tiles: &mut [PreparedTile], schedule: i64) -> Result<Inference> {
        for tile in &mut *tiles {
            // The second run is the first that shows what a window takes.
            tile.time(schedule)?;
            let once = tile.time(schedule)?.wall;
            tile.windows = (SAMPLE.as_secs_f64() / once.as_secs_f64().max(1e-9)).ceil().max(1.0) as usize;
        }
        let (begun, processor) = (Instant::now(), machine::processor_time());
        let samples = repeat(self.effort.patience, || {
            let mut sample = Sample { wall: Duration::ZERO, device: Some(Duration::ZERO) };
            for tile in &mut *tiles {
                let time = tile.time(schedule)?;
                sample.wall += time.wall;
                sample.device = sample.device.zip(time.device).map(|(a, b)| a + b);
            }
            Ok(sample)
        })?;
        // How many processors were busy. Their clock counts hundredths of a second.
        let used = processor.zip(machine::processor_time()).map(|(before, after)| after - before);
        let busy = used.filter(|used| *used > 0.0).map(|used| used / begun.elapsed().as_secs_f64());
        let wall = Samples::new(samples.iter().map(|sample| sample.wall).collect());
        let device: Option<Vec<Duration>> = samples.iter().map(|sample| sample.device).collect();
        Ok(Inference {
            processor: busy.map(|busy| busy * wall.median()),
            device: device.map(Samples::new),
            wall,
        })
    }

    /// Time of each step of the most frequent tile.
    fn layers(&self, tiles: &mut [PreparedTile], schedule: i64) -> Result<Vec<LayerTime>> {
        let Some(PreparedTile { plan, executor, measurement, count, .. }) =
            tiles.iter_mut().max_by_key(|tile| tile.count)
        else {
            return Ok(Vec::new());
        };
        let times = repeat(self.effort.patience, || executor.time_steps(&measurement.data, schedule))?;
        let per_frame = |seconds: f64| 1e3 * seconds * *count as f64 / plan.window.hop as f64;
        let formats = TensorFormats::new(plan, self.backend.precision());
        // A layer may be computed in several steps.
        let mut names: Vec<&str> = plan.usual_steps().iter().map(|step| step.name.as_str()).collect();
        let mut known = HashSet::new();
        names.retain(|name| known.insert(*name));
        let layer = |name: &str| {
            let steps = || plan.usual_steps().iter().enumerate().filter(move |(_, step)| step.name == name);
            let (_, step) = steps().next()?;
            let time = |times: &Vec<Duration>| steps().map(|(index, _)| times[index]).sum::<Duration>();
            let shortest = times.iter().map(time).min().unwrap_or_default().as_secs_f64();
            let work = steps().map(|(_, step)| Work::of_step(step, &formats));
            let work = work.fold(Work::default(), Work::and);
            let frames = steps().map(|(_, step)| step.output.shape.t).sum();
            let roofline = self.peak.roofline(work);
            Some(LayerTime {
                step: step.name.clone(),
                kernel: step.kernel.name(),
                output: Shape { t: frames, ..step.output.shape }.to_string(),
                ms_per_frame: per_frame(shortest),
                gflop_per_s: 1e-9 * work.flop / shortest,
                flop_per_byte: work.intensity(),
                roofline_ms_per_frame: per_frame(roofline),
                times_roofline: shortest / roofline,
            })
        };
        Ok(names.into_iter().filter_map(layer).collect())
    }
}

/// The whole job, capture in memory to video in memory.
struct EndToEnd {
    video: Video,
    /// Median of several runs.
    ms_per_frame: f64,
    /// Time per frame of each window of all runs.
    frame_times: Samples,
    /// Share of the cells that were computed.
    computed: f64,
}

/// Times of a window with all its tiles.
struct Inference {
    wall: Samples,
    device: Option<Samples>,
    /// Processor seconds.
    processor: Option<f64>,
}

impl PreparedTile {
    /// Bytes of all slots.
    fn slot_bytes(&self, precision: Precision) -> u64 {
        TensorFormats::new(&self.plan, precision).slot_bytes.iter().map(|&bytes| bytes as u64).sum()
    }

    /// Time of all tiles of this size in one window.
    fn time(&mut self, schedule: i64) -> Result<Sample> {
        let time = self.executor.time_windows(&self.measurement.data, schedule, self.windows)?;
        let share = |time: Duration| time.mul_f64(self.count as f64 / self.windows as f64);
        Ok(Sample { wall: share(time.wall), device: time.device.map(share) })
    }
}

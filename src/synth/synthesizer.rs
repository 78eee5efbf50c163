//! Runs a model over a recording.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use serde_json::Value;

use super::Backend;
use super::accumulate::Accumulation;
use super::ensemble::poses;
use super::fit::{fit, lengths};
use super::footage::{Footage, Seen};
use super::layout::Layout;
use super::line::{Done, Line, ResultFrame, Submitted};
use super::on_sensor::{Laid, OnSensor};
use super::pool::Pool;
use super::report::Report;
use super::settings::Settings;
use super::skip::{Cells, Gate, Rules, Skip, cover};
use super::tiles::{Cut, Grid};
use super::windows;
use crate::frame::{Extent, Frame};
use crate::network::{Model, Window};
use crate::sensor::{Calibration, Capture, Recording, SensorError, Source};
use crate::video::Video;
use crate::{Error, Result};

/// A model made ready for recordings of one size.
pub struct Synthesizer {
    window: Window,
    /// As recordings are to have it.
    calibration: Calibration,
    /// Where their frames lie in those of the sensor, whose calibration and extent these are.
    place: OnSensor,
    sensor: Calibration,
    extent: Extent,
    grid: Grid,
    pool: Pool,
    /// What computes, in words.
    executor: String,
    /// Operations per result frame.
    flop: f64,
    skip: Skip,
    cells: Cells,
    layout: Layout,
    /// What the frames of the last window are rounded up to.
    step: usize,
    /// Whether results get better where a scene rests.
    accumulate: bool,
    /// Cells [rows, columns] around a changed one that are computed with it.
    spread: [usize; 2],
    stop: Arc<AtomicBool>,
}

/// Bytes of frames that wait between threads.
const WAITING_BYTES: usize = 64 << 20;

/// Checks that `model` was made for what `recording` holds. A different pattern is refused, a different response is
/// a warning, which is returned.
pub fn check_fits(model: &Model, recording: &Recording) -> Result<Option<String>> {
    model.check_pattern(&recording.sensor_pattern())?;
    let response = serde_json::to_value(recording.response.form()).unwrap_or_default();
    let trained = &model.trained.response;
    let named = |response: &Value| match response.get("table").and_then(Value::as_array) {
        Some(rows) => format!("a table of {} rows", rows.len()),
        None => response.to_string(),
    };
    Ok((trained != "any" && *trained != response).then(|| {
        format!(
            "weights '{}' were trained for response {}, the capture has {}",
            model.graph.name,
            named(trained),
            named(&response)
        )
    }))
}

impl Synthesizer {
    /// Makes `model` ready for frames of `extent` of a camera, to run on `backend`; `calibration` says where they lie on its
    /// sensor. `settings` say the rest: tiles, skipping, windows and ensemble.
    pub fn new(
        model: &Model,
        calibration: Calibration,
        extent: impl Into<Extent>,
        backend: &Backend,
        settings: &Settings,
    ) -> Result<Self> {
        model.graph.check_renders_video()?;
        let skip = settings.skip;
        let sensor = calibration.on_sensor();
        let exact = Cut::exact(&model.graph, &sensor)?;
        let place = OnSensor::new(&calibration, extent.into(), exact.unit());
        let extent = place.extent();
        let poses = poses(&model.graph, &sensor, settings.ensemble)?;
        let lengths = lengths(&model.graph, &sensor, settings)?;
        let limits = backend.limits(settings.tile);
        let (model, grid) = &fit(model, &sensor, extent, limits, &lengths)?;
        let (hop, step, grid) = (model.graph.window.hop, lengths.step, grid.clone());
        let cells = Cells::new(lengths.cell.min(hop), hop, grid.extent(), &sensor);
        let spread = skip.spread(&cells, exact.halo());
        let cut = if matches!(skip, Skip::Bounded(_)) { exact.bounded() } else { exact };
        let layout = Layout::new(model, cut, &cells, &grid)?;
        let whole = layout.whole(hop);
        let streams = limits.stream(model, &grid, &poses)?.then(|| whole[0].size());
        let mut pool = Pool::new(backend, model, &sensor, streams, poses);
        // What cannot work is said before anything is read. All tiles have one size.
        let (executor, flop) = pool.describe(whole[0].size())?;
        let flop = flop * whole.len() as f64 / hop as f64;
        let window = model.graph.window;
        let stop = Arc::default();
        Ok(Self {
            window,
            calibration,
            place,
            sensor,
            extent,
            grid,
            pool,
            executor,
            flop,
            skip,
            cells,
            layout,
            step,
            accumulate: settings.accumulate,
            spread,
            stop,
        })
    }

    /// The tiles.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Whether a window's results are the recording's frames as they are: neither moved nor turned, nor of tiles, nor
    /// fused with what came before.
    pub fn whole_frames(&self) -> bool {
        self.place.whole() && self.grid.count() == 1 && !self.accumulate
    }

    /// The windows.
    pub fn window(&self) -> Window {
        self.window
    }

    /// Set it from anywhere to end a run after the window that is being computed.
    pub fn stop(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    /// Refuses a recording that is not what this was made for, or that does not say enough.
    pub fn accept(&self, recording: &Recording) -> Result<()> {
        self.accumulation(recording).map(drop)
    }

    /// The empty memory of a run over `recording`, where results accumulate. Refuses what [`Self::accept`] does.
    fn accumulation(&self, recording: &Recording) -> Result<Option<Accumulation>> {
        if self.place.frame() != recording.extent() || recording.calibration() != self.calibration {
            return Err(SensorError::Capture(
                "not the size or camera that the synthesis was made for".into(),
            )
            .into());
        }
        if !self.accumulate {
            return Ok(None);
        }
        let dead = recording.defects.as_ref().map(|defects| self.place.laid_mask(defects.dead()));
        Accumulation::new(recording, &self.sensor, self.extent, dead).map(Some)
    }

    /// Synthesises all frames of `capture`; `sink` gets each one [rows, columns] in order, as irradiance p.
    pub fn run(
        &mut self,
        capture: &Capture,
        mut sink: impl FnMut(usize, &[f32]) -> Result<()> + Send,
    ) -> Result<Report> {
        self.stream(&mut *capture.frames(), 0, |result| sink(result.number, result.frame.values()))
    }

    /// Synthesises a whole capture into memory.
    pub fn video(&mut self, capture: &Capture) -> Result<(Video, Report)> {
        let mut video = Video::black(capture.frames, capture.height, capture.width);
        let report = self.run(capture, |t, frame| {
            video.frame_mut(t).copy_from_slice(frame);
            Ok(())
        })?;
        Ok((video, report))
    }

    /// Synthesises what `source` delivers, in memory that does not depend on its length. `sink` gets each frame in
    /// order, from frame `from` on, to the bit as if the run had begun with the first one.
    ///
    /// Frames are read on a thread of their own, and `sink` runs on another one; a few frames wait between them.
    pub fn stream(
        &mut self,
        source: &mut dyn Source,
        from: usize,
        mut sink: impl FnMut(ResultFrame) -> Result<()> + Send,
    ) -> Result<Report> {
        let accumulation = self.accumulation(source.recording())?;
        let begun = Instant::now();
        let place = self.place;
        let mut source = Laid::new(source, place);
        let recording = source.recording().clone();
        let (calibration, padded) = (self.sensor.clone(), Extent::from(self.grid.extent()));
        let waiting = (WAITING_BYTES / (4 * padded.pixels())).clamp(2, 64);
        std::thread::scope(|scope| {
            let (send_frame, arriving) = sync_channel(waiting);
            scope.spawn(move || read(&mut source, &calibration, padded, &send_frame));
            let (deliver, finished) = sync_channel::<ResultFrame>(waiting);
            let writer = scope.spawn(move || -> Result<()> {
                finished.iter().map(|result| place.result(result)).try_for_each(&mut sink)
            });
            let compute = || self.compute(&recording, from, accumulation, arriving, deliver);
            let outcome = catch_unwind(AssertUnwindSafe(compute)).unwrap_or_else(|_| {
                self.pool.clear();
                Err(Error::Panicked("computes frames"))
            });
            // What went wrong while writing is why nothing could be delivered any more.
            let written = writer.join().map_err(|_| Error::Panicked("writes frames"))?;
            written?;
            let mut report = outcome?;
            report.skipping = report.skipping.map(|skipped| place.skipped(skipped));
            report.wall = begun.elapsed();
            Ok(report)
        })
    }

    /// Goes through the windows.
    fn compute(
        &mut self,
        recording: &Recording,
        from: usize,
        accumulation: Option<Accumulation>,
        arriving: Receiver<Result<Frame>>,
        deliver: SyncSender<ResultFrame>,
    ) -> Result<Report> {
        self.pool.reset();
        // Frames before are computed again where what is delivered remembers them.
        let remembered = if accumulation.is_some() { Accumulation::begins(from) } else { from };
        let Self { window, sensor, grid, pool, cells, skip, layout, step, extent, spread, stop, .. } = self;
        let start = recording.info.schedule_start;
        let mut footage = Footage::new(arriving, sensor, start);
        let rules = Rules { skip: *skip, cells, window: *window, spread: *spread };
        let mut gate = Gate::new(rules, recording, sensor, remembered);
        let mut skipped = gate.skipped();
        let (mut count, mut gating) = (0u32, Duration::ZERO);
        let keeps = skipped.is_some();
        let accumulates = accumulation.is_some();
        let mut line = Line::new(pool, (cells, grid, *window), *extent, start, keeps, accumulation, deliver);
        for k in gate.from().. {
            let begin = k * window.hop as i64;
            let times = windows::seen(*window, k);
            let first = times.start - gate.before();
            // What lies before a result that is gone on with is forgotten as it arrives.
            footage.forget_before(first, stop)?;
            if stop.load(Ordering::Relaxed) || !footage.holds(begin.max(start))? {
                break;
            }
            let frames = (first..times.end).map(|t| footage.frame(t)).collect::<Result<Vec<_>>>()?;
            let seen = Seen { first, frames: &frames };
            let recorded = footage.recorded(begin..begin + window.hop as i64)?;
            let begun = Instant::now();
            let mut choice = gate.choose(k, &seen, &recorded);
            // Behind the end of the recording nothing is wanted.
            let frames = ((recorded.end - begin) as usize).next_multiple_of(*step).min(window.hop);
            if let Some(active) = &mut choice.active {
                active.clear_from(frames.div_ceil(cells.size()[0]));
            }
            let tiles = match &choice.active {
                Some(active) if !active.all() => {
                    let cuboids = cover(active, &|cuboid| layout.cost(cuboid));
                    cuboids.iter().flat_map(|cuboid| layout.tiles(cuboid)).collect()
                }
                _ => layout.whole(frames),
            };
            gating += begun.elapsed();
            count += 1;
            if let (Some(skipped), Some(active)) = (&mut skipped, &choice.active) {
                skipped.add(active, layout.work(&tiles));
            }
            let wanted = recorded.start.max(start + from as i64)..recorded.end;
            let remembered = recorded.start.max(start + remembered as i64)..recorded.end;
            let recorded = remembered.filter(|_| accumulates).map(|t| Arc::clone(seen.frame(t))).collect();
            line.submit(tiles, &seen, Submitted { begin, wanted, choice, recorded })?;
        }
        line.drain()?;
        let Done { frames, frame_times, inference, audit } = line.done;
        if let Some(skipped) = &mut skipped {
            skipped.work /= f64::from(count.max(1));
            skipped.audit = audit;
        }
        Ok(Report {
            frames,
            windows: count as usize,
            tiles: grid.count(),
            frame_times,
            executor: self.executor.clone(),
            flop_per_frame: self.flop,
            wall: Duration::ZERO,
            inference,
            gating,
            skipping: skipped,
        })
    }
}

/// Reads frames until there are no more, or nobody wants them, and extends each to `extent` by pixels at the same place of
/// the pattern.
fn read(
    source: &mut dyn Source,
    calibration: &Calibration,
    extent: Extent,
    frames: &SyncSender<Result<Frame>>,
) {
    loop {
        // Without a word, the end of this thread would pass for the end of the recording.
        let next = catch_unwind(AssertUnwindSafe(|| source.next()))
            .unwrap_or_else(|_| Err(Error::Panicked("reads frames")));
        let frame = match next {
            Ok(Some(frame)) => Ok(windows::padded(frame, calibration, extent)),
            Ok(None) => return,
            Err(error) => Err(error),
        };
        let failed = frame.is_err();
        if frames.send(frame).is_err() || failed {
            return;
        }
    }
}

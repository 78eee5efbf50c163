//! Runs a model over a recording.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use serde_json::Value;

use super::Backend;
use super::ensemble::views;
use super::footage::{Footage, Seen};
use super::layout::Layout;
use super::line::{Done, Line, ResultFrame, Submitted};
use super::pool::{Pool, with_hop};
use super::report::Report;
use super::skip::{Cells, Gate, Skip, cell_frames, cover};
use super::tiles::{Cut, Grid, Limits};
use super::windows;
use crate::frame::{Extent, Frame};
use crate::math::lcm;
use crate::network::{Graph, Model, NetworkError, Plan, Window};
use crate::sensor::{Calibration, Capture, Recording, SensorError, Source};
use crate::video::Video;
use crate::{Error, Result};

/// How a synthesizer works.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// Longest side of a tile's kept part, in pixels.
    pub side: Option<usize>,
    /// What may be left out.
    pub skip: Skip,
    /// Result frames of a window, in place of the model's own number.
    pub hop: Option<usize>,
    /// Views in which the camera's pattern looks the same, of whose results the mean is taken (see [`views`]); 0 or 1: the
    /// recording as it is.
    pub ensemble: usize,
}

/// A model made ready for recordings of one size.
pub struct Synthesizer {
    window: Window,
    calibration: Calibration,
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
    /// Cells [rows, columns] around a changed one that are computed with it.
    spread: [usize; 2],
    stop: Arc<AtomicBool>,
}

/// Where windows follow each other, long ones save nothing but their own beginnings and ends. So they take about as many
/// bytes at most, but give as many frames at least (docs/performance.md).
const STREAM_BYTES: usize = 1 << 30;
const STREAM_FRAMES: usize = 8;
/// Bytes of frames that wait between threads.
const WAITING_BYTES: usize = 64 << 20;

/// Checks that `model` was made for what `recording` holds. A different pattern is refused, a different response is
/// a warning, which is returned.
pub fn check_fits(model: &Model, recording: &Recording) -> Result<Option<String>> {
    model.check_pattern(&recording.pattern)?;
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
    /// Makes `model` ready for frames of `extent` [rows, columns] of a camera. `side` limits the tiles.
    pub fn new(
        model: &Model,
        calibration: Calibration,
        extent: impl Into<Extent>,
        backend: &Backend,
        side: Option<usize>,
    ) -> Result<Self> {
        Self::with(model, calibration, extent, backend, Options { side, ..Options::default() })
    }

    /// As [`Synthesizer::new`], with all options.
    pub fn with(
        model: &Model,
        calibration: Calibration,
        extent: impl Into<Extent>,
        backend: &Backend,
        options: Options,
    ) -> Result<Self> {
        let extent = extent.into();
        model.graph.check_renders_video()?;
        let skip = options.skip;
        let views = views(&model.graph, &calibration, options.ensemble)?;
        let lengths = lengths(&model.graph, &calibration, options)?;
        let (model, grid) = &fit(model, &calibration, extent.into(), backend.limits(options.side), &lengths)?;
        let (hop, step, grid) = (model.graph.window.hop, lengths.step, grid.clone());
        let exact = Cut::exact(&model.graph, &calibration, backend.compiles())?;
        let cells = Cells::new(lengths.cell.min(hop), hop, grid.extent(), &calibration);
        let spread = skip.spread(&cells, exact.halo());
        let cut = if matches!(skip, Skip::Bounded(_)) { exact.bounded() } else { exact };
        let layout = Layout::new(model, cut, &cells, &grid)?;
        let whole = layout.whole(hop);
        // One tile's windows follow each other; those of several ones, or views, take turns.
        let streams = (whole.len() == 1 && views.len() == 1).then(|| whole[0].size());
        let mut pool = Pool::new(backend, model, &calibration, streams, views);
        // What cannot work is said before anything is read. All tiles have one size.
        let (executor, flop) = pool.describe(whole[0].size())?;
        let flop = flop * whole.len() as f64 / hop as f64;
        let window = model.graph.window;
        let stop = Arc::default();
        Ok(Self {
            window,
            calibration,
            extent,
            grid,
            pool,
            executor,
            flop,
            skip,
            cells,
            layout,
            // Compiling shaders takes longer than the frames of one window that nobody wants.
            step: if backend.compiles() { hop } else { step },
            spread,
            stop,
        })
    }

    /// The tiles.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The windows.
    pub fn window(&self) -> Window {
        self.window
    }

    /// Set it from anywhere to end a run after the window that is being computed.
    pub fn stop(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
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
        let recording = source.recording().clone();
        if recording.extent() != self.extent || recording.calibration() != self.calibration {
            return Err(SensorError::Capture(
                "not the size or camera that the synthesis was made for".into(),
            )
            .into());
        }
        let begun = Instant::now();
        let (calibration, padded) = (self.calibration.clone(), Extent::from(self.grid.extent()));
        let waiting = (WAITING_BYTES / (4 * padded.pixels())).clamp(2, 64);
        std::thread::scope(|scope| {
            let (send_frame, arriving) = sync_channel(waiting);
            scope.spawn(move || read(source, &calibration, padded, &send_frame));
            let (deliver, finished) = sync_channel::<ResultFrame>(waiting);
            let writer = scope.spawn(move || -> Result<()> { finished.iter().try_for_each(&mut sink) });
            let compute = || self.compute(&recording, from, arriving, deliver);
            let outcome = catch_unwind(AssertUnwindSafe(compute)).unwrap_or_else(|_| {
                self.pool.clear();
                Err(Error::Panicked("computes frames"))
            });
            // What went wrong while writing is why nothing could be delivered any more.
            let written = writer.join().map_err(|_| Error::Panicked("writes frames"))?;
            written?;
            let mut report = outcome?;
            report.wall = begun.elapsed();
            Ok(report)
        })
    }

    /// Goes through the windows.
    fn compute(
        &mut self,
        recording: &Recording,
        from: usize,
        arriving: Receiver<Result<Frame>>,
        deliver: SyncSender<ResultFrame>,
    ) -> Result<Report> {
        self.pool.reset();
        let Self { window, calibration, grid, pool, cells, skip, layout, step, extent, spread, stop, .. } =
            self;
        let start = recording.info.schedule_start;
        let mut footage = Footage::new(arriving, calibration, start);
        let mut gate = Gate::new((cells, *skip, *window), *spread, (recording, calibration), from);
        let mut skipped = gate.skipped();
        let (mut count, mut gating) = (0u32, Duration::ZERO);
        let keeps = skipped.is_some();
        let mut line = Line::new(pool, (cells, grid, *window), *extent, start, keeps, deliver);
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
            line.submit(tiles, &seen, Submitted { begin, wanted, choice })?;
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

/// How long windows and their parts are, in frames.
struct Lengths {
    /// Result frames of a window, if memory allows.
    hop: usize,
    /// Least result frames of a window: `hop`, where that is fixed.
    least: usize,
    /// Frames of a cell, at most the window's.
    cell: usize,
    /// A window can be shorter by a multiple of this.
    step: usize,
    /// Whether all windows are computed, one after the other.
    streams: bool,
}

/// Nets whose window has their reach in time before and behind give the same frames for any number of result frames.
/// Then a window is cut into slabs that repeat with the pattern, and some of them can be left out.
fn lengths(graph: &Graph, calibration: &Calibration, options: Options) -> Result<Lengths> {
    let Window { frames, lead, hop } = graph.window;
    let [reach, ..] = graph.reach()?;
    let [granularity, ..] = graph.granularity()?;
    let stretches = lead >= reach && frames - hop - lead >= reach;
    let wanted = options.hop.unwrap_or(hop);
    if !stretches {
        if wanted != hop {
            let problem = format!("its windows give {hop} frames, and cannot give {wanted}");
            return Err(NetworkError::Graph(graph.name.clone(), problem).into());
        }
        return Ok(Lengths { hop, least: hop, cell: hop, step: hop, streams: false });
    }
    let least = |hop: usize, step: usize| if options.hop.is_some() { hop } else { step };
    if options.skip == Skip::Off {
        let hop = wanted.next_multiple_of(granularity).max(1);
        return Ok(Lengths {
            hop,
            least: least(hop, granularity),
            cell: hop,
            step: granularity,
            streams: options.ensemble <= 1,
        });
    }
    let cell = cell_frames(lcm(granularity, calibration.period));
    let hop = wanted.max(1).next_multiple_of(cell);
    Ok(Lengths { hop, least: least(hop, cell), cell, step: cell, streams: false })
}

/// `model` with the windows that [`Synthesizer::new`] chooses for frames of `extent` [rows, columns].
pub fn fitted(
    model: &Model,
    calibration: &Calibration,
    extent: [usize; 2],
    backend: &Backend,
) -> Result<Model> {
    let lengths = lengths(&model.graph, calibration, Options::default())?;
    Ok(fit(model, calibration, extent, backend.limits(None), &lengths)?.0)
}

/// The window and the tiles with the fewest operations for each result frame within `limits`. Short windows compute
/// more frames that no result keeps, if they do not follow each other, and small tiles more pixels; both save memory, and
/// neither changes a result.
fn fit(
    model: &Model,
    calibration: &Calibration,
    extent: [usize; 2],
    limits: Limits,
    lengths: &Lengths,
) -> Result<(Model, Grid)> {
    let candidate = |hop: usize| -> Result<(f64, Model, Grid)> {
        let model = with_hop(model, hop);
        let grid = Grid::fit(&model, calibration, extent, limits)?;
        let [height, width] = grid.tile_extent();
        let flop = grid.count() as f64 * Plan::lower(&model, height, width)?.flop() / hop as f64;
        Ok((flop, model, grid))
    };
    let shorter = |&hop: &usize| {
        let half = (hop / 2).next_multiple_of(lengths.step).max(lengths.least);
        (half < hop).then_some(half)
    };
    let mut best = candidate(lengths.hop);
    for hop in std::iter::successors(Some(lengths.hop), shorter).skip(1) {
        if best.as_ref().is_ok_and(|(_, _, grid)| grid.count() == 1) {
            break;
        }
        best = match (best, candidate(hop)) {
            (Ok(before), Ok(now)) => Ok(if now.0 < before.0 { now } else { before }),
            (Ok(one), Err(_)) | (Err(_), Ok(one)) => Ok(one),
            (Err(error), Err(_)) => Err(error),
        };
    }
    let (_, mut model, mut grid) = best?;
    while lengths.streams && grid.count() == 1 {
        let (slots, follows) = limits.slots(&model, grid.extent(), true)?;
        let before = model.graph.window.hop;
        let hop = (before / 2).next_multiple_of(lengths.step).max(lengths.least).max(STREAM_FRAMES);
        if hop >= before || !follows || 4 * slots.iter().sum::<usize>() <= STREAM_BYTES {
            break;
        }
        (_, model, grid) = candidate(hop)?;
    }
    Ok((model, grid))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::presets;
    use crate::sensor::{Form, Pattern, Response};

    fn tiny() -> (Model, Calibration) {
        let model = Model::random(presets::by_name("tiny").unwrap().graph().unwrap(), 0).unwrap();
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let response = Response::new(Form::Linear, pattern.shortest_exposure() as f64).unwrap();
        (model, Calibration::new(&pattern, &response))
    }

    #[test]
    fn windows_that_follow_each_other_take_a_gibibyte_or_eight_frames() {
        let (model, calibration) = tiny();
        let hop = |extent: [usize; 2], options: Options| {
            let lengths = lengths(&model.graph, &calibration, options).unwrap();
            let limits = Limits { buffer: u64::MAX, total: u64::MAX, piece: Some(2 << 20), side: None };
            let (model, _) = fit(&model, &calibration, extent, limits, &lengths).unwrap();
            model.graph.window.hop
        };
        assert_eq!(hop([128, 128], Options::default()), model.graph.window.hop);
        let (large, huge) = ([720, 1280], [2160, 3840]);
        let between = hop(large, Options::default());
        assert!(between < model.graph.window.hop && between > STREAM_FRAMES, "{between}");
        assert_eq!(hop(huge, Options::default()), STREAM_FRAMES);
        // Boxes of cells do not follow each other, and what the user says holds.
        assert_eq!(hop(huge, Options { skip: Skip::Exact, ..Options::default() }), model.graph.window.hop);
        assert_eq!(hop(huge, Options { hop: Some(40), ..Options::default() }), 40);
    }

    #[test]
    fn windows_are_as_long_as_memory_allows() {
        let (model, calibration) = tiny();
        let options = Options::default();
        let lengths = lengths(&model.graph, &calibration, options).unwrap();
        let extent = [128, 128];
        let bytes = |hop: usize| Plan::lower(&with_hop(&model, hop), 128, 128).unwrap().slot_bytes(4) as u64;
        let fitted = |total: u64, lengths: &Lengths| {
            let limits = Limits { buffer: u64::MAX, total, piece: None, side: None };
            let (model, grid) = fit(&model, &calibration, extent, limits, lengths).unwrap();
            (model.graph.window.hop, grid.count())
        };
        assert_eq!(fitted(bytes(48), &lengths), (48, 1));
        // A shorter window costs less than the halos of tiles.
        assert_eq!(fitted(bytes(48) - 1, &lengths), (24, 1));
        // With a hop that is fixed there are only tiles.
        let (hop, tiles) = fitted(bytes(48) - 1, &Lengths { least: 48, ..lengths });
        assert!(hop == 48 && tiles > 1);
        // The smallest windows need tiles too.
        let (_, tiles) = fitted(bytes(1) / 2, &lengths);
        assert!(tiles > 1);
    }
}

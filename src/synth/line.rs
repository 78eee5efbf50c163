//! The assembly line: tiles are submitted, collected and put together in order, and finished frames delivered.
//!
//! An executor that works elsewhere computes one tile while the next one is made ready, of the next window too.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::accumulate::Accumulation;
use super::footage::Seen;
use super::layout::Tile;
use super::pool::Pool;
use super::skip::{Active, Audit, Cells, Choice, Kept};
use super::tiles::Grid;
use crate::frame::{Extent, Frame};
use crate::network::Window;
use crate::video::Video;
use crate::{Error, Result};

/// A result frame.
#[derive(Clone, Debug)]
pub struct ResultFrame {
    /// Its number in the recording.
    pub number: usize,
    /// Irradiance p.
    pub frame: Arc<Frame>,
    /// Where something may be skipped, which cells of its window were computed, and its slab there.
    pub computed: Option<(Arc<Active>, usize)>,
    /// Rows and columns of a cell, in pixels.
    pub cell: [usize; 2],
    /// Its share of the time in which executors computed since the last window, or were waited for.
    pub inference: Duration,
}

/// A window whose tiles are submitted.
#[derive(Debug)]
pub struct Submitted {
    /// Schedule time of its first result frame.
    pub begin: i64,
    /// Schedule times of the frames that are to be delivered.
    pub wanted: Range<i64>,
    /// What of it is computed.
    pub choice: Choice,
    /// Where results accumulate, the recorded frames of those that are, the first of them maybe before `wanted`.
    pub recorded: Vec<Arc<Frame>>,
}

/// What the line has done so far.
#[derive(Clone, Debug, Default)]
pub struct Done {
    /// Frames delivered.
    pub frames: usize,
    /// Time from one finished window to the next, for each frame of it that was delivered.
    pub frame_times: Vec<Duration>,
    /// Time in which executors computed or were waited for.
    pub inference: Duration,
    /// Kept results against those that were computed anew.
    pub audit: Audit,
}

/// The windows that are on their way.
pub struct Line<'a> {
    /// What was done.
    pub done: Done,
    pool: &'a mut Pool,
    cells: &'a Cells,
    grid: &'a Grid,
    window: Window,
    extent: Extent,
    /// Schedule time of the recording's first frame.
    start: i64,
    /// What comes next.
    queue: VecDeque<Event>,
    /// Results of the windows in the queue, in order.
    results: VecDeque<Video>,
    /// Memory for results: what of it is delivered is written anew for every window.
    free: Vec<Video>,
    /// The last result of every cell, where something may be skipped.
    kept: Option<Kept>,
    /// What is remembered of the frames before, where results accumulate.
    accumulation: Option<Accumulation>,
    measurement: Vec<f32>,
    tile: Vec<f32>,
    /// Windows that an executor can hold.
    ahead: usize,
    deliver: SyncSender<ResultFrame>,
    finished: Instant,
    /// Of `done.inference`, what delivered frames have accounted for.
    accounted: Duration,
}

enum Event {
    /// A tile of the front window has to be collected.
    Tile(Tile),
    /// All of the front window's tiles are there.
    Window(Submitted),
}

impl<'a> Line<'a> {
    /// An empty line. `keeps` says whether some cells may keep their last results,
    /// `accumulation` is for results that get better where the scene rests.
    pub fn new(
        pool: &'a mut Pool,
        (cells, grid, window): (&'a Cells, &'a Grid, Window),
        extent: Extent,
        start: i64,
        keeps: bool,
        accumulation: Option<Accumulation>,
        deliver: SyncSender<ResultFrame>,
    ) -> Self {
        Self {
            done: Done::default(),
            pool,
            cells,
            grid,
            window,
            extent,
            start,
            queue: VecDeque::new(),
            results: VecDeque::new(),
            free: Vec::new(),
            kept: keeps.then(|| Kept::new(cells, extent.into())),
            accumulation,
            measurement: Vec::new(),
            tile: Vec::new(),
            ahead: 1,
            deliver,
            finished: Instant::now(),
            accounted: Duration::ZERO,
        }
    }

    /// Starts to compute `tiles` of a window.
    pub fn submit(&mut self, tiles: Vec<Tile>, seen: &Seen<'_>, window: Submitted) -> Result<()> {
        let Extent { height, width } = self.extent;
        let result = self.free.pop().unwrap_or_else(|| Video::black(self.window.hop, height, width));
        self.results.push_back(result);
        for tile in tiles {
            let size = tile.size();
            while !self.pool.is_free(size) {
                self.advance()?;
            }
            let schedule = window.begin + tile.frames.start as i64 - self.window.lead as i64;
            let frames = self.window.frames - self.window.hop + tile.frames.len();
            let [_, padded_width] = self.grid.extent();
            let [height, width] = [tile.row.outer_len, tile.col.outer_len];
            self.measurement.resize(frames * height * width, 0.0);
            let values = self.measurement.par_chunks_mut(height * width);
            values.enumerate().for_each(|(t, values)| {
                let frame = seen.at(schedule + t as i64);
                for (y, values) in (tile.row.outer_start..).zip(values.chunks_mut(width)) {
                    values.copy_from_slice(&frame[y * padded_width + tile.col.outer_start..][..width]);
                }
            });
            let begun = Instant::now();
            let place = [tile.row.outer_start, tile.col.outer_start];
            self.ahead = self.pool.submit(size, place, &self.measurement, schedule)?;
            self.done.inference += begun.elapsed();
            self.queue.push_back(Event::Tile(tile));
        }
        self.queue.push_back(Event::Window(window));
        // Where results are there when `submit` returns, nothing is gained by waiting with them.
        while self.results.len() >= self.ahead {
            self.advance()?;
        }
        Ok(())
    }

    /// Finishes all windows.
    pub fn drain(&mut self) -> Result<()> {
        while !self.queue.is_empty() {
            self.advance()?;
        }
        Ok(())
    }

    fn advance(&mut self) -> Result<()> {
        match self.queue.pop_front() {
            Some(Event::Tile(tile)) => self.collect(&tile),
            Some(Event::Window(window)) => {
                let Some(mut result) = self.results.pop_front() else { return Ok(()) };
                self.merge(&window, &mut result);
                self.accumulate(&window, &mut result);
                let delivered = u32::try_from(window.wanted.end - window.wanted.start).unwrap_or(0);
                self.deliver(window, &result)?;
                self.free.push(result);
                self.done.frame_times.extend(self.finished.elapsed().checked_div(delivered));
                self.finished = Instant::now();
                Ok(())
            }
            None => Ok(()),
        }
    }

    /// Copies the part of a computed tile that is kept, and that lies within the frame, into the window's result.
    fn collect(&mut self, tile: &Tile) -> Result<()> {
        let Tile { frames, row, col } = tile;
        self.tile.resize(tile.size().iter().product(), 0.0);
        let begun = Instant::now();
        self.pool.collect(tile.size(), &mut self.tile)?;
        self.done.inference += begun.elapsed();
        let Some(result) = self.results.front_mut() else { return Ok(()) };
        let Extent { height, width } = self.extent;
        let columns = col.len.min(width.saturating_sub(col.start));
        for (t, frame) in frames.clone().enumerate() {
            for y in row.start..(row.start + row.len).min(height) {
                let from =
                    (t * row.outer_len + y - row.outer_start) * col.outer_len + col.start - col.outer_start;
                result.frame_mut(frame)[y * width + col.start..][..columns]
                    .copy_from_slice(&self.tile[from..][..columns]);
            }
        }
        Ok(())
    }

    /// Fills cells that were not computed with their last results, and keeps the others'.
    fn merge(&mut self, window: &Submitted, result: &mut Video) {
        let (Some(kept), Some(active)) = (&mut self.kept, &window.choice.active) else { return };
        if let Some(audited) = &window.choice.audit {
            kept.audit(window.begin, audited, result, &mut self.done.audit);
        }
        kept.merge(window.begin, active, result);
    }

    /// Fuses results with what is remembered. What cells keep are results as they were before.
    fn accumulate(&mut self, window: &Submitted, result: &mut Video) {
        let Some(accumulation) = &mut self.accumulation else { return };
        let [_, stride] = self.grid.extent();
        for frame in &window.recorded {
            let t = frame.time();
            let result = result.frame_mut((t - window.begin) as usize);
            accumulation.fuse((t - self.start) as usize, t, (frame.values(), stride), result);
        }
    }

    fn deliver(&mut self, window: Submitted, result: &Video) -> Result<()> {
        let active = window.choice.active.map(Arc::new);
        let inference = match u32::try_from(window.wanted.end - window.wanted.start) {
            Ok(frames @ 1..) => self.done.inference.saturating_sub(self.accounted) / frames,
            _ => Duration::ZERO,
        };
        self.accounted = self.done.inference;
        for t in window.wanted {
            let in_window = (t - window.begin) as usize;
            let frame = ResultFrame {
                number: (t - self.start) as usize,
                frame: Arc::new(Frame::new(self.extent, t, result.frame(in_window).to_vec())),
                computed: active.clone().map(|active| (active, in_window / self.cells.size()[0])),
                cell: [self.cells.size()[1], self.cells.size()[2]],
                inference,
            };
            self.deliver.send(frame).map_err(|_| Error::Stopped)?;
            self.done.frames += 1;
        }
        Ok(())
    }
}

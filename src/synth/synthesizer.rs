//! Runs a model over a capture.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::Backend;
use super::tiles::{Grid, Stretch};
use super::windows;
use crate::network::{Executor, Model, Plan, Window};
use crate::sensor::{Calibration, Capture, SensorError, hold_to_covering};
use crate::video::Video;
use crate::{Error, Result};

/// A model made ready for captures of one size.
pub struct Synthesizer {
    window: Window,
    calibration: Calibration,
    extent: [usize; 2],
    grid: Grid,
    /// Executors by the size of tile that they are for; few, since only tiles at the borders differ.
    executors: Vec<([usize; 2], Box<dyn Executor>)>,
    flop: f64,
}

/// What a run did.
#[derive(Clone, Debug)]
pub struct Report {
    /// Result frames.
    pub frames: usize,
    /// Windows.
    pub windows: usize,
    /// Tiles per window.
    pub tiles: usize,
    /// Time that each window took, tiles and transfers included.
    pub window_times: Vec<Duration>,
    /// Result frames per window.
    pub hop: usize,
    /// The executor, in words.
    pub executor: String,
    /// Operations of the convolutions per result frame.
    pub flop_per_frame: f64,
}

impl Report {
    /// Median time per result frame in milliseconds.
    pub fn ms_per_frame(&self) -> f64 {
        let mut times = self.window_times.clone();
        times.sort_unstable();
        times.get(times.len() / 2).map_or(0.0, |time| 1e3 * time.as_secs_f64() / self.hop as f64)
    }
}

/// Checks that `model` was made for what `capture` holds. A different pattern is refused, a different response is
/// a warning, which is returned.
pub fn check_fits(model: &Model, capture: &Capture) -> Result<Option<String>> {
    model.check_pattern(&capture.pattern)?;
    let response = serde_json::to_value(capture.response.form()).unwrap_or_default();
    let trained = &model.trained.response;
    Ok((trained != "any" && *trained != response).then(|| {
        format!(
            "weights '{}' were trained for response {trained}, the capture has {response}",
            model.graph.name
        )
    }))
}

impl Synthesizer {
    /// Makes `model` ready for frames of `extent` [rows, columns] of a camera. `side` limits the tiles.
    pub fn new(
        model: &Model,
        calibration: Calibration,
        extent: [usize; 2],
        backend: &Backend,
        side: Option<usize>,
    ) -> Result<Self> {
        model.graph.check_renders_video()?;
        let grid = Grid::fit(model, &calibration, extent, backend.limits(side))?;
        let mut executors: Vec<([usize; 2], Box<dyn Executor>)> = Vec::new();
        let mut flop_of_size = Vec::new();
        let mut flop = 0.0;
        for (row, col) in grid.tiles() {
            let size = [row.outer_len, col.outer_len];
            if let Some(known) = executors.iter().position(|(known, _)| *known == size) {
                flop += flop_of_size[known];
                continue;
            }
            let plan = Plan::lower(model, size[0], size[1])?;
            flop += plan.flop();
            flop_of_size.push(plan.flop());
            executors.push((size, backend.executor(plan, &calibration)?));
        }
        let window = model.graph.window;
        Ok(Self { window, calibration, extent, grid, executors, flop: flop / window.hop as f64 })
    }

    /// The tiles.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Synthesises all frames of `capture`; `sink` gets each one [rows, columns] in order, as irradiance p.
    pub fn run(
        &mut self,
        capture: &Capture,
        mut sink: impl FnMut(usize, &[f32]) -> Result<()>,
    ) -> Result<Report> {
        if [capture.height, capture.width] != self.extent || capture.calibration() != self.calibration {
            return Err(SensorError::Capture(
                "not the size or camera that the synthesis was made for".into(),
            )
            .into());
        }
        let capture = &*hold_to_covering(capture);
        let start = capture.info.schedule_start;
        let all = windows::covering(self.window, start, capture.frames);
        let mut report = Report {
            frames: capture.frames,
            windows: all.clone().count(),
            tiles: self.grid.tiles().count(),
            window_times: Vec::new(),
            hop: self.window.hop,
            executor: self.executors[0].1.describe(),
            flop_per_frame: self.flop,
        };
        // Frames that the window sees, with their schedule times.
        let mut seen: VecDeque<(i64, Vec<f32>)> = VecDeque::new();
        let mut result = Video::black(self.window.hop, self.extent[0], self.extent[1]);
        for k in all {
            let begun = Instant::now();
            let times = windows::seen(self.window, k);
            let schedule = times.start;
            while seen.front().is_some_and(|(t, _)| *t < schedule) {
                seen.pop_front();
            }
            for t in seen.back().map_or(schedule, |(t, _)| t + 1).max(schedule)..times.end {
                let index = windows::stand_in(&self.calibration, start, capture.frames, t);
                seen.push_back((t, self.padded_frame(capture, index)));
            }
            self.window(&seen, schedule, &mut result)?;
            report.window_times.push(begun.elapsed());
            for t in 0..self.window.hop {
                let index = k * self.window.hop as i64 + t as i64 - start;
                if (0..capture.frames as i64).contains(&index) {
                    sink(index as usize, result.frame(t))?;
                }
            }
        }
        Ok(report)
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

    /// Pixel values of one frame, extended to the grid's size by pixels at the same place of the pattern.
    fn padded_frame(&self, capture: &Capture, index: usize) -> Vec<f32> {
        let mut values = vec![0.0; self.extent[0] * self.extent[1]];
        capture.pixel_values(index, &mut values);
        windows::padded(values, &self.calibration, self.extent, [self.grid.height, self.grid.width])
    }

    /// Runs all tiles of one window.
    fn window(&mut self, seen: &VecDeque<(i64, Vec<f32>)>, schedule: i64, result: &mut Video) -> Result<()> {
        let Self { grid, executors, extent: [height, width], .. } = self;
        for (row, col) in grid.tiles() {
            let [tile_height, tile_width] = [row.outer_len, col.outer_len];
            let mut measurement = Vec::with_capacity(seen.len() * tile_height * tile_width);
            for (_, frame) in seen {
                for y in row.outer_start..row.outer_start + tile_height {
                    measurement.extend_from_slice(&frame[y * grid.width + col.outer_start..][..tile_width]);
                }
            }
            let (_, executor) = executors
                .iter_mut()
                .find(|(size, _)| *size == [tile_height, tile_width])
                .ok_or_else(|| Error::Usage("a tile without an executor".into()))?;
            let mut tile = vec![0.0; result.frames * tile_height * tile_width];
            executor.run(&measurement, schedule, &mut tile)?;
            keep(&tile, (row, col), [*height, *width], result);
        }
        Ok(())
    }
}

/// Copies the part of a computed tile that is kept, and that lies within the frame, into the result.
fn keep(tile: &[f32], (row, col): (Stretch, Stretch), [height, width]: [usize; 2], result: &mut Video) {
    let columns = col.len.min(width.saturating_sub(col.start));
    for t in 0..result.frames {
        for y in row.start..(row.start + row.len).min(height) {
            let from =
                (t * row.outer_len + y - row.outer_start) * col.outer_len + col.start - col.outer_start;
            result.frame_mut(t)[y * width + col.start..][..columns].copy_from_slice(&tile[from..][..columns]);
        }
    }
}

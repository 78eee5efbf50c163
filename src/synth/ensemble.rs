//! Self-ensemble: the mean of what a net makes of several views of a window in which the camera's pattern looks the
//! same (Timofte, Rothe, Van Gool, Seven ways to improve example-based single image super resolution, 2016).

use std::time::Duration;

use rayon::prelude::*;

use crate::Result;
use crate::cpu::Tone;
use crate::network::{Executor, Graph, NetworkError, Plan, Step, Tensor, Window, WindowTime};
use crate::sensor::{Calibration, Symmetry};

/// The first `count` views of a recording that a net can be given, at least one: of its camera's symmetries, those that
/// change times only where the net treats all times alike, past and future too.
pub fn views(graph: &Graph, calibration: &Calibration, count: usize) -> Result<Vec<Symmetry>> {
    let Window { frames, lead, hop } = graph.window;
    let [step, ..] = graph.granularity()?;
    let timeless = step == 1 && frames - hop - lead == lead;
    let usable = |view: &&Symmetry| timeless || (!view.backwards[0] && view.shift[0] == 0);
    let mut views: Vec<Symmetry> = calibration.symmetries.iter().filter(usable).copied().collect();
    if views.len() < count {
        let problem =
            format!("an ensemble of {count} views, but the pattern looks the same in {} only", views.len());
        return Err(NetworkError::Graph(graph.name.clone(), problem).into());
    }
    views.truncate(count.max(1));
    Ok(views)
}

/// Has an executor compute each window in several views.
pub struct Ensemble {
    executor: Box<dyn Executor>,
    views: Vec<View>,
    window: Window,
    extent: [usize; 2],
    /// One over the number of views that show a pixel.
    shares: Vec<f32>,
    /// The measurement in a view, and a result in it.
    seen: Vec<f32>,
    result: Vec<f32>,
    /// Sums of l over those views whose results were collected.
    sums: Vec<f32>,
    submitted: usize,
    collected: usize,
}

/// A view of windows of one size.
struct View {
    symmetry: Symmetry,
    rows: Vec<Place>,
    cols: Vec<Place>,
}

/// The row or column that a view shows; another one at the same place of the pattern stands in for one outside.
#[derive(Clone, Copy)]
struct Place {
    index: usize,
    inside: bool,
}

/// What a view shows in `size` rows or columns of a pattern that repeats after `period`, which `size` is a multiple of.
fn places(symmetry: Symmetry, axis: usize, size: usize, period: usize) -> Vec<Place> {
    let [size, period, shift] = [size, period, symmetry.shift[axis]].map(|n| n as i64);
    // Backwards, the last one comes first that lies at the right place of the pattern.
    let last = size - 1 - (size - shift).rem_euclid(period);
    let place = |at: i64| {
        let index = if symmetry.backwards[axis] { last - at } else { at + shift };
        let inside = (0..size).contains(&index);
        let index = if index < 0 {
            index + period
        } else if inside {
            index
        } else {
            index - period
        };
        Place { index: index as usize, inside }
    };
    (0..size).map(place).collect()
}

impl Ensemble {
    /// The mean over `views` of what `executor` makes of windows of `extent` [rows, columns]: `executor` itself, where there
    /// is one view.
    pub fn over(
        executor: Box<dyn Executor>,
        views: &[Symmetry],
        window: Window,
        extent: [usize; 2],
        calibration: &Calibration,
    ) -> Box<dyn Executor> {
        if views.len() == 1 && views[0] == Symmetry::IDENTITY {
            return executor;
        }
        Box::new(Self::new(executor, views, window, extent, calibration))
    }

    fn new(
        executor: Box<dyn Executor>,
        views: &[Symmetry],
        window: Window,
        extent: [usize; 2],
        calibration: &Calibration,
    ) -> Self {
        let [height, width] = extent;
        let view = |&symmetry: &Symmetry| View {
            symmetry,
            rows: places(symmetry, 1, height, calibration.rows),
            cols: places(symmetry, 2, width, calibration.cols),
        };
        let views: Vec<View> = views.iter().map(view).collect();
        let mut counts = vec![0.0f32; height * width];
        for View { rows, cols, .. } in &views {
            for row in rows.iter().filter(|row| row.inside) {
                for col in cols.iter().filter(|col| col.inside) {
                    counts[row.index * width + col.index] += 1.0;
                }
            }
        }
        let [seen, result] = [window.frames, window.hop].map(|frames| vec![0.0; frames * height * width]);
        Self {
            executor,
            views,
            window,
            extent,
            shares: counts.into_iter().map(f32::recip).collect(),
            seen,
            sums: result.clone(),
            result,
            submitted: 0,
            collected: 0,
        }
    }

    /// Puts a window in view `number` into `seen`, and returns its schedule time.
    fn look(&mut self, number: usize, measurement: &[f32], schedule: i64) -> i64 {
        let View { symmetry, rows, cols } = &self.views[number];
        let [height, width] = self.extent;
        let (frame, frames) = (height * width, self.window.frames);
        let backwards = symmetry.backwards[0];
        self.seen.par_chunks_mut(frame).enumerate().for_each(|(t, seen)| {
            let t = if backwards { frames - 1 - t } else { t };
            let measured = &measurement[t * frame..][..frame];
            for (seen, row) in seen.chunks_mut(width).zip(rows) {
                let measured = &measured[row.index * width..][..width];
                seen.iter_mut().zip(cols).for_each(|(seen, col)| *seen = measured[col.index]);
            }
        });
        symmetry.beginning(schedule, frames)
    }

    /// Adds the next result to the sums.
    fn take(&mut self) -> Result<()> {
        self.executor.collect(&mut self.result)?;
        let View { symmetry, rows, cols } = &self.views[self.collected];
        let width = self.extent[1];
        let frame = self.shares.len();
        let tone = Tone::<f32>::new();
        let mut sums: Vec<&mut [f32]> = self.sums.chunks_mut(frame).collect();
        if symmetry.backwards[0] {
            sums.reverse();
        }
        self.result.par_chunks_mut(frame).zip(sums).for_each(|(result, sums)| {
            tone.of_all(result);
            for (result, row) in result.chunks(width).zip(rows).filter(|(_, row)| row.inside) {
                let sums = &mut sums[row.index * width..][..width];
                for (&value, col) in result.iter().zip(cols).filter(|(_, col)| col.inside) {
                    sums[col.index] += value;
                }
            }
        });
        self.collected += 1;
        Ok(())
    }
}

impl Executor for Ensemble {
    fn plan(&self) -> &Plan {
        self.executor.plan()
    }

    fn run(&mut self, measurement: &[f32], schedule: i64, result: &mut [f32]) -> Result<()> {
        self.submit(measurement, schedule)?;
        self.collect(result)
    }

    fn submit(&mut self, measurement: &[f32], schedule: i64) -> Result<()> {
        self.sums.fill(0.0);
        (self.submitted, self.collected) = (0, 0);
        while self.submitted < self.views.len() {
            if self.submitted - self.collected == self.executor.in_flight() {
                self.take()?;
            }
            let schedule = self.look(self.submitted, measurement, schedule);
            self.executor.submit(&self.seen, schedule)?;
            self.submitted += 1;
        }
        Ok(())
    }

    fn collect(&mut self, result: &mut [f32]) -> Result<()> {
        while self.collected < self.submitted {
            self.take()?;
        }
        let tone = Tone::<f32>::new();
        let frame = self.shares.len();
        result.par_chunks_mut(frame).zip(self.sums.par_chunks(frame)).for_each(|(result, sums)| {
            let means = sums.iter().zip(&self.shares).map(|(sum, share)| sum * share);
            result.iter_mut().zip(means).for_each(|(result, mean)| *result = mean);
            tone.inverse_of_all(result);
        });
        Ok(())
    }

    fn in_flight(&self) -> usize {
        1
    }

    /// The steps of the first view.
    fn trace(
        &mut self,
        measurement: &[f32],
        schedule: i64,
        visit: &mut dyn FnMut(&Step, &[Tensor], &Tensor),
    ) -> Result<()> {
        let schedule = self.look(0, measurement, schedule);
        self.executor.trace(&self.seen, schedule, visit)
    }

    fn time_windows(&mut self, measurement: &[f32], schedule: i64, windows: usize) -> Result<WindowTime> {
        self.executor.time_windows(measurement, schedule, windows * self.views.len())
    }

    /// The steps of one view.
    fn time_steps(&mut self, measurement: &[f32], schedule: i64) -> Result<Vec<Duration>> {
        self.executor.time_steps(measurement, schedule)
    }

    fn describe(&self) -> String {
        format!("{}, mean of {} views", self.executor.describe(), self.views.len())
    }

    fn rescaled(&self) -> Vec<(String, f32)> {
        self.executor.rescaled()
    }
}

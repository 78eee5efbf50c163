//! Self-ensemble: the mean of what a net makes of several poses of a window in which the camera's pattern looks the
//! same (Timofte, Rothe, Van Gool, Seven ways to improve example-based single image super resolution, 2016).

use std::time::Duration;

use rayon::prelude::*;

use crate::Result;
use crate::cpu::Tone;
use crate::network::{Executor, Graph, Inspect, NetworkError, Plan, State, Step, Tensor, Window, WindowTime};
use crate::sensor::{Calibration, Symmetry};

/// The first `count` poses in which a net can be shown a recording, at least one: of its camera's symmetries, those that
/// change times only where the net treats all times alike, past and future too.
pub fn poses(graph: &Graph, calibration: &Calibration, count: usize) -> Result<Vec<Symmetry>> {
    let Window { frames, lead, hop } = graph.window;
    let [step, ..] = graph.granularity()?;
    let timeless = step == 1 && frames - hop - lead == lead;
    let usable = |pose: &&Symmetry| timeless || (!pose.backwards[0] && pose.shift[0] == 0);
    let mut poses: Vec<Symmetry> = calibration.symmetries.iter().filter(usable).copied().collect();
    if poses.len() < count {
        let problem =
            format!("an ensemble of {count} views, but the pattern looks the same in {} only", poses.len());
        return Err(NetworkError::Graph(graph.name.clone(), problem).into());
    }
    poses.truncate(count.max(1));
    Ok(poses)
}

/// Has an executor compute each window in several poses.
pub struct Ensemble {
    executor: Box<dyn Inspect>,
    poses: Vec<Pose>,
    window: Window,
    extent: [usize; 2],
    /// One over the number of poses that show a pixel.
    shares: Vec<f32>,
    /// The measurement in a pose, and a result in it.
    seen: Vec<f32>,
    result: Vec<f32>,
    /// Sums of l over those poses whose results were collected.
    sums: Vec<f32>,
    submitted: usize,
    collected: usize,
}

/// A pose of windows of one size.
struct Pose {
    symmetry: Symmetry,
    rows: Vec<Remapped>,
    cols: Vec<Remapped>,
}

/// The row or column that a pose shows; another one at the same place of the pattern stands in for one outside.
#[derive(Clone, Copy)]
struct Remapped {
    index: usize,
    inside: bool,
}

/// What a pose shows in `size` rows or columns of a pattern that repeats after `period`, which `size` is a multiple of.
fn remap(symmetry: Symmetry, axis: usize, size: usize, period: usize) -> Vec<Remapped> {
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
        Remapped { index: index as usize, inside }
    };
    (0..size).map(place).collect()
}

impl Ensemble {
    /// The mean over `poses` of what `executor` makes of windows of `extent` [rows, columns]: `executor` itself, where there
    /// is one pose.
    pub fn over(
        executor: Box<dyn Inspect>,
        poses: &[Symmetry],
        window: Window,
        extent: [usize; 2],
        calibration: &Calibration,
    ) -> Box<dyn Inspect> {
        if poses.len() == 1 && poses[0] == Symmetry::IDENTITY {
            return executor;
        }
        Box::new(Self::new(executor, poses, window, extent, calibration))
    }

    fn new(
        executor: Box<dyn Inspect>,
        poses: &[Symmetry],
        window: Window,
        extent: [usize; 2],
        calibration: &Calibration,
    ) -> Self {
        let [height, width] = extent;
        let pose = |&symmetry: &Symmetry| Pose {
            symmetry,
            rows: remap(symmetry, 1, height, calibration.rows),
            cols: remap(symmetry, 2, width, calibration.cols),
        };
        let poses: Vec<Pose> = poses.iter().map(pose).collect();
        let mut counts = vec![0.0f32; height * width];
        for Pose { rows, cols, .. } in &poses {
            for row in rows.iter().filter(|row| row.inside) {
                for col in cols.iter().filter(|col| col.inside) {
                    counts[row.index * width + col.index] += 1.0;
                }
            }
        }
        let [seen, result] = [window.frames, window.hop].map(|frames| vec![0.0; frames * height * width]);
        Self {
            executor,
            poses,
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

    /// Puts a window in pose `number` into `seen`, and returns its schedule time.
    fn look(&mut self, number: usize, measurement: &[f32], schedule: i64) -> i64 {
        let Pose { symmetry, rows, cols } = &self.poses[number];
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
        let Pose { symmetry, rows, cols } = &self.poses[self.collected];
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

    /// A state for each pose whose windows follow each other: those of one that runs backwards do not.
    fn state(&self) -> Result<State> {
        let own = |pose: &Pose| (!pose.symmetry.backwards[0]).then(|| self.executor.state()).transpose();
        Ok(State::new(self.poses.iter().map(own).collect::<Result<Vec<_>>>()?))
    }

    fn submit(&mut self, measurement: &[f32], schedule: i64, state: Option<&mut State>) -> Result<()> {
        let mut alone = Vec::new();
        let states: &mut Vec<Option<State>> = match state {
            Some(state) => {
                let follows = state.advance(schedule, self.window.hop);
                let states: &mut Vec<Option<State>> = state.left()?;
                if !follows {
                    states.iter_mut().flatten().for_each(State::forget);
                }
                states
            }
            None => &mut alone,
        };
        self.sums.fill(0.0);
        (self.submitted, self.collected) = (0, 0);
        while self.submitted < self.poses.len() {
            if self.executor.waiting() == self.executor.in_flight() {
                self.take()?;
            }
            let schedule = self.look(self.submitted, measurement, schedule);
            let own = states.get_mut(self.submitted).and_then(Option::as_mut);
            self.executor.submit(&self.seen, schedule, own)?;
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

    fn waiting(&self) -> usize {
        usize::from(self.collected < self.submitted)
    }

    fn describe(&self) -> String {
        format!("{}, mean of {} views", self.executor.describe(), self.poses.len())
    }
}

impl Inspect for Ensemble {
    /// The steps of the first pose.
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
        self.executor.time_windows(measurement, schedule, windows * self.poses.len())
    }

    /// The steps of one pose.
    fn time_steps(&mut self, measurement: &[f32], schedule: i64) -> Result<Vec<Duration>> {
        self.executor.time_steps(measurement, schedule)
    }

    fn rescaled(&self) -> Vec<(String, f32)> {
        self.executor.rescaled()
    }
}

//! The last result of every cell: what cells that are skipped are given.

use super::cells::{Active, Cells};
use super::tally::Audit;
use crate::math::tone;
use crate::video::Video;

/// The last results of all cells at each phase of the pattern.
pub struct Kept {
    cells: Cells,
    /// Irradiance p, [repeat, rows, columns].
    results: Video,
}

impl Kept {
    /// Nothing yet, of frames of `extent` [rows, columns].
    pub fn new(cells: &Cells, [height, width]: [usize; 2]) -> Self {
        Self { cells: cells.clone(), results: Video::black(cells.repeat, height, width) }
    }

    /// Where a frame at schedule time `t` has its last results.
    fn phase(&self, t: i64) -> usize {
        t.rem_euclid(self.cells.repeat as i64) as usize
    }

    /// Holds kept results against `result`, a window from schedule time `begin` on: of those cells of its first slab that
    /// are `audited`, the mean difference of l.
    pub fn audit(&self, begin: i64, audited: &[bool], result: &Video, audit: &mut Audit) {
        let [frames, rows, cols] = self.cells.size;
        let Video { height, width, .. } = *result;
        for (cell, _) in audited.iter().enumerate().filter(|(_, audited)| **audited) {
            let (r, c) = (cell / self.cells.cols(), cell % self.cells.cols());
            let (mut sum, mut n) = (0.0, 0usize);
            for t in 0..frames {
                let kept = self.results.frame(self.phase(begin + t as i64));
                let fresh = result.frame(t);
                for y in r * rows..((r + 1) * rows).min(height) {
                    for x in c * cols..((c + 1) * cols).min(width) {
                        let l = |frame: &[f32]| tone(f64::from(frame[y * width + x]));
                        sum += l(kept) - l(fresh);
                        n += 1;
                    }
                }
            }
            if n > 0 {
                audit.add(sum / n as f64);
            }
        }
    }

    /// Gives cells of `result`, a window from schedule time `begin` on, that are not `active` their last results, and
    /// keeps those of the others.
    pub fn merge(&mut self, begin: i64, active: &Active, result: &mut Video) {
        let [frames, rows, cols] = self.cells.size;
        let Video { height, width, .. } = *result;
        for t in 0..result.frames {
            let phase = self.phase(begin + t as i64);
            let (result, kept) = (result.frame_mut(t), self.results.frame_mut(phase));
            let active = active.slab(t / frames);
            for y in 0..height {
                let active = &active[y / rows * self.cells.cols()..][..self.cells.cols()];
                let mut x = 0;
                for same in active.chunk_by(|a, b| a == b) {
                    let end = (x + same.len() * cols).min(width);
                    let here = y * width + x.min(width)..y * width + end;
                    if same[0] {
                        kept[here.clone()].copy_from_slice(&result[here]);
                    } else {
                        result[here.clone()].copy_from_slice(&kept[here]);
                    }
                    x = end;
                }
            }
        }
    }
}

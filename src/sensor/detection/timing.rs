//! Whether frames hold the exposure that covers them or the last finished read-out.
//!
//! Where the scene moves, what a long exposure saw is the mean of what short ones beside it saw at the same time. Held
//! values come later the longer they were exposed, so it is another mean in either case.

use crate::math::spread;
use crate::sensor::{Pattern, Schedule, Timing};
use crate::video::Counts;

/// Frames and cells that are kept to be looked at.
const FRAMES: usize = 192;
const CELLS: usize = 1024;
/// Counts from which on a pixel may be saturated, as a part of the largest one.
const SATURATED: f64 = 0.93;
/// Groups of cells, one of each in so many neighbours, whose agreement tells how certain the answer is.
const GROUPS: usize = 32;
/// Least number of standard errors, least part of the long exposures' changes that has to be told, and least correlation.
const CERTAIN: f64 = 4.0;
const TELLING: f64 = 0.1;
const CORRELATED: f64 = 0.4;

/// The first frames of some *cells*, squares after which the pattern repeats, spread over the frame.
#[derive(Clone, Debug)]
pub struct Excerpt {
    grid: usize,
    width: usize,
    /// Upper left pixels of the cells.
    corners: Vec<usize>,
    /// Counts [t, cell, y, x].
    counts: Vec<u16>,
    frames: usize,
}

/// A change of a long exposure from one read-out to the next, and of the means of short ones beside it over the frames
/// that it saw if frames hold what covers them, or the last read-out.
#[derive(Clone, Copy)]
struct Change {
    group: usize,
    long: f64,
    short: [f64; 2],
}

impl Excerpt {
    pub fn new(grid: usize, [height, width]: [usize; 2]) -> Self {
        let (rows, cols) = (height / grid, width / grid);
        let corner = |cell: usize| (cell / cols * width + cell % cols) * grid;
        Self {
            grid,
            width,
            corners: spread(rows * cols, CELLS).map(corner).collect(),
            counts: Vec::new(),
            frames: 0,
        }
    }

    pub fn add(&mut self, counts: &Counts) {
        if self.frames == FRAMES {
            return;
        }
        for &corner in &self.corners {
            for y in 0..self.grid {
                let first = corner + y * self.width;
                self.counts.extend((first..first + self.grid).map(|i| counts.value(i)));
            }
        }
        self.frames += 1;
    }

    /// What frames hold of a recording that shows `pattern` from schedule time `start` on; nothing if that is not clear.
    pub fn timing(&self, pattern: &Pattern, start: i64) -> Option<Timing> {
        let places: Vec<&Schedule> = (0..self.grid * self.grid)
            .map(|place| pattern.schedule(place / self.grid, place % self.grid))
            .collect();
        let exposures = || places.iter().filter_map(|pixel| single_exposure(pixel));
        let (shortest, longest) = (exposures().min()?, exposures().max()?);
        if longest < 2 * shortest {
            return None;
        }
        let of = |exposure: usize| -> Vec<usize> {
            (0..places.len()).filter(|&place| single_exposure(places[place]) == Some(exposure)).collect()
        };
        let (short, long) = (of(shortest), of(longest));
        // One kind of long exposures for each time at which they read out; of these, those that lie around the short ones.
        let mut kinds: Vec<Vec<usize>> = Vec::new();
        for place in long {
            match kinds.iter_mut().find(|kind| places[kind[0]] == places[place]) {
                Some(kind) => kind.push(place),
                None => kinds.push(vec![place]),
            }
        }
        // Where an edge moves slowly, a pixel beside another one sees it frames later.
        let centre = |places: &[usize]| {
            let n = places.len() as f64;
            [0, 1].map(|axis| {
                let at = |place: &usize| [place / self.grid, place % self.grid][axis] as f64;
                places.iter().map(at).sum::<f64>() / n
            })
        };
        let beside = |kind: &Vec<usize>| {
            let [one, other] = [centre(kind), centre(&short)];
            (one[0] - other[0]).abs() + (one[1] - other[1]).abs() < 0.5
        };
        let changes: Vec<Change> = kinds
            .iter()
            .filter(|kind| beside(kind))
            .flat_map(|kind| {
                let first = places[kind[0]].covering(start).start - start;
                self.changes(kind, &short, [longest, shortest], first)
            })
            .collect();
        decide(&changes)
    }

    /// Those of one kind of long exposures, which begins to show new values at frame `first` and every `longest` behind it.
    fn changes(
        &self,
        long: &[usize],
        short: &[usize],
        [longest, shortest]: [usize; 2],
        first: i64,
    ) -> Vec<Change> {
        let (cells, pixels) = (self.corners.len(), self.grid * self.grid);
        let most = self.counts.iter().copied().max().map_or(0.0, f64::from);
        let counts = |t: usize, cell: usize| &self.counts[(t * cells + cell) * pixels..][..pixels];
        let mean = |t: usize, cell: usize, places: &[usize]| {
            let counts = counts(t, cell);
            places.iter().map(|&place| f64::from(counts[place])).sum::<f64>() / places.len() as f64
        };
        let [e, s] = [longest as i64, shortest as i64];
        let last = self.frames as i64 - e;
        let shown: Vec<i64> = (0..=last).filter(|t| (t - first) % e == 0 && t - e + s >= 0).collect();
        let mut found = Vec::new();
        for cell in 0..cells {
            let short: Vec<f64> = (0..self.frames).map(|t| mean(t, cell, short)).collect();
            let over = |from: i64| short[from as usize..(from + e) as usize].iter().sum::<f64>() / e as f64;
            let readouts: Vec<(f64, bool, [f64; 2])> = shown
                .iter()
                .map(|&t| {
                    let saturated = long
                        .iter()
                        .any(|&place| f64::from(counts(t as usize, cell)[place]) >= SATURATED * most);
                    (mean(t as usize, cell, long), saturated, [over(t), over(t - e + s)])
                })
                .collect();
            for pair in readouts.windows(2).filter(|pair| !pair[0].1 && !pair[1].1) {
                let short = [0, 1].map(|timing| pair[1].2[timing] - pair[0].2[timing]);
                found.push(Change { group: cell % GROUPS, long: pair[1].0 - pair[0].0, short });
            }
        }
        found
    }
}

/// The exposure of a pixel all of whose read-outs are alike.
fn single_exposure(pixel: &Schedule) -> Option<usize> {
    (pixel.shutters().len() == 1).then(|| pixel.exposure()).flatten()
}

/// Which mean follows the long exposures, if one clearly does.
fn decide(changes: &[Change]) -> Option<Timing> {
    let sum = |value: &dyn Fn(&Change) -> f64| changes.iter().map(value).sum::<f64>();
    let long = sum(&|change| change.long * change.long);
    let power = [0, 1].map(|timing| sum(&|change| change.short[timing] * change.short[timing]));
    let product = [0, 1].map(|timing| sum(&|change| change.short[timing] * change.long));
    if long <= 0.0 || power.contains(&0.0) {
        return None;
    }
    let gain = [0, 1].map(|timing| product[timing] / power[timing]);
    let correlation = [0, 1].map(|timing| product[timing] / (power[timing] * long).sqrt());
    // How much better the first one tells a change, from −1 to 1; a change that is but noise tells nothing.
    let noise = long / changes.len() as f64;
    let better = |change: &Change| {
        let told = [0, 1].map(|timing| gain[timing] * change.short[timing]);
        let left = told.map(|told| (change.long - told).powi(2));
        let all = change.long.powi(2) + told[0].powi(2) + told[1].powi(2) + noise;
        (left[1] - left[0]) / all
    };
    let mut groups = [0.0f64; GROUPS];
    for change in changes {
        groups[change.group] += better(change);
    }
    let mean = groups.iter().sum::<f64>() / GROUPS as f64;
    let variance = groups.iter().map(|sum| (sum - mean).powi(2)).sum::<f64>() / (GROUPS - 1) as f64;
    let errors = mean / (variance / GROUPS as f64).sqrt().max(1e-12);
    let telling = correlation[0].powi(2) - correlation[1].powi(2);
    let certain = |sign: f64, correlation: f64| {
        sign * errors >= CERTAIN && sign * telling >= TELLING && correlation >= CORRELATED
    };
    if certain(1.0, correlation[0]) {
        Some(Timing::Covering)
    } else if certain(-1.0, correlation[1]) {
        Some(Timing::Hold)
    } else {
        None
    }
}

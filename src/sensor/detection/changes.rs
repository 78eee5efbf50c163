//! How much the pixels of each place change from one frame to the next.

use crate::video::Counts;

/// Changes beyond which a larger one says no more, in counts of 8 and of more bits: what lossy video adds between
/// read-outs is small, and a moving edge should not drown all else.
const CAP: [u16; 2] = [8, 32];

/// Frames that are followed: memory is not to grow with the length of a recording. So many are more than two minutes.
const FRAMES: usize = 1 << 17;

/// Changes of a recording. Pixels whose rows and columns differ by multiples of `grid` are a *class*: all that a pattern
/// can tell apart.
#[derive(Clone, Debug)]
pub struct Changes {
    grid: usize,
    width: usize,
    before: Option<Counts>,
    /// Mean change of each class from one frame to the next, as a part of [`CAP`]: [frames − 1, grid, grid].
    rates: Vec<f32>,
    /// Changes of each class that were not 0, over all frames.
    changed: Vec<u64>,
}

impl Changes {
    /// Those of frames `width` pixels wide.
    pub fn new(grid: usize, width: usize) -> Self {
        let changed = vec![0; grid * grid];
        Self { grid, width, before: None, rates: Vec::new(), changed }
    }

    /// Looks at the next frame.
    pub fn add(&mut self, counts: &Counts) {
        if self.rates.len() >= FRAMES * self.changed.len() {
            return;
        }
        match (&self.before, counts) {
            (Some(Counts::U8(before)), Counts::U8(now)) => {
                compare(before, now, self.width, self.grid, CAP[0], &mut self.rates, &mut self.changed);
            }
            (Some(Counts::U16(before)), Counts::U16(now)) => {
                compare(before, now, self.width, self.grid, CAP[1], &mut self.rates, &mut self.changed);
            }
            _ => {}
        }
        self.before = Some(counts.clone());
    }

    /// Rows and columns of classes.
    pub fn grid(&self) -> usize {
        self.grid
    }

    /// Rates of all classes, row by row, for each frame from the second one on, with its number.
    pub fn rates(&self) -> impl Iterator<Item = (usize, &[f32])> {
        (1..).zip(self.rates.chunks(self.grid * self.grid))
    }

    /// How often a pixel of each class changed.
    pub fn changed(&self) -> &[u64] {
        &self.changed
    }
}

fn compare<C: Copy + Into<u16>>(
    before: &[C],
    now: &[C],
    width: usize,
    grid: usize,
    cap: u16,
    rates: &mut Vec<f32>,
    changed: &mut [u64],
) {
    let classes = grid * grid;
    let (mut sums, mut pixels) = (vec![0u64; classes], vec![0u64; classes]);
    let rows = before.chunks(width).zip(now.chunks(width));
    for (y, (before, now)) in rows.enumerate() {
        let row = y % grid * grid;
        let (sums, changed) = (&mut sums[row..][..grid], &mut changed[row..][..grid]);
        for (before, now) in before.chunks(grid).zip(now.chunks(grid)) {
            for (class, (&before, &now)) in before.iter().zip(now).enumerate() {
                let change = before.into().abs_diff(now.into());
                sums[class] += u64::from(change.min(cap));
                changed[class] += u64::from(change > 0);
            }
        }
        for (class, pixels) in pixels[row..][..grid].iter_mut().enumerate() {
            *pixels += (width.saturating_sub(class)).div_ceil(grid) as u64;
        }
    }
    let most = f64::from(cap);
    rates.extend(sums.iter().zip(&pixels).map(|(&sum, &n)| (sum as f64 / (most * n.max(1) as f64)) as f32));
}

//! When the pixels of each place of a pattern read out.

use crate::sensor::Pattern;

/// When each class reads out: for each time of the period, whether a new value begins to show.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signature {
    pub period: usize,
    pub classes: usize,
    /// [period, classes].
    begins: Vec<bool>,
}

impl Signature {
    pub fn new(pattern: &Pattern, grid: usize) -> Self {
        let period = pattern.period();
        let places = || (0..grid).flat_map(|y| (0..grid).map(move |x| (y, x)));
        let begins = (0..period as i64)
            .flat_map(|t| places().map(move |(y, x)| (t, y, x)))
            .map(|(t, y, x)| pattern.schedule(y, x).covering(t).start == t)
            .collect();
        Self { period, classes: grid * grid, begins }
    }

    /// Which classes begin to show a new value at schedule time `t`.
    pub fn at(&self, t: usize) -> &[bool] {
        &self.begins[t % self.period * self.classes..][..self.classes]
    }

    /// That of a recording that begins `start` later.
    pub fn from(&self, start: usize) -> Self {
        let begins = (0..self.period).flat_map(|t| self.at(start + t)).copied().collect();
        Self { begins, ..*self }
    }
}

//! When read-outs of a pattern begin to show, as a table.

use super::Pattern;

/// In which frame each read-out of a pattern begins to show, and its exposure.
#[derive(Debug)]
pub struct Readouts {
    exposures: Vec<usize>,
    /// Number of the exposure that begins, [period, rows, cols].
    begins: Vec<Option<usize>>,
    period: usize,
    rows: usize,
    cols: usize,
}

impl Readouts {
    /// Those of `pattern`.
    pub fn new(pattern: &Pattern) -> Self {
        let mut exposures = Vec::new();
        let mut begins = Vec::new();
        for t in 0..pattern.period() as i64 {
            for schedule in pattern.schedules() {
                let readout = schedule.covering(t);
                let exposure = readout.shutter.exposure();
                let number = exposures.iter().position(|e| *e == exposure).unwrap_or_else(|| {
                    exposures.push(exposure);
                    exposures.len() - 1
                });
                begins.push((readout.start == t).then_some(number));
            }
        }
        Self { exposures, begins, period: pattern.period(), rows: pattern.rows(), cols: pattern.cols() }
    }

    /// The pattern's exposures in frames, each once.
    pub fn exposures(&self) -> &[usize] {
        &self.exposures
    }

    /// Number of the exposure whose read-out begins to show at schedule time `t` in row `y`, column `x`; `None` where
    /// the one before goes on.
    pub fn beginning(&self, t: i64, y: usize, x: usize) -> Option<usize> {
        self.beginning_in_row(t, y)[x % self.cols]
    }

    /// The same for the columns of one pattern tile.
    pub fn beginning_in_row(&self, t: i64, y: usize) -> &[Option<usize>] {
        let t = t.rem_euclid(self.period as i64) as usize;
        &self.begins[(t * self.rows + y % self.rows) * self.cols..][..self.cols]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In every frame of `mpve-1-4` one kind of pixel begins a read-out (design §3): the one that read out with it.
    #[test]
    fn a_readout_begins_where_the_one_before_ends() {
        let readouts = Readouts::new(&Pattern::built_in("mpve-1-4").unwrap());
        let begins =
            |t: i64, x: usize| readouts.beginning(t, 0, x).map(|number| readouts.exposures()[number]);
        // Columns of the first row, as (exposure, phase): (2, 1) (4, 2) (8, 0) (8, 4).
        for t in -9..20i64 {
            let expected =
                |exposure: i64, phase| (t.rem_euclid(exposure) == phase).then_some(exposure as usize);
            assert_eq!(
                [0, 1, 2, 3].map(|x| begins(t, x)),
                [(2, 1), (4, 2), (8, 0), (8, 4)].map(|(e, p)| expected(e, p))
            );
        }
        // Whole frames of 2 and 8 in turn.
        let readouts = Readouts::new(&Pattern::built_in("interleaved").unwrap());
        let begins = |t: i64| readouts.beginning(t, 5, 7).map(|number| readouts.exposures()[number]);
        assert_eq!(
            [0, 1, 2, 3, 9, 10, 12].map(begins),
            [Some(2), None, Some(8), None, None, Some(2), Some(8)]
        );
    }
}

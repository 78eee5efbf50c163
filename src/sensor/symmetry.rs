//! Symmetries of a pattern: mirrored, reversed in time, moved, it looks as before.

use serde::Serialize;

use super::pattern::{Pattern, Schedule, Shutter};

/// Pattern tiles × periods larger than those of the built-in patterns are not searched, which takes time with the square
/// of it.
const MAX_SIZE: usize = 256;

/// A map of times, rows and columns that takes a pattern to itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Symmetry {
    /// Whether t, y and x run backwards.
    pub backwards: [bool; 3],
    /// By how much they are moved then, less than the pattern repeats after.
    pub shift: [usize; 3],
}

impl Symmetry {
    /// All stays where it is.
    pub const IDENTITY: Self = Self { backwards: [false; 3], shift: [0; 3] };

    /// Where `at` is taken to along an axis (t, y, x).
    pub fn map(&self, axis: usize, at: i64) -> i64 {
        let shift = self.shift[axis] as i64;
        if self.backwards[axis] { (shift - 1).wrapping_sub(at) } else { at.wrapping_add(shift) }
    }

    /// The first of those times that are taken to `first` … `first + frames`.
    pub fn beginning(&self, first: i64, frames: usize) -> i64 {
        if self.backwards[0] {
            // Backwards, the map is its own inverse.
            self.map(0, first.wrapping_add(frames as i64 - 1))
        } else {
            first.wrapping_sub(self.shift[0] as i64)
        }
    }

    /// All of `pattern`: [`Symmetry::IDENTITY`], then those that change most, each followed by its products with those
    /// before it, so that the first two and four are groups as well.
    pub fn all_of(pattern: &Pattern) -> Vec<Self> {
        let repeats = [pattern.period(), pattern.rows(), pattern.cols()];
        if repeats.iter().product::<usize>() > MAX_SIZE {
            return vec![Self::IDENTITY];
        }
        let [times, rows, cols] = repeats;
        let shifts = (0..times).flat_map(|t| (0..rows).flat_map(move |y| (0..cols).map(move |x| [t, y, x])));
        let mut found: Vec<Self> = (0..8)
            .flat_map(|bits| {
                let backwards = [1, 2, 4].map(|bit| bits & bit != 0);
                shifts.clone().map(move |shift| Self { backwards, shift })
            })
            .filter(|symmetry| symmetry.keeps(pattern))
            .collect();
        let change = |symmetry: &Self| {
            let Self { backwards, shift } = symmetry;
            let moved = (0..3).filter(|&axis| backwards[axis] || shift[axis] > 0).count();
            (moved, backwards.iter().filter(|&&axis| axis).count())
        };
        found.sort_by_key(|symmetry| std::cmp::Reverse(change(symmetry)));
        let mut ordered = vec![Self::IDENTITY];
        for symmetry in found {
            if !ordered.contains(&symmetry) {
                let products = ordered.iter().map(|before| symmetry.then(before, repeats));
                let products: Vec<Self> = products.filter(|product| !ordered.contains(product)).collect();
                ordered.extend(products);
            }
        }
        ordered
    }

    /// This map, then another one, of a pattern that `repeats`.
    fn then(&self, other: &Self, repeats: [usize; 3]) -> Self {
        let backwards = [0, 1, 2].map(|axis| self.backwards[axis] != other.backwards[axis]);
        let shift = [0, 1, 2].map(|axis| {
            let first = other.map(axis, self.map(axis, 0)) + i64::from(backwards[axis]);
            first.rem_euclid(repeats[axis] as i64) as usize
        });
        Self { backwards, shift }
    }

    /// Whether `pattern` is taken to itself.
    fn keeps(&self, pattern: &Pattern) -> bool {
        let mapped =
            |axis: usize, at: usize, size: usize| self.map(axis, at as i64).rem_euclid(size as i64) as usize;
        (0..pattern.rows()).all(|y| {
            let row = mapped(1, y, pattern.rows());
            (0..pattern.cols()).all(|x| {
                let there = pattern.schedule(row, mapped(2, x, pattern.cols()));
                let here = pattern.schedule(y, x);
                there.period() == here.period() && self.taken_back(there) == here.shutters()
            })
        })
    }

    /// The shutters that are taken to those of a pixel.
    fn taken_back(&self, schedule: &Schedule) -> Vec<Shutter> {
        let period = schedule.period() as i64;
        let shutter = |shutter: &Shutter| {
            let frames = shutter.frames();
            let start = self.beginning(shutter.start() as i64, frames).rem_euclid(period) as usize;
            let open = if self.backwards[0] {
                shutter.open().iter().rev().map(|frame| frames - 1 - frame).collect()
            } else {
                shutter.open().to_vec()
            };
            Shutter::new(start, frames, open)
        };
        let mut shutters: Vec<Shutter> = schedule.shutters().iter().map(shutter).collect();
        shutters.sort_by_key(Shutter::start);
        shutters
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_symmetry_keeps_exposures_at_all_times() {
        for name in Pattern::NAMES {
            let pattern = Pattern::built_in(name).unwrap();
            let symmetries = Symmetry::all_of(&pattern);
            assert_eq!(symmetries[0], Symmetry::IDENTITY, "{name}");
            for symmetry in symmetries {
                for (t, y, x) in
                    (-9..20).flat_map(|t| (0..5).flat_map(move |y| (0..9).map(move |x| (t, y, x))))
                {
                    let [time, row, col] = [(0, t), (1, y), (2, x)].map(|(axis, at)| symmetry.map(axis, at));
                    let within = |at: i64, size: usize| at.rem_euclid(size as i64) as usize;
                    let there = pattern
                        .schedule(within(row, pattern.rows()), within(col, pattern.cols()))
                        .covering(time);
                    let here = pattern.schedule(y as usize, x as usize).covering(t);
                    // The same frames are covered: those at its ends map to each other.
                    let ends = [here.start, here.end() - 1].map(|t| symmetry.map(0, t));
                    let ends = [ends[0].min(ends[1]), ends[0].max(ends[1])];
                    assert_eq!(ends, [there.start, there.end() - 1], "{name}: {symmetry:?} at {t}, {y}, {x}");
                    assert_eq!(here.shutter.exposure(), there.shutter.exposure(), "{name}: {symmetry:?}");
                }
            }
        }
    }

    #[test]
    fn mpve_has_eight_symmetries() {
        let count = |name: &str| Symmetry::all_of(&Pattern::built_in(name).unwrap()).len();
        // Upside down, backwards in time, and a row further down with two columns to the right.
        for name in ["mpve-1-4", "mpve-1-8", "mpve-1-16"] {
            assert_eq!(count(name), 8, "{name}");
        }
        assert_eq!(count("coded"), 1);
        // One pixel that reads out every four frames: both ways along each axis.
        assert_eq!(count("global"), 8);
    }

    #[test]
    fn the_first_two_four_and_eight_symmetries_of_mpve_are_groups() {
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let symmetries = Symmetry::all_of(&pattern);
        // The second one is upside down, backwards in time and moved.
        assert_eq!(symmetries[1].backwards, [true, true, false]);
        assert_ne!(symmetries[1].shift[2], 0);
        for count in [2, 4, 8] {
            let group = &symmetries[..count];
            for (one, other) in group.iter().flat_map(|one| group.iter().map(move |other| (one, other))) {
                assert!(group.contains(&one.then(other, [8, 2, 4])), "{one:?}, then {other:?}");
            }
        }
    }
}

//! Views of a pattern in which it looks as before: mirrored, reversed in time, moved.

use serde::Serialize;

use super::pattern::{Cell, Pattern, Shutter};

/// Tiles × periods larger than those of the built-in patterns are not searched, which takes time with the square of it.
const MAX_PLACES: usize = 256;

/// A view in which a pattern looks as before: what it has at (t, y, x) lies where [`Symmetry::place`] says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Symmetry {
    /// Whether t, y and x run backwards.
    pub backwards: [bool; 3],
    /// By how much they are moved then, less than the pattern repeats after.
    pub shift: [usize; 3],
}

impl Symmetry {
    /// The view as it is.
    pub const IDENTITY: Self = Self { backwards: [false; 3], shift: [0; 3] };

    /// Where the view's `at` lies along an axis (t, y, x).
    pub fn place(&self, axis: usize, at: i64) -> i64 {
        let shift = self.shift[axis] as i64;
        if self.backwards[axis] { (shift - 1).wrapping_sub(at) } else { at.wrapping_add(shift) }
    }

    /// Where the frames `first` … `first + frames` begin in the view.
    pub fn beginning(&self, first: i64, frames: usize) -> i64 {
        if self.backwards[0] {
            // Places are their own inverse backwards.
            self.place(0, first.wrapping_add(frames as i64 - 1))
        } else {
            first.wrapping_sub(self.shift[0] as i64)
        }
    }

    /// All of `pattern`: [`Symmetry::IDENTITY`], then those that change most, each followed by what it makes of those before
    /// it, so that the first two and four are groups as well.
    pub fn all_of(pattern: &Pattern) -> Vec<Self> {
        let repeats = [pattern.period(), pattern.rows, pattern.cols];
        if repeats.iter().product::<usize>() > MAX_PLACES {
            return vec![Self::IDENTITY];
        }
        let [times, rows, cols] = repeats;
        let shifts = (0..times).flat_map(|t| (0..rows).flat_map(move |y| (0..cols).map(move |x| [t, y, x])));
        let mut found: Vec<Self> = (0..8)
            .flat_map(|bits| {
                let backwards = [1, 2, 4].map(|bit| bits & bit != 0);
                shifts.clone().map(move |shift| Self { backwards, shift })
            })
            .filter(|view| view.keeps(pattern))
            .collect();
        let change = |view: &Self| {
            let backwards = view.backwards.iter().filter(|&&axis| axis).count();
            let moved = (0..3).filter(|&axis| view.backwards[axis] || view.shift[axis] > 0).count();
            (moved, backwards)
        };
        found.sort_by_key(|view| std::cmp::Reverse(change(view)));
        let mut ordered = vec![Self::IDENTITY];
        for view in found {
            if !ordered.contains(&view) {
                let more = ordered.iter().map(|before| view.of(before, repeats));
                let more: Vec<Self> = more.filter(|view| !ordered.contains(view)).collect();
                ordered.extend(more);
            }
        }
        ordered
    }

    /// This view of `other`'s view of a pattern that `repeats`.
    fn of(&self, other: &Self, repeats: [usize; 3]) -> Self {
        let backwards = [0, 1, 2].map(|axis| self.backwards[axis] != other.backwards[axis]);
        let shift = [0, 1, 2].map(|axis| {
            let first = other.place(axis, self.place(axis, 0)) + i64::from(backwards[axis]);
            first.rem_euclid(repeats[axis] as i64) as usize
        });
        Self { backwards, shift }
    }

    fn keeps(&self, pattern: &Pattern) -> bool {
        let place = |axis: usize, at: usize, size: usize| {
            self.place(axis, at as i64).rem_euclid(size as i64) as usize
        };
        (0..pattern.rows).all(|y| {
            let row = place(1, y, pattern.rows);
            (0..pattern.cols).all(|x| {
                let cell = pattern.cell(row, place(2, x, pattern.cols));
                self.in_time(cell) == in_order(pattern.cell(y, x).clone())
            })
        })
    }

    /// What a cell looks like.
    fn in_time(&self, cell: &Cell) -> Cell {
        let period = cell.period as i64;
        let shutter = |shutter: &Shutter| {
            let Shutter { start, frames, ref open } = *shutter;
            let begin = self.beginning(start as i64, frames);
            let open = if self.backwards[0] {
                open.iter().rev().map(|frame| frames - 1 - frame).collect()
            } else {
                open.clone()
            };
            Shutter { start: begin.rem_euclid(period) as usize, frames, open }
        };
        in_order(Cell { period: cell.period, shutters: cell.shutters.iter().map(shutter).collect() })
    }
}

fn in_order(mut cell: Cell) -> Cell {
    cell.shutters.sort_by_key(|shutter| shutter.start);
    cell
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_shows_the_same_exposures_at_all_times() {
        for name in Pattern::NAMES {
            let pattern = Pattern::built_in(name).unwrap();
            let views = Symmetry::all_of(&pattern);
            assert_eq!(views[0], Symmetry::IDENTITY, "{name}");
            for view in views {
                for (t, y, x) in
                    (-9..20).flat_map(|t| (0..5).flat_map(move |y| (0..9).map(move |x| (t, y, x))))
                {
                    let [from, row, col] = [(0, t), (1, y), (2, x)].map(|(axis, at)| view.place(axis, at));
                    let place = |at: i64, size: usize| at.rem_euclid(size as i64) as usize;
                    let seen =
                        pattern.cell(place(row, pattern.rows), place(col, pattern.cols)).covering(from);
                    let here = pattern.cell(y as usize, x as usize).covering(t);
                    // The same frames are covered: those at its ends map to each other.
                    let ends = [here.start, here.end() - 1].map(|t| view.place(0, t));
                    let ends = [ends[0].min(ends[1]), ends[0].max(ends[1])];
                    assert_eq!(ends, [seen.start, seen.end() - 1], "{name}: {view:?} at {t}, {y}, {x}");
                    assert_eq!(here.shutter.exposure(), seen.shutter.exposure(), "{name}: {view:?}");
                }
            }
        }
    }

    #[test]
    fn mpve_looks_the_same_in_eight_views() {
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
    fn the_first_two_four_and_eight_views_of_mpve_are_groups() {
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let views = Symmetry::all_of(&pattern);
        // The second one is upside down, backwards in time and moved.
        assert_eq!(views[1].backwards, [true, true, false]);
        assert_ne!(views[1].shift[2], 0);
        for count in [2, 4, 8] {
            let group = &views[..count];
            for (one, other) in group.iter().flat_map(|one| group.iter().map(move |other| (one, other))) {
                assert!(group.contains(&one.of(other, [8, 2, 4])), "{one:?} of {other:?}");
            }
        }
    }
}

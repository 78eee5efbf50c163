//! Which inputs the results of an operation depend on, along one axis.

use std::ops::Range;

/// Where a result stands among the inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Result o stands where input o·n does.
    Down(usize),
    /// Input i stands where result i·n does.
    Up(usize),
    /// Results i·n … i·n + n − 1 lie in input i, each in channels of its own.
    Unfold(usize),
}

/// What a result depends on along one axis: the inputs at its place, and those that stand at most `before` in front of
/// it and `after` behind it, counted on the finer side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Relation {
    pub scale: Scale,
    pub before: usize,
    pub after: usize,
}

impl Relation {
    /// A result depends on the input of its own place alone.
    pub const SAME: Self = Self::near(0, 0);

    /// Inputs and results stand alike.
    pub const fn near(before: usize, after: usize) -> Self {
        Self { scale: Scale::Down(1), before, after }
    }

    /// Whether there are as many results as inputs.
    pub fn is_one_to_one(self) -> bool {
        let (Scale::Down(n) | Scale::Up(n) | Scale::Unfold(n)) = self.scale;
        n == 1
    }

    /// Whether the results from any one on can be computed like those from the first one on.
    pub fn begins_anywhere(self) -> bool {
        match self.scale {
            Scale::Down(_) => true,
            // Which taps a result is the sum over depends on its place.
            Scale::Up(n) => n == 1 && self.before == 0 && self.after == 0,
            Scale::Unfold(n) => n == 1,
        }
    }

    /// Inputs that `results`, at least one, depend on. They may lie outside of the tensor, in its padding.
    pub fn reads(self, results: Range<usize>) -> Range<isize> {
        let (first, last) = (results.start as isize, results.end as isize - 1);
        let (before, after) = (self.before as isize, self.after as isize);
        match self.scale {
            Scale::Down(n) => first * n as isize - before..last * n as isize + after + 1,
            Scale::Up(n) => {
                let behind = |place: isize| place.div_euclid(n as isize) + 1;
                behind(first - before - 1)..behind(last + after)
            }
            Scale::Unfold(n) => first / n as isize..last / n as isize + 1,
        }
    }

    /// Where the result at `result` begins in a view whose first input is `first`, on the finer side.
    pub fn origin(self, result: usize, first: usize) -> isize {
        match self.scale {
            Scale::Down(n) => (result * n) as isize - first as isize,
            Scale::Up(n) | Scale::Unfold(n) => result as isize - (first * n) as isize,
        }
    }

    /// The results of as many places in a row depend on the same inputs, or on the same taps of a kernel in turn.
    pub fn unit(self) -> usize {
        match self.scale {
            Scale::Down(_) => 1,
            Scale::Up(n) | Scale::Unfold(n) => n,
        }
    }

    /// Pixels of the measurement that a result spans whose inputs span `input`; 0 where it is finer than a pixel.
    pub fn span(self, input: usize) -> usize {
        match self.scale {
            Scale::Down(n) => input.saturating_mul(n),
            Scale::Up(n) | Scale::Unfold(n) => input / n.max(1),
        }
    }

    /// Pixels of the measurement, to either side of its own, that a result depends on, with inputs that span `input` of
    /// them. `None` where a result is finer than a pixel.
    pub fn reach(self, input: usize) -> Option<usize> {
        let Self { scale, before, after } = self;
        match scale {
            Scale::Down(n) => Some(before.max((after + 1).saturating_sub(n)) * input),
            // An input stands in place of the n results from its own on.
            Scale::Up(n) => input.is_multiple_of(n).then(|| before.max(after + n - 1) * (input / n)),
            Scale::Unfold(n) => input.is_multiple_of(n).then_some(0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each relation against the sums that it stands for.
    #[test]
    fn inputs_are_those_of_the_sums() {
        for (kernel, stride) in [(1, 1), (3, 1), (3, 2), (5, 3), (1, 4)] {
            let padding = (kernel - 1) / 2;
            let relation =
                Relation { scale: Scale::Down(stride), before: padding, after: kernel - 1 - padding };
            for result in 0..7usize {
                let inputs: Vec<isize> =
                    (0..kernel).map(|tap| (result * stride + tap) as isize - padding as isize).collect();
                assert_eq!(relation.reads(result..result + 1).collect::<Vec<_>>(), inputs);
            }
        }
        for (kernel, stride) in [(1usize, 1usize), (3, 1), (2, 2), (4, 2), (6, 2), (5, 3), (4, 4)] {
            let padding = (kernel - stride) / 2;
            let relation =
                Relation { scale: Scale::Up(stride), before: kernel - 1 - padding, after: padding };
            for first in 0..6usize {
                for end in first + 1..9 {
                    let sums = |i: isize| {
                        (0..kernel as isize).any(|tap| {
                            let result = i * stride as isize - padding as isize + tap;
                            (first as isize..end as isize).contains(&result)
                        })
                    };
                    let inputs: Vec<isize> = (-9..20).filter(|&i| sums(i)).collect();
                    assert_eq!(relation.reads(first..end).collect::<Vec<_>>(), inputs, "{kernel}, {stride}");
                }
            }
        }
        let unfold = Relation { scale: Scale::Unfold(3), ..Relation::SAME };
        assert_eq!((unfold.reads(3..9), unfold.reads(4..5)), (1..3, 1..2));
    }
}

//! From active cells to cuboids: few dense windows that hold all that has to be computed.
//!
//! A window costs more than its cells: the halo around them, and the frames before and behind. So one cuboid around two
//! neighbours is often cheaper than one for each. [`cover`] begins with a cuboid around all active cells, and cuts
//! cuboids in two, along whichever axis and wherever that saves most, as long as it saves anything.

use std::ops::Range;

use super::cells::Active;

/// Cells from … to along time, rows and columns.
pub type Cuboid = [Range<usize>; 3];

/// Cuboids that together hold all active cells; `cost` is what computing one of them costs.
pub fn cover(active: &Active, cost: &dyn Fn(&Cuboid) -> f64) -> Vec<Cuboid> {
    let mut finished = Vec::new();
    let mut open: Vec<Cuboid> = shrink(active, &active.extent().map(|n| 0..n)).into_iter().collect();
    while let Some(cuboid) = open.pop() {
        match best_cut(active, &cuboid, cost) {
            Some(halves) => open.extend(halves),
            None => finished.push(cuboid),
        }
    }
    finished
}

/// The two cuboids with all active cells of `whole` that cost least, if they cost less than `whole`.
fn best_cut(active: &Active, whole: &Cuboid, cost: &dyn Fn(&Cuboid) -> f64) -> Option<[Cuboid; 2]> {
    let mut least = cost(whole);
    let mut best = None;
    for axis in 0..3 {
        let slice = |i: usize| {
            let mut bounds = whole.clone();
            bounds[axis] = i..i + 1;
            shrink(active, &bounds)
        };
        let slices: Vec<_> = whole[axis].clone().map(slice).collect();
        let grow = |so_far: &mut Option<Cuboid>, slice: &Option<Cuboid>| {
            *so_far = join(so_far.take(), slice.clone());
            Some(so_far.clone())
        };
        // What is active before each cut, and behind it.
        let before = slices.iter().scan(None, grow);
        let mut behind: Vec<_> = slices.iter().rev().scan(None, grow).collect();
        behind.reverse();
        for halves in before.zip(behind.into_iter().skip(1)) {
            let (Some(front), Some(back)) = halves else { continue };
            let together = cost(&front) + cost(&back);
            if together < least {
                least = together;
                best = Some([front, back]);
            }
        }
    }
    best
}

/// The smallest cuboid around the active cells within `bounds`.
fn shrink(active: &Active, bounds: &Cuboid) -> Option<Cuboid> {
    let cols = active.extent()[2];
    let mut found: Option<Cuboid> = None;
    for s in bounds[0].clone() {
        let slab = active.slab(s);
        for r in bounds[1].clone() {
            let row = &slab[r * cols..][bounds[2].clone()];
            if let Some(first) = row.iter().position(|&active| active) {
                let last = row.iter().rposition(|&active| active).unwrap_or(first);
                let [first, last] = [first, last].map(|c| bounds[2].start + c);
                found = join(found, Some([s..s + 1, r..r + 1, first..last + 1]));
            }
        }
    }
    found
}

/// The smallest cuboid around two.
fn join(a: Option<Cuboid>, b: Option<Cuboid>) -> Option<Cuboid> {
    match (a, b) {
        (Some(a), Some(b)) => {
            Some(std::array::from_fn(|i| a[i].start.min(b[i].start)..a[i].end.max(b[i].end)))
        }
        (a, b) => a.or(b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cell costs 1, and so does each cell of a halo of one.
    fn cost(cuboid: &Cuboid) -> f64 {
        cuboid.iter().map(|range| range.len() + 2).product::<usize>() as f64
    }

    fn active(extent: [usize; 3], cells: &[[usize; 3]]) -> Active {
        let [_, rows, cols] = extent;
        Active::new(extent, |i| cells.contains(&[i / (rows * cols), i / cols % rows, i % cols]))
    }

    #[test]
    fn every_active_cell_is_in_a_cuboid() {
        for seed in 0..200u64 {
            let random = Active::new([3, 7, 9], |i| {
                let hash =
                    (i as u64 + 1).wrapping_mul(seed.wrapping_mul(2) + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
                hash >> 40 < (seed << 24) / 300
            });
            let cuboids = cover(&random, &cost);
            for s in 0..3 {
                for (i, _) in random.slab(s).iter().enumerate().filter(|(_, active)| **active) {
                    let cell = [s, i / 9, i % 9];
                    let holds = |cuboid: &Cuboid| (0..3).all(|axis| cuboid[axis].contains(&cell[axis]));
                    assert!(cuboids.iter().any(holds), "seed {seed}: {cell:?}");
                }
            }
        }
    }

    #[test]
    fn neighbours_share_a_cuboid_and_strangers_do_not() {
        let near = active([1, 20, 20], &[[0, 3, 3], [0, 3, 4], [0, 4, 3]]);
        assert_eq!(cover(&near, &cost), [[0..1, 3..5, 3..5]]);
        let far = active([1, 20, 20], &[[0, 0, 0], [0, 19, 19], [0, 0, 19]]);
        assert_eq!(cover(&far, &cost).len(), 3);
        assert!(cover(&active([1, 2, 2], &[]), &cost).is_empty());
    }
}

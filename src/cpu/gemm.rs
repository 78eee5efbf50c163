//! Products of gathered pixels with packed weights: the inner loop of every convolution.
//!
//! A block of sums stays in vector registers while products are added to it. Each sum runs over its products
//! in one fixed order, so it depends neither on the blocking nor on the number of threads.
//!
//! A library for matrix products packs both operands in each call, which does not pay for the 24 to 128
//! channels that nets have here (docs/performance.md).
// Code gets the instructions of the function that it is inlined into.
#![allow(clippy::inline_always)]

use std::hint::black_box;
use std::time::Instant;

use super::Real;
use super::simd::{Simd, SimdToken, Task, Vector};

/// A run of neighbouring values that is multiplied with as many rows of a panel.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// Where the run begins, behind a pixel's first value.
    pub offset: usize,
    /// Number of values.
    pub len: usize,
}

/// One product: sums[p][j] += Σ values[pixels[p] + segment] · panel[.][j] over all segments, in their order.
#[derive(Clone, Copy, Debug)]
pub struct Product<'a, R> {
    /// The values that are gathered from.
    pub values: &'a [R],
    /// Index of each pixel's first value. The number of pixels is a multiple of the panel's block.
    pub pixels: &'a [usize],
    /// Which values of a pixel take part.
    pub segments: &'a [Segment],
    /// Weights [Σ len][width].
    pub panel: &'a [R],
}

/// Shape of the blocks in registers: how many pixels by how many channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegisterBlock {
    /// Pixels.
    pub pixels: usize,
    /// Channels, as vectors: the width of a panel.
    pub vectors: usize,
    /// Channels of a vector.
    pub lanes: usize,
    /// Time for each pixel and product, in units of one that takes a vector: narrow blocks load more.
    pub cost: f64,
}

/// Something to do that is compiled for every shape of block.
pub trait RegisterBlockTask {
    /// Does it for blocks of `PIXELS` pixels by `VECTORS` vectors of channels.
    fn run<T: SimdToken, const PIXELS: usize, const VECTORS: usize>(self, token: T);
}

impl RegisterBlock {
    /// The blocks that there are.
    ///
    /// With 512 bits a block has up to 24 sums of 32 vectors, else up to 12 of 16; the others are for
    /// operands. More pixels in the narrow blocks would need more addresses than there are registers.
    pub fn all<R: Real>(simd: Simd) -> impl Iterator<Item = Self> {
        let (blocks, bytes): (&[_], _) = if simd.wide() {
            (&[(14, 1, 1.3), (12, 2, 2.0), (8, 3, 3.1)], 64)
        } else {
            (&[(8, 1, 1.3), (6, 2, 2.0)], 32)
        };
        let lanes = bytes / size_of::<R>();
        blocks.iter().map(move |&(pixels, vectors, cost)| Self { pixels, vectors, lanes, cost })
    }

    /// Channels of a panel.
    pub fn width(self) -> usize {
        self.vectors * self.lanes
    }

    /// Does `task` with this block.
    pub fn run(self, simd: Simd, task: impl RegisterBlockTask) {
        struct Blocked<T>(RegisterBlock, T);
        impl<K: RegisterBlockTask> Task for Blocked<K> {
            #[inline(always)]
            fn run<T: SimdToken>(self, token: T) {
                let Self(block, task) = self;
                match (T::WIDE, block.vectors) {
                    (true, 1) => task.run::<T, 14, 1>(token),
                    (true, 2) => task.run::<T, 12, 2>(token),
                    (true, _) => task.run::<T, 8, 3>(token),
                    (false, 1) => task.run::<T, 8, 1>(token),
                    (false, _) => task.run::<T, 6, 2>(token),
                }
            }
        }
        simd.run(Blocked(self, task));
    }
}

/// Adds a product to `sums` [pixels][width], or writes it there if it is the `first` one.
#[inline(always)]
pub fn multiply<R: Real, T: SimdToken, const PIXELS: usize, const VECTORS: usize>(
    token: T,
    product: &Product<'_, R>,
    first: bool,
    sums: &mut [R],
) {
    let lanes = R::Vector::<T>::LANES;
    let width = VECTORS * lanes;
    let pixels = product.pixels.as_chunks::<PIXELS>().0;
    for (pixels, sums) in pixels.iter().zip(sums.chunks_exact_mut(PIXELS * width)) {
        let mut block = [[R::Vector::<T>::splat(token, R::ZERO); VECTORS]; PIXELS];
        if !first {
            for (block, sums) in block.iter_mut().zip(sums.chunks_exact(width)) {
                for (sum, sums) in block.iter_mut().zip(sums.chunks_exact(lanes)) {
                    *sum = R::Vector::<T>::load(token, sums);
                }
            }
        }
        let mut rest = product.panel;
        for segment in product.segments {
            let (panel, behind) = rest.split_at(segment.len * width);
            rest = behind;
            // `from_fn`, unlike `map`, leaves the compiler one check of `k` for all of these.
            let values: [&[R]; PIXELS] =
                std::array::from_fn(|i| &product.values[pixels[i] + segment.offset..][..segment.len]);
            for (k, weights) in panel.chunks_exact(width).enumerate() {
                let weights: [R::Vector<T>; VECTORS] =
                    std::array::from_fn(|i| R::Vector::<T>::load(token, &weights[i * lanes..]));
                for (block, values) in block.iter_mut().zip(values) {
                    let value = R::Vector::<T>::splat(token, values[k]);
                    for (sum, &weight) in block.iter_mut().zip(&weights) {
                        *sum = sum.add_product(value, weight);
                    }
                }
            }
        }
        for (block, sums) in block.iter().zip(sums.chunks_exact_mut(width)) {
            for (sum, sums) in block.iter().zip(sums.chunks_exact_mut(lanes)) {
                sum.store(sums);
            }
        }
    }
}

/// Products and sums (two operations each) that one thread does in a second at most, with these instructions.
pub fn peak(simd: Simd) -> f64 {
    /// Steps of the loop that is measured, and products in each: enough to hide how long one takes.
    const STEPS: usize = 100_000;
    const SUMS: usize = 12;
    struct Probe;
    impl Task for Probe {
        #[inline(always)]
        fn run<T: SimdToken>(self, token: T) {
            let [a, b] = black_box([0.5, 1.0]).map(|value| T::F32::splat(token, value));
            let mut sums = [a; SUMS];
            for _ in 0..STEPS {
                sums = sums.map(|sum| sum.add_product(a, b));
            }
            let mut result = [0.0; 16];
            for sum in sums {
                sum.store(&mut result);
                black_box(&mut result);
            }
        }
    }
    let lanes = if simd.wide() { 16 } else { 8 };
    let seconds = (0..50).map(|_| {
        let begin = Instant::now();
        simd.run(Probe);
        begin.elapsed().as_secs_f64()
    });
    (2 * lanes * SUMS * STEPS) as f64 / seconds.fold(f64::INFINITY, f64::min)
}

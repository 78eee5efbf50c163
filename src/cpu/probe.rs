//! What the processor can do at most: operations and copied bytes per second, measured on all threads of the `rayon`
//! pool that this is called from.

use std::convert::Infallible;
use std::hint::black_box;
use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::simd::{Simd, SimdToken, Task, Vector};
use crate::system::Trials;

/// Trials are long above what starting threads costs, and so short that some go undisturbed where other programs run.
const TRIALS: Trials = Trials {
    long_enough: Duration::from_micros(500),
    careful: 5,
    least: 5,
    patience: Duration::from_millis(500),
};

/// Vectors of sums that are independent: enough to keep two units of a latency of four or five cycles busy, few enough
/// for 16 registers.
const ACCUMULATORS: usize = 12;

/// Numbers of the widest vectors at most.
const WIDEST: usize = 16;

/// Bytes that are copied at once: more than caches hold.
const COPIED_BYTES: usize = 128 << 20;

/// Operations per second at f32, two for each multiply-add, as a loop of nothing else reaches them with the widest
/// vectors that there are.
pub fn measure_flop_rate() -> f64 {
    let simd = Simd::widest();
    let mut flop_per_turn = 0;
    simd.run(Chains { turns: 0, flop: &mut flop_per_turn });
    // Every thread for itself, all at the same time: no trial waits for a thread that another program holds up.
    let rates = rayon::broadcast(|_| rate(|turns| simd.run(Chains { turns: turns as usize, flop: &mut 0 })));
    flop_per_turn as f64 * rates.iter().sum::<f64>()
}

/// Bytes per second that are copied from one place in memory to another, those read and those written together.
pub fn measure_copy_rate() -> f64 {
    // Written once, so that the pages are there.
    let input = vec![1_u64; COPIED_BYTES / size_of::<u64>()];
    let mut output = vec![2_u64; input.len()];
    let part = input.len().div_ceil(rayon::current_num_threads());
    let rate = rate(|times| {
        for _ in 0..times {
            let parts = output.par_chunks_mut(part).zip(input.par_chunks(part));
            parts.for_each(|(output, input)| output.copy_from_slice(input));
            black_box(&output);
        }
    });
    2.0 * COPIED_BYTES as f64 * rate
}

/// How often per second a piece of work is done at best. `work` does it so many times.
fn rate(mut work: impl FnMut(u32)) -> f64 {
    let timed = |times| {
        let begun = Instant::now();
        work(times);
        Ok::<_, Infallible>(begun.elapsed())
    };
    let Ok(rate) = TRIALS.rate(timed);
    rate
}

/// Chains of multiply-adds in registers: `turns` on each of the accumulators.
struct Chains<'a> {
    turns: usize,
    /// Receives the operations of one turn.
    flop: &'a mut usize,
}

impl Task for Chains<'_> {
    // Code gets the features of the processor from the function that it is inlined into.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn run<T: SimdToken>(self, token: T) {
        let splat = |value| T::F32::splat(token, value);
        let (x, y) = (splat(black_box(0.999)), splat(black_box(0.001)));
        let mut sums: [T::F32; ACCUMULATORS] = std::array::from_fn(|i| splat(i as f32));
        for _ in 0..self.turns {
            for sum in &mut sums {
                *sum = y.add_product(*sum, x);
            }
        }
        let mut lanes = [0.0; WIDEST];
        sums.into_iter().fold(y, |a, b| a + b).store(&mut lanes);
        black_box(lanes);
        *self.flop = 2 * ACCUMULATORS * T::F32::LANES;
    }
}

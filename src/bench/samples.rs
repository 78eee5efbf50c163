//! Repeated measurements of one time.

use std::time::{Duration, Instant};

use crate::Result;

/// Samples that are always taken, unless they take far too long.
const ENOUGH: usize = 3;
/// A measurement ends after this many times its patience, however few samples there are.
const IMPATIENCE: u32 = 5;
/// Samples that are never needed.
const MOST: usize = 100_000;

/// Times that were measured, sorted.
#[derive(Clone, Debug, Default)]
pub struct Samples(Vec<Duration>);

impl Samples {
    /// Sorts times.
    pub fn new(mut times: Vec<Duration>) -> Self {
        times.sort_unstable();
        Self(times)
    }

    /// Number of samples.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// The time that the share `p` of all samples stays within (nearest rank), in seconds; NaN without samples.
    pub fn quantile(&self, p: f64) -> f64 {
        let rank = (p * self.0.len() as f64).ceil().max(1.0) as usize;
        self.0.get(rank.min(self.0.len()).wrapping_sub(1)).map_or(f64::NAN, Duration::as_secs_f64)
    }

    /// The middle of all samples, in seconds.
    pub fn median(&self) -> f64 {
        self.quantile(0.5)
    }
}

/// Repeats a measurement for `patience`, after a warm-up of a quarter of that, which does not count unless one
/// measurement takes far longer than that.
pub fn repeat<T>(patience: Duration, mut measure: impl FnMut() -> Result<T>) -> Result<Vec<T>> {
    let begun = Instant::now();
    let first = measure()?;
    if begun.elapsed() >= IMPATIENCE * patience {
        return Ok(vec![first]);
    }
    while begun.elapsed() < patience / 4 {
        measure()?;
    }
    let begun = Instant::now();
    let mut taken = Vec::new();
    loop {
        taken.push(measure()?);
        let elapsed = begun.elapsed();
        let enough = taken.len() >= ENOUGH && elapsed >= patience;
        if enough || elapsed >= IMPATIENCE * patience || taken.len() == MOST {
            return Ok(taken);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measurements_are_repeated_but_not_forever() {
        let mut calls = 0;
        let mut count = || {
            calls += 1;
            Ok(calls)
        };
        // The first call is the warm-up.
        assert_eq!(repeat(Duration::from_nanos(1), &mut count).unwrap().len(), 1);
        let many = repeat(Duration::from_millis(20), &mut count).unwrap();
        assert!(many.len() >= ENOUGH && many.windows(2).all(|pair| pair[0] + 1 == pair[1]));
        assert!(repeat(Duration::from_millis(20), || Err::<(), _>(crate::Error::Stopped)).is_err());
    }

    #[test]
    fn quantiles_are_samples() {
        let samples = Samples::new([4, 1, 3, 2].map(Duration::from_secs).to_vec());
        assert_eq!([0.0, 0.25, 0.5, 0.95, 1.0].map(|p| samples.quantile(p)), [1.0, 1.0, 2.0, 4.0, 4.0]);
        assert!(Samples::default().median().is_nan());
        let many = Samples::new((1..=100).map(Duration::from_secs).collect());
        assert_eq!((many.median(), many.quantile(0.95)), (50.0, 95.0));
    }
}

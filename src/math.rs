//! Small mathematics that several modules share.

/// µ of the tone curve (design §2).
pub const MU: f64 = 5000.0;

/// Least common multiple of two positive numbers.
pub fn lcm(a: usize, b: usize) -> usize {
    let (mut x, mut y) = (a, b);
    while y != 0 {
        (x, y) = (y, x % y);
    }
    a / x * b
}

/// At most `most` of the indices 0 … `len` − 1, spread evenly from the first one on.
pub fn spread(len: usize, most: usize) -> impl ExactSizeIterator<Item = usize> {
    let count = len.min(most);
    (0..count).map(move |i| i * len / count)
}

/// The tone curve l(p) = ln(1 + µp)/ln(1 + µ), on p ≥ 0.
pub fn tone(p: f64) -> f64 {
    (MU * p).ln_1p() / MU.ln_1p()
}

//! Small mathematics that several modules share.

/// µ of the tone curve (design §2).
pub const MU: f64 = 5000.0;

/// A hash that is the same for every build: FNV-1a, 64 bits.
pub fn fnv_1a(bytes: impl IntoIterator<Item = u8>) -> u64 {
    let step = |hash: u64, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    bytes.into_iter().fold(0xcbf2_9ce4_8422_2325, step)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_fnv_1a() {
        let hash = |text: &str| fnv_1a(text.bytes());
        assert_eq!(hash(""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(hash("a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(hash("foobar"), 0x8594_4171_f739_67e8);
    }
}

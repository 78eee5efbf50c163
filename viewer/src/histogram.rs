//! How often which irradiance occurs, on a logarithmic scale.

/// Bins, from 2⁻¹⁶ to 2¹ of p = 1: eight a stop.
pub const BINS: usize = 17 * 8;
/// Exponent of the first bin's lower end.
pub const FIRST: f32 = -16.0;

/// Counts of a plane's values. What is darker than the first bin is counted in it, what is brighter in the last.
pub fn histogram(plane: &[f32]) -> [u32; BINS] {
    let mut counts = [0; BINS];
    // A hundred thousand pixels say as much as all of them.
    let stride = plane.len().div_ceil(100_000).max(1);
    for p in plane.iter().step_by(stride) {
        counts[bin(*p)] += 1;
    }
    counts
}

/// The bin of irradiance `p`.
fn bin(p: f32) -> usize {
    let stops = p.max(f32::MIN_POSITIVE).log2() - FIRST;
    ((8.0 * stops).max(0.0) as usize).min(BINS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_has_a_bin() {
        let counts = histogram(&[0.0, -1.0, f32::NAN, 1.0, 1.01, 0.5, 1e9, f32::INFINITY]);
        assert_eq!(counts.iter().sum::<u32>(), 8);
        assert_eq!((counts[0], counts[BINS - 1]), (3, 2));
        // 2⁰ is the beginning of bin 128, half of it a stop before.
        assert_eq!((counts[128], counts[120]), (2, 1));
    }
}

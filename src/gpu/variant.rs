//! How a convolution is divided among invocations.

use serde::{Deserialize, Serialize};

/// What a team of invocations of a convolution computes, and how it loads.
///
/// Results do not depend on it: every sum is added in the same order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Variant {
    /// Pixels of each invocation.
    pub pixels: usize,
    /// Vectors of four output channels of each invocation.
    pub vectors: usize,
    /// Invocations of a team: 1, or the subgroup's size. Each one loads a part of the weights and broadcasts it.
    pub lanes: usize,
    /// Whether 64 bits are loaded at once, which software does as fast as 32 bits.
    pub wide: bool,
}

/// Size of a convolution.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    /// Frames, times phases of a transposed convolution.
    pub frames: usize,
    /// Pixels of a frame.
    pub frame: usize,
    /// Vectors of four output channels.
    pub vectors: usize,
}

/// What an adapter can do.
#[derive(Clone, Copy, Debug)]
pub(super) struct Abilities {
    /// Whether it computes on the CPU.
    pub software: bool,
    /// Invocations that run in step and can broadcast, 1 if that varies or is missing.
    pub subgroup: usize,
    /// Whether shaders know 64-bit integers.
    pub int64: bool,
    /// Workgroups along one dimension of a dispatch.
    pub max_workgroups: u32,
}

impl Variant {
    /// Vectors of sums that an invocation may hold: above, compiling takes minutes.
    pub(super) const MAX_SUMS: usize = 64;

    /// Pixels and vectors of blocks on a GPU, largest first: larger ones load less per operation, smaller ones keep
    /// more of the GPU busy.
    const BLOCKS: [[usize; 2]; 4] = [[8, 2], [4, 2], [4, 1], [2, 1]];

    /// A good variant by load and register counts, without measuring.
    pub(super) fn choose(extent: Extent, abilities: Abilities) -> Self {
        /// Invocations that keep a GPU busy.
        const ENOUGH: usize = 8192;
        if abilities.software {
            return Self::choose_for_software(extent, abilities);
        }
        let fitted =
            Self::BLOCKS.map(|[pixels, vectors]| Self { pixels, vectors, lanes: 1, wide: false }.fit(extent));
        let large_enough = fitted.into_iter().find(|variant| variant.teams(extent) >= ENOUGH);
        large_enough.unwrap_or(fitted[fitted.len() - 1])
    }

    /// Software loads ten times slower than it multiplies, and compiles large blocks for seconds: measured sums of an
    /// invocation, and teams that keep several threads equally busy.
    fn choose_for_software(extent: Extent, abilities: Abilities) -> Self {
        const SUMS: usize = 32;
        const MAX_VECTORS: usize = 8;
        const ENOUGH: usize = 128;
        let Abilities { subgroup: lanes, int64: wide, .. } = abilities;
        let groups = extent.vectors.div_ceil(MAX_VECTORS);
        let vectors = extent.vectors.div_ceil(groups);
        let mut variant = Self { pixels: (SUMS / vectors).min(16), vectors, lanes, wide };
        while variant.pixels > 1 && variant.teams(extent) < ENOUGH {
            variant.pixels /= 2;
        }
        variant.fit(extent)
    }

    /// Variants that are worth measuring; the first one is the choice without measuring.
    pub(super) fn candidates(extent: Extent, abilities: Abilities) -> Vec<Self> {
        let chosen = Self::choose(extent, abilities);
        let lanes = abilities.subgroup;
        let Self { pixels, vectors, .. } = chosen;
        let others: Vec<Self> = if abilities.software {
            let half = vectors.div_ceil(2);
            let blocks = [[2 * pixels, half], [pixels.div_ceil(2), vectors]];
            blocks.map(|[pixels, vectors]| Self { pixels, vectors, ..chosen }).to_vec()
        } else {
            // A team shares weights, so more vectors pay there.
            let teams = [[8, 4], [4, 8]].into_iter().chain(Self::BLOCKS).map(|block| (block, lanes));
            let alone = Self::BLOCKS.map(|block| (block, 1));
            let blocks = alone.into_iter().chain(teams.filter(|_| lanes > 1));
            blocks.map(|([pixels, vectors], lanes)| Self { pixels, vectors, lanes, wide: false }).collect()
        };
        let mut candidates = vec![chosen];
        for variant in others.into_iter().map(|variant| variant.fit(extent)) {
            if !candidates.contains(&variant) {
                candidates.push(variant);
            }
        }
        candidates
    }

    /// Balanced, so that the last block of a frame and the last group of channels are nearly full.
    pub(super) fn fit(self, extent: Extent) -> Self {
        let groups = self.groups(extent);
        let vectors = extent.vectors.div_ceil(groups);
        let pixels = extent.frame.div_ceil(self.lanes * self.blocks(extent));
        Self { pixels, vectors, ..self }
    }

    /// Parts that the output channels are divided into.
    pub(super) fn groups(self, extent: Extent) -> usize {
        extent.vectors.div_ceil(self.vectors)
    }

    /// Parts that a frame is divided into.
    pub(super) fn blocks(self, extent: Extent) -> usize {
        extent.frame.div_ceil(self.lanes * self.pixels)
    }

    /// Teams that compute a layer.
    pub(super) fn teams(self, extent: Extent) -> usize {
        extent.frames * self.blocks(extent) * self.groups(extent)
    }

    /// Vectors of weights that an invocation loads for four input channels.
    pub(super) fn loads(self) -> usize {
        (4 * self.vectors).div_ceil(self.lanes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOFTWARE: Abilities = Abilities { software: true, subgroup: 8, int64: true, max_workgroups: 65535 };
    const HARDWARE: Abilities = Abilities { software: false, subgroup: 32, ..SOFTWARE };

    #[test]
    fn blocks_cover_all_pixels_and_channels() {
        for vectors in [1, 2, 3, 6, 8, 9, 12, 24, 32] {
            for frame in [1, 7, 64, 2048, 2049, 1_000_003] {
                for frames in [1, 8] {
                    let extent = Extent { frames, frame, vectors };
                    for abilities in [SOFTWARE, HARDWARE] {
                        let variant = Variant::choose(extent, abilities);
                        assert!(variant.vectors * variant.groups(extent) >= vectors);
                        assert!(variant.pixels * variant.lanes * variant.blocks(extent) >= frame);
                        assert!(variant.pixels * variant.vectors <= 32, "{variant:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn candidates_differ_and_begin_with_the_choice() {
        let extent = Extent { frames: 8, frame: 2048, vectors: 8 };
        for abilities in [SOFTWARE, HARDWARE, Abilities { subgroup: 1, ..HARDWARE }] {
            let candidates = Variant::candidates(extent, abilities);
            assert_eq!(candidates[0], Variant::choose(extent, abilities));
            assert!(candidates.len() > 2);
            for (index, candidate) in candidates.iter().enumerate() {
                assert!(!candidates[..index].contains(candidate));
                assert!(candidate.lanes == 1 || candidate.lanes == abilities.subgroup);
            }
        }
    }

    #[test]
    fn small_layers_get_small_blocks() {
        let of = |frames| Extent { frames, frame: 2048, vectors: 8 };
        assert!(Variant::choose(of(1), SOFTWARE).pixels < Variant::choose(of(16), SOFTWARE).pixels);
        assert!(Variant::choose(of(1), HARDWARE).pixels < Variant::choose(of(64), HARDWARE).pixels);
    }
}

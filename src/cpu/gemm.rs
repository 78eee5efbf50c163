//! Products of gathered pixels with packed weights: the inner loop of every convolution.
//!
//! The code is plain arrays, sized so that the compiler keeps one tile of sums in vector registers. Each sum
//! runs over its products in one fixed order, so it depends neither on the tiling nor on the number of
//! threads.
//!
//! A library for matrix products packs both operands in each call, which does not pay for the 32 to 128
//! channels that nets have here: on one core with 91 GFLOP/s at most, `matrixmultiply` reached 50 to 69
//! GFLOP/s on ready-made matrices of these sizes; this reaches 75 to 85 GFLOP/s in whole layers (`pix2hdr bench
//! --executor cpu --per-layer`).
//!
//! This is the one module with `unsafe` code, one call: [`Gemm::multiply`] is compiled a second time for CPUs
//! with AVX2 and FMA, and calling that version is undefined on a CPU without them. The line above the call
//! checks that the CPU has them. The versions themselves are safe code.
#![allow(unsafe_code)]
// Code gets the CPU features of the function that it is inlined into.
#![allow(clippy::inline_always)]

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
    /// Index of each pixel's first value. The number of pixels is a multiple of the panel's tile.
    pub pixels: &'a [usize],
    /// Which values of a pixel take part.
    pub segments: &'a [Segment],
    /// Weights [Σ len][width].
    pub panel: &'a [R],
}

/// Shape of the tiles in registers: how many pixels by how many channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Pixels.
    pub pixels: usize,
    /// Channels: the width of a panel.
    pub width: usize,
}

/// A number that can be multiplied in tiles.
pub trait Gemm: Sized {
    /// The tile that suits a layer of `channels` output channels.
    fn tile(channels: usize) -> Tile;

    /// Adds a product to `sums` [pixels][width].
    fn multiply(product: &Product<'_, Self>, tile: Tile, sums: &mut [Self]);
}

/// Implements [`Gemm`]. `$wide` numbers are two 256-bit vectors: a tile of 12 of them leaves registers for
/// the operands. `$narrow` numbers are one vector; more than 8 pixels would need more addresses than there
/// are registers.
macro_rules! implement_gemm {
    ($real:ident, $wide:literal, $narrow:literal) => {
        impl Gemm for $real {
            fn tile(channels: usize) -> Tile {
                if channels > $narrow {
                    Tile { pixels: 6, width: $wide }
                } else {
                    Tile { pixels: 8, width: $narrow }
                }
            }

            fn multiply(product: &Product<'_, Self>, tile: Tile, sums: &mut [Self]) {
                #[inline(always)]
                fn generic<const FUSED: bool>(product: &Product<'_, $real>, tile: Tile, sums: &mut [$real]) {
                    let add = |sum: $real, a: $real, b: $real| {
                        if FUSED { a.mul_add(b, sum) } else { sum + a * b }
                    };
                    if tile.width == $wide {
                        multiply_tiles::<$real, 6, $wide>(product, sums, add);
                    } else {
                        multiply_tiles::<$real, 8, $narrow>(product, sums, add);
                    }
                }

                #[cfg(target_arch = "x86_64")]
                {
                    #[target_feature(enable = "avx2,fma")]
                    fn fused(product: &Product<'_, $real>, tile: Tile, sums: &mut [$real]) {
                        generic::<true>(product, tile, sums);
                    }
                    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                        // SAFETY: the CPU has both features that the function is compiled for.
                        return unsafe { fused(product, tile, sums) };
                    }
                }
                // Where a fused operation is not part of the target, it would be a slow library call.
                generic::<{ cfg!(target_arch = "aarch64") }>(product, tile, sums);
            }
        }
    };
}

implement_gemm!(f32, 16, 8);
implement_gemm!(f64, 8, 4);

/// All tiles of a product.
#[inline(always)]
fn multiply_tiles<R: Copy, const PIXELS: usize, const WIDTH: usize>(
    product: &Product<'_, R>,
    sums: &mut [R],
    add: impl Fn(R, R, R) -> R,
) {
    let panel = product.panel.as_chunks::<WIDTH>().0;
    let pixels = product.pixels.as_chunks::<PIXELS>().0;
    let sums = sums.as_chunks_mut::<WIDTH>().0.as_chunks_mut::<PIXELS>().0;
    for (pixels, sums) in pixels.iter().zip(sums) {
        let mut tile = *sums;
        let mut rest = panel;
        for segment in product.segments {
            let (weights, behind) = rest.split_at(segment.len);
            rest = behind;
            // `from_fn`, unlike `map`, leaves the compiler one check of `k` for all of these.
            let values: [&[R]; PIXELS] =
                std::array::from_fn(|i| &product.values[pixels[i] + segment.offset..][..weights.len()]);
            for (k, weights) in weights.iter().enumerate() {
                for (tile, values) in tile.iter_mut().zip(values) {
                    let value = values[k];
                    for (sum, &weight) in tile.iter_mut().zip(weights) {
                        *sum = add(*sum, value, weight);
                    }
                }
            }
        }
        *sums = tile;
    }
}

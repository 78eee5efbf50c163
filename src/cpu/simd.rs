//! Vectors of numbers, and code that is compiled several times, for the vector instructions of different
//! processors.
//!
//! This is the one module with `unsafe` code: to use instructions that the processor lacks is undefined. So
//! all of them need a [`SimdToken`], or a vector that was made with one, and there is none but inside of
//! [`Simd::run`], whose [`Simd`] was found to be [available](Simd::available). Loops that use no vectors
//! explicitly gain too, where the compiler finds vectors in them.
//!
//! Arrays that the compiler is to find vectors in make good products too (95% of the processor's peak), but
//! small changes around them made it fail to see the vectors of 512 bits: then they take thirty times longer.
#![allow(unsafe_code)]
// Code gets the instructions of the function that it is inlined into.
#![allow(clippy::inline_always)]

use std::ops::{Add, Mul};
use std::sync::OnceLock;

/// Vector instructions that this processor has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Simd(Instructions);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Instructions {
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

/// Proof that code runs on a processor with certain instructions.
pub trait SimdToken: Copy {
    /// A vector of `f32`.
    type F32: Vector<f32, Self>;
    /// A vector of `f64`.
    type F64: Vector<f64, Self>;
    /// Whether there are 32 vectors of 512 bits, instead of 16 vectors of 256 bits.
    const WIDE: bool;
}

/// Neighbouring numbers.
pub trait Vector<R, T>: Copy + Add<Output = Self> + Mul<Output = Self> {
    /// How many.
    const LANES: usize;

    /// The same number everywhere.
    fn splat(token: T, value: R) -> Self;

    /// The first [`LANES`](Self::LANES) of these numbers.
    fn load(token: T, values: &[R]) -> Self;

    /// Writes all numbers to the first places.
    fn store(self, values: &mut [R]);

    /// self + a·b, with one rounding where the processor can do that.
    #[must_use]
    fn add_product(self, a: Self, b: Self) -> Self;

    /// These numbers, but those of `other` where they are negative.
    #[must_use]
    fn unless_negative(self, other: Self) -> Self;

    /// `f` of each number.
    #[must_use]
    fn map(self, f: impl Fn(R) -> R) -> Self;
}

/// Something to do with vectors.
pub trait Task {
    /// Does it. This function and what its loops call have to be `#[inline(always)]`.
    fn run<T: SimdToken>(self, token: T);
}

impl Simd {
    /// All that this processor has, the widest last.
    pub fn available() -> Vec<Self> {
        let mut all = vec![Self(Instructions::Baseline)];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                all.push(Self(Instructions::Avx2));
            }
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
            {
                all.push(Self(Instructions::Avx512));
            }
        }
        all
    }

    /// The widest that this processor has.
    pub fn widest() -> Self {
        static WIDEST: OnceLock<Simd> = OnceLock::new();
        *WIDEST.get_or_init(|| Self::available().pop().expect("there is a baseline"))
    }

    /// Whether there are 32 vectors of 512 bits, instead of 16 vectors of 256 bits.
    pub fn wide(self) -> bool {
        match self.0 {
            Instructions::Baseline => baseline::Baseline::WIDE,
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => x86::Avx2::WIDE,
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512 => x86::Avx512::WIDE,
        }
    }

    /// Name of the instructions.
    pub fn name(self) -> &'static str {
        match self.0 {
            Instructions::Baseline => "baseline",
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => "AVX2",
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512 => "AVX-512",
        }
    }

    /// Does `task` with these instructions.
    pub fn run(self, task: impl Task) {
        match self.0 {
            Instructions::Baseline => task.run(baseline::Baseline::new()),
            // SAFETY: `available` has found the features that `run_avx2` is compiled for.
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => unsafe { x86::run_avx2(task) },
            // SAFETY: `available` has found the features that `run_avx512` is compiled for.
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512 => unsafe { x86::run_avx512(task) },
        }
    }
}

/// What every processor of the architecture has.
mod baseline {
    use std::array::from_fn;
    use std::ops::{Add, Mul};

    use super::{SimdToken, Vector};

    #[derive(Clone, Copy)]
    pub struct Baseline(());

    impl Baseline {
        pub fn new() -> Self {
            Self(())
        }
    }

    impl SimdToken for Baseline {
        type F32 = Array<f32, 8>;
        type F64 = Array<f64, 4>;
        const WIDE: bool = false;
    }

    /// Numbers in which the compiler finds the vectors that there are.
    #[derive(Clone, Copy)]
    pub struct Array<R, const LANES: usize>([R; LANES]);

    impl<R: Copy + Add<Output = R>, const LANES: usize> Add for Array<R, LANES> {
        type Output = Self;

        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(from_fn(|i| self.0[i] + other.0[i]))
        }
    }

    impl<R: Copy + Mul<Output = R>, const LANES: usize> Mul for Array<R, LANES> {
        type Output = Self;

        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            Self(from_fn(|i| self.0[i] * other.0[i]))
        }
    }

    macro_rules! implement_vector {
        ($real:ident) => {
            impl<const LANES: usize> Vector<$real, Baseline> for Array<$real, LANES> {
                const LANES: usize = LANES;

                #[inline(always)]
                fn splat(_: Baseline, value: $real) -> Self {
                    Self([value; LANES])
                }

                #[inline(always)]
                fn load(_: Baseline, values: &[$real]) -> Self {
                    Self(from_fn(|i| values[i]))
                }

                #[inline(always)]
                fn store(self, values: &mut [$real]) {
                    values[..LANES].copy_from_slice(&self.0);
                }

                #[inline(always)]
                fn add_product(self, a: Self, b: Self) -> Self {
                    Self(from_fn(|i| {
                        let (sum, a, b) = (self.0[i], a.0[i], b.0[i]);
                        // Where a fused operation is not part of the architecture, it is a slow call.
                        if cfg!(target_arch = "aarch64") { a.mul_add(b, sum) } else { sum + a * b }
                    }))
                }

                #[inline(always)]
                fn unless_negative(self, other: Self) -> Self {
                    Self(from_fn(|i| if self.0[i] < 0.0 { other.0[i] } else { self.0[i] }))
                }

                #[inline(always)]
                fn map(self, f: impl Fn($real) -> $real) -> Self {
                    Self(self.0.map(f))
                }
            }
        };
    }

    implement_vector!(f32);
    implement_vector!(f64);
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m256, __m256d, __m512, __m512d, _mm256_add_pd, _mm256_add_ps, _mm256_blendv_pd, _mm256_blendv_ps,
        _mm256_fmadd_pd, _mm256_fmadd_ps, _mm256_loadu_pd, _mm256_loadu_ps, _mm256_mul_pd, _mm256_mul_ps,
        _mm256_set1_pd, _mm256_set1_ps, _mm256_storeu_pd, _mm256_storeu_ps, _mm512_add_pd, _mm512_add_ps,
        _mm512_castpd_si512, _mm512_castps_si512, _mm512_fmadd_pd, _mm512_fmadd_ps, _mm512_loadu_pd,
        _mm512_loadu_ps, _mm512_mask_blend_pd, _mm512_mask_blend_ps, _mm512_movepi32_mask,
        _mm512_movepi64_mask, _mm512_mul_pd, _mm512_mul_ps, _mm512_set1_pd, _mm512_set1_ps, _mm512_storeu_pd,
        _mm512_storeu_ps,
    };
    use std::ops::{Add, Mul};

    use super::{SimdToken, Task, Vector};

    /// Made by [`run_avx2`] only, as are vectors with it.
    #[derive(Clone, Copy)]
    pub struct Avx2(());

    /// Made by [`run_avx512`] only, as are vectors with it.
    #[derive(Clone, Copy)]
    pub struct Avx512(());

    #[target_feature(enable = "avx2,fma")]
    pub fn run_avx2(task: impl Task) {
        task.run(Avx2(()));
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
    pub fn run_avx512(task: impl Task) {
        task.run(Avx512(()));
    }

    impl SimdToken for Avx2 {
        type F32 = F32x8;
        type F64 = F64x4;
        const WIDE: bool = false;
    }

    impl SimdToken for Avx512 {
        type F32 = F32x16;
        type F64 = F64x8;
        const WIDE: bool = true;
    }

    // `other` where the sign of `value` is set: a zero with a sign makes no difference.

    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn select_ps_256(value: __m256, other: __m256) -> __m256 {
        _mm256_blendv_ps(value, other, value)
    }

    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn select_pd_256(value: __m256d, other: __m256d) -> __m256d {
        _mm256_blendv_pd(value, other, value)
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
    fn select_ps_512(value: __m512, other: __m512) -> __m512 {
        _mm512_mask_blend_ps(_mm512_movepi32_mask(_mm512_castps_si512(value)), value, other)
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
    fn select_pd_512(value: __m512d, other: __m512d) -> __m512d {
        _mm512_mask_blend_pd(_mm512_movepi64_mask(_mm512_castpd_si512(value)), value, other)
    }

    macro_rules! implement_vector {
        ($token:ident: $vector:ident($register:ident) of $lanes:literal $real:ident,
         $splat:ident, $load:ident, $store:ident, $add:ident, $mul:ident, $add_product:ident,
         $unless_negative:ident) => {
            #[derive(Clone, Copy)]
            pub struct $vector($register);

            // SAFETY: the instructions are there, as `$token` and each vector prove, and the slices are long
            // enough.
            impl Vector<$real, $token> for $vector {
                const LANES: usize = $lanes;

                #[inline(always)]
                fn splat(_: $token, value: $real) -> Self {
                    Self(unsafe { $splat(value) })
                }

                #[inline(always)]
                fn load(_: $token, values: &[$real]) -> Self {
                    let values = &values[..$lanes];
                    Self(unsafe { $load(values.as_ptr()) })
                }

                #[inline(always)]
                fn store(self, values: &mut [$real]) {
                    let values = &mut values[..$lanes];
                    unsafe { $store(values.as_mut_ptr(), self.0) }
                }

                #[inline(always)]
                fn add_product(self, a: Self, b: Self) -> Self {
                    Self(unsafe { $add_product(a.0, b.0, self.0) })
                }

                #[inline(always)]
                fn unless_negative(self, other: Self) -> Self {
                    Self(unsafe { $unless_negative(self.0, other.0) })
                }

                #[inline(always)]
                fn map(self, f: impl Fn($real) -> $real) -> Self {
                    let mut values = [0.0; $lanes];
                    self.store(&mut values);
                    let values = values.map(f);
                    Self(unsafe { $load(values.as_ptr()) })
                }
            }

            impl Add for $vector {
                type Output = Self;

                #[inline(always)]
                fn add(self, other: Self) -> Self {
                    // SAFETY: as above.
                    Self(unsafe { $add(self.0, other.0) })
                }
            }

            impl Mul for $vector {
                type Output = Self;

                #[inline(always)]
                fn mul(self, other: Self) -> Self {
                    // SAFETY: as above.
                    Self(unsafe { $mul(self.0, other.0) })
                }
            }
        };
    }

    implement_vector!(
        Avx2: F32x8(__m256) of 8 f32,
        _mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps, _mm256_add_ps, _mm256_mul_ps, _mm256_fmadd_ps,
        select_ps_256
    );
    implement_vector!(
        Avx2: F64x4(__m256d) of 4 f64,
        _mm256_set1_pd, _mm256_loadu_pd, _mm256_storeu_pd, _mm256_add_pd, _mm256_mul_pd, _mm256_fmadd_pd,
        select_pd_256
    );
    implement_vector!(
        Avx512: F32x16(__m512) of 16 f32,
        _mm512_set1_ps, _mm512_loadu_ps, _mm512_storeu_ps, _mm512_add_ps, _mm512_mul_ps, _mm512_fmadd_ps,
        select_ps_512
    );
    implement_vector!(
        Avx512: F64x8(__m512d) of 8 f64,
        _mm512_set1_pd, _mm512_loadu_pd, _mm512_storeu_pd, _mm512_add_pd, _mm512_mul_pd, _mm512_fmadd_pd,
        select_pd_512
    );
}

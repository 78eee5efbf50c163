//! The numbers that kernels are generic over.
// Code gets the instructions of the function that it is inlined into.
#![allow(clippy::inline_always)]

use std::fmt::Debug;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

use super::elementary;
use super::simd::{SimdToken, Vector};

/// A floating-point type that every kernel runs on: `f32`, the fallback, or `f64`, the oracle.
pub trait Real:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + Sum
    + 'static
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// Neighbouring numbers in a register.
    type Vector<T: SimdToken>: Vector<Self, T>;
    /// "f32" or "f64".
    const NAME: &'static str;

    /// The nearest value to an `f64`.
    fn from_f64(value: f64) -> Self;
    /// Exactly the value of an `f32`.
    fn from_f32(value: f32) -> Self;
    /// The nearest `f32`.
    fn to_f32(self) -> f32;
    /// Exactly this value.
    fn to_f64(self) -> f64;
    /// The whole part as an index, up to 2³² − 1; 0 for negative values and NaN.
    fn to_index(self) -> usize;
    /// |v|.
    #[must_use]
    fn abs(self) -> Self;
    /// eᵛ.
    #[must_use]
    fn exp(self) -> Self;
    /// eᵛ − 1 for |v| ≤ 87.
    #[must_use]
    fn exp_m1(self) -> Self;
    /// ln(1 + v) for finite v ≥ 0.
    #[must_use]
    fn ln_1p(self) -> Self;
    /// log2 v.
    #[must_use]
    fn log2(self) -> Self;

    /// The larger of two numbers; `other` if this one is NaN.
    #[must_use]
    #[inline(always)]
    fn at_least(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    /// The smaller of two numbers; `other` if this one is NaN.
    #[must_use]
    #[inline(always)]
    fn at_most(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
}

macro_rules! implement_real {
    ($real:ident, $vector:ident, $exp_m1:path, $ln_1p:path) => {
        impl Real for $real {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            type Vector<T: SimdToken> = T::$vector;
            const NAME: &'static str = stringify!($real);

            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as Self
            }
            #[inline(always)]
            fn from_f32(value: f32) -> Self {
                value as Self
            }
            #[inline(always)]
            fn to_f32(self) -> f32 {
                self as f32
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn to_index(self) -> usize {
                self as u32 as usize
            }
            #[inline(always)]
            fn abs(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn exp(self) -> Self {
                self.exp()
            }
            #[inline(always)]
            fn exp_m1(self) -> Self {
                $exp_m1(self)
            }
            #[inline(always)]
            fn ln_1p(self) -> Self {
                $ln_1p(self)
            }
            fn log2(self) -> Self {
                self.log2()
            }
        }
    };
}

implement_real!(f32, F32, elementary::exp_m1, elementary::ln_1p);
implement_real!(f64, F64, f64::exp_m1, f64::ln_1p);

//! Counts of a sensor.

use std::ops::Range;

use super::pixels::reserve;
use crate::Result;

/// Integer pixel values of a capture, in the sensor's own counts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Counts {
    /// Up to 8 bits.
    U8(Vec<u8>),
    /// Up to 16 bits.
    U16(Vec<u16>),
}

impl Counts {
    /// None yet, of 8 or 16 `bits`, with room for `len` of them.
    pub fn with_capacity(bits: u32, len: usize) -> Result<Self> {
        Ok(if bits == 8 { Self::U8(reserve(len)?) } else { Self::U16(reserve(len)?) })
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) => values.len(),
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bits of a value's type: 8 or 16.
    pub fn bits(&self) -> u32 {
        match self {
            Self::U8(_) => 8,
            Self::U16(_) => 16,
        }
    }

    /// The value at place `i`.
    pub fn value(&self, i: usize) -> u16 {
        match self {
            Self::U8(values) => u16::from(values[i]),
            Self::U16(values) => values[i],
        }
    }

    /// The values at places `range`.
    #[must_use]
    pub fn range(&self, range: Range<usize>) -> Self {
        match self {
            Self::U8(values) => Self::U8(values[range].to_vec()),
            Self::U16(values) => Self::U16(values[range].to_vec()),
        }
    }

    /// The values at `places`, in their order.
    #[must_use]
    pub fn gather(&self, places: impl Iterator<Item = usize>) -> Self {
        match self {
            Self::U8(values) => Self::U8(places.map(|i| values[i]).collect()),
            Self::U16(values) => Self::U16(places.map(|i| values[i]).collect()),
        }
    }

    /// These values and `others` behind them, which must be of the same kind.
    #[must_use]
    pub fn followed_by(mut self, others: Self) -> Self {
        match (&mut self, others) {
            (Self::U8(values), Self::U8(others)) => values.extend(others),
            (Self::U16(values), Self::U16(others)) => values.extend(others),
            _ => unreachable!("counts of two kinds"),
        }
        self
    }
}

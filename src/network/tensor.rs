//! Shapes and dense tensors, channels last.

use std::fmt;

/// Extents of a tensor: frames, rows, columns, channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shape {
    /// Frames.
    pub t: usize,
    /// Rows.
    pub y: usize,
    /// Columns.
    pub x: usize,
    /// Channels.
    pub c: usize,
}

impl Shape {
    /// Frames, rows and columns without the channels.
    pub fn extent(self) -> [usize; 3] {
        [self.t, self.y, self.x]
    }

    /// A shape from extents and channels.
    pub fn new([t, y, x]: [usize; 3], c: usize) -> Self {
        Self { t, y, x, c }
    }

    /// Number of pixels over all frames.
    pub fn pixels(self) -> usize {
        self.t * self.y * self.x
    }

    /// Number of values.
    pub fn len(self) -> usize {
        self.pixels() * self.c
    }

    /// Whether there are no values.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}×{}×{}×{}", self.t, self.y, self.x, self.c)
    }
}

/// A dense tensor [t, y, x, c], channels running fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor<R = f32> {
    /// Extents.
    pub shape: Shape,
    /// `shape.len()` values.
    pub data: Vec<R>,
}

impl<R: Copy> Tensor<R> {
    /// A tensor of one value.
    pub fn filled(shape: Shape, value: R) -> Self {
        Self { shape, data: vec![value; shape.len()] }
    }

    /// The same tensor with every value mapped.
    pub fn map<S>(&self, f: impl FnMut(&R) -> S) -> Tensor<S> {
        Tensor { shape: self.shape, data: self.data.iter().map(f).collect() }
    }
}

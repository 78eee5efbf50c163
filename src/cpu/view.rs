//! Tensors inside slots, as kernels see them, and scratch memory.

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::gemm::Segment;
use crate::network::{Shape, Tensor, View};

/// A tensor that is read: channels-last pixels, `stride` values apart.
#[derive(Clone, Copy, Debug)]
pub struct TensorView<'a, R> {
    values: &'a [R],
    /// Values between neighbouring pixels, ≥ `shape.c`.
    pub stride: usize,
    /// Extents.
    pub shape: Shape,
}

/// A tensor that is written.
#[derive(Debug)]
pub struct TensorViewMut<'a, R> {
    values: &'a mut [R],
    stride: usize,
    /// Extents.
    pub shape: Shape,
}

/// Rows of one frame that one task writes.
#[derive(Debug)]
pub struct Rows<'a, R> {
    /// The frame.
    pub t: usize,
    /// The first row.
    pub y: usize,
    values: &'a mut [R],
    stride: usize,
    shape: Shape,
}

/// Number of values from the first pixel's first channel to the last pixel's last one.
fn span(shape: Shape, stride: usize) -> usize {
    shape.pixels().checked_sub(1).map_or(0, |last| last * stride + shape.c)
}

impl<'a, R: Copy> TensorView<'a, R> {
    /// The tensor that `view` places in `slot`.
    pub fn new(slot: &'a [R], view: &View) -> Self {
        let values = &slot[view.offset..][..span(view.shape, view.stride)];
        Self { values, stride: view.stride, shape: view.shape }
    }

    /// A dense tensor.
    pub fn dense(tensor: &'a Tensor<R>) -> Self {
        Self { values: &tensor.data, stride: tensor.shape.c, shape: tensor.shape }
    }

    /// Values from pixel (t, y, x) on.
    #[inline]
    pub fn from(&self, t: usize, y: usize, x: usize) -> &'a [R] {
        &self.values[((t * self.shape.y + y) * self.shape.x + x) * self.stride..]
    }

    /// Channels of pixel (t, y, x).
    #[inline]
    pub fn pixel(&self, t: usize, y: usize, x: usize) -> &'a [R] {
        &self.from(t, y, x)[..self.shape.c]
    }

    /// Pixels of row y of frame t.
    pub fn row(&self, t: usize, y: usize) -> impl Iterator<Item = &'a [R]> + use<'a, R> {
        let channels = self.shape.c;
        self.from(t, y, 0).chunks(self.stride).take(self.shape.x).map(move |pixel| &pixel[..channels])
    }

    /// Values of row y of frame t of a tensor of one value a pixel.
    pub fn line(&self, t: usize, y: usize) -> &'a [R] {
        debug_assert_eq!(self.stride, 1, "tensors of one value a pixel are dense");
        &self.from(t, y, 0)[..self.shape.x]
    }

    /// All pixels in order.
    pub fn pixels(&self) -> impl Iterator<Item = &'a [R]> + use<'a, R> {
        let channels = self.shape.c;
        self.values.chunks(self.stride).map(move |pixel| &pixel[..channels])
    }
}

impl<'a, R: Send> TensorViewMut<'a, R> {
    /// The tensor that `view` places in `slot`.
    pub fn new(slot: &'a mut [R], view: &View) -> Self {
        let values = &mut slot[view.offset..][..span(view.shape, view.stride)];
        Self { values, stride: view.stride, shape: view.shape }
    }

    /// A dense tensor.
    pub fn dense(tensor: &'a mut Tensor<R>) -> Self {
        Self { values: &mut tensor.data, stride: tensor.shape.c, shape: tensor.shape }
    }

    /// Calls `task` on blocks of up to `rows` rows of a frame, in parallel.
    pub fn for_each_rows(self, rows: usize, task: impl Fn(Rows<'_, R>) + Sync) {
        let Self { values, stride, shape } = self;
        let row = shape.x * stride;
        values.par_chunks_mut((shape.y * row).max(1)).enumerate().for_each(|(t, frame)| {
            frame.par_chunks_mut((rows * row).max(1)).enumerate().for_each(|(block, values)| {
                task(Rows { t, y: block * rows, values, stride, shape });
            });
        });
    }

    /// Calls `task` with t, y, x and the channels of every pixel, in parallel.
    pub fn for_each_pixel(self, task: impl Fn(usize, usize, usize, &mut [R]) + Sync) {
        // About as many values a task as make up for the cost of a task.
        let rows = (4096 / (self.shape.x * self.shape.c).max(1)).max(1);
        self.for_each_rows(rows, |mut rows| {
            let Rows { t, y, .. } = rows;
            let width = rows.shape.x;
            for (pixel, channels) in rows.pixels().enumerate() {
                task(t, y + pixel / width, pixel % width, channels);
            }
        });
    }
}

impl<R> Rows<'_, R> {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.values.len().div_ceil(self.shape.x * self.stride)
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.shape.x
    }

    /// Channels of pixel `x` of row `row`, counted from the first row of these.
    #[inline]
    pub fn pixel(&mut self, row: usize, x: usize) -> &mut [R] {
        &mut self.values[(row * self.shape.x + x) * self.stride..][..self.shape.c]
    }

    /// Pixels of row `row`, counted from the first row of these.
    pub fn row(&mut self, row: usize) -> impl Iterator<Item = &mut [R]> {
        let (width, channels) = (self.shape.x, self.shape.c);
        let values = &mut self.values[row * width * self.stride..];
        values.chunks_mut(self.stride).take(width).map(move |pixel| &mut pixel[..channels])
    }

    /// Values of row `row`, counted from the first row of these, of a tensor of one value a pixel.
    pub fn line(&mut self, row: usize) -> &mut [R] {
        debug_assert_eq!(self.stride, 1, "tensors of one value a pixel are dense");
        &mut self.values[row * self.shape.x..][..self.shape.x]
    }

    /// All pixels in order.
    pub fn pixels(&mut self) -> impl Iterator<Item = &mut [R]> {
        let channels = self.shape.c;
        self.values.chunks_mut(self.stride).map(move |pixel| &mut pixel[..channels])
    }
}

/// All positions below `extent`, the last axis running fastest.
pub fn positions(extent: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    let [t, y, x] = extent;
    (0..t).flat_map(move |t| (0..y).flat_map(move |y| (0..x).map(move |x| [t, y, x])))
}

/// What a task needs besides tensors. The vectors grow to what the largest task needs and stay so.
#[derive(Debug)]
pub struct Scratch<R> {
    /// Pixels that a block of results depends on, dense and padded with zeros.
    pub gathered: Vec<R>,
    /// Sums of one panel.
    pub sums: Vec<R>,
    /// Row and column of each result, counted within a block.
    pub places: Vec<[usize; 2]>,
    /// Where the inputs of each result begin in `gathered`.
    pub pixels: Vec<usize>,
    /// Runs of inputs.
    pub segments: Vec<Segment>,
}

/// Memory of tasks that run at the same time.
#[derive(Debug)]
pub struct Spare<T>(Mutex<Vec<T>>);

/// Scratch memory of tasks that run at the same time; there are never more than threads.
pub type ScratchPool<R> = Spare<Scratch<R>>;

impl<R> Default for Scratch<R> {
    fn default() -> Self {
        Self {
            gathered: Vec::new(),
            sums: Vec::new(),
            places: Vec::new(),
            pixels: Vec::new(),
            segments: Vec::new(),
        }
    }
}

impl<T> Default for Spare<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T: Default> Spare<T> {
    /// Runs `task` with memory that no other task has.
    pub fn with<U>(&self, task: impl FnOnce(&mut T) -> U) -> U {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut memory = lock().pop().unwrap_or_default();
        let result = task(&mut memory);
        lock().push(memory);
        result
    }
}

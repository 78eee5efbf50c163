//! Convolutions on the CPU against loops that are nothing but the definition.

use std::sync::Arc;

use pix2hdr::cpu::evaluate;
use pix2hdr::network::{Activation, Convolution, ConvolutionStep, Direction, Kernel, Layer, Shape, Tensor};
use pix2hdr::sensor::Calibration;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A convolution does not look at the camera.
fn no_camera() -> Calibration {
    Calibration::from_tables([1; 3], vec![1.0], vec![0.0, 1.0]).unwrap()
}

struct Case {
    direction: Direction,
    convolution: Convolution,
    input: Shape,
}

impl Case {
    fn new(
        direction: Direction,
        kernel: [usize; 3],
        stride: [usize; 3],
        extent: [usize; 3],
        channels: [usize; 2],
    ) -> Self {
        let convolution = Convolution {
            out_channels: channels[1],
            kernel,
            stride,
            activation: Activation::LeakyRelu(0.2),
            norm: true,
            add: None,
        };
        Self { direction, convolution, input: Shape::new(extent, channels[0]) }
    }

    /// Input, added tensor, step and output shape with random values.
    fn random(&self, seed: u64) -> (Tensor<f64>, Tensor<f64>, ConvolutionStep, Shape) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut values = |n: usize| (0..n).map(|_| rng.random_range(-1.0f32..1.0)).collect::<Vec<_>>();
        let (extent, stride) = (self.input.extent(), self.convolution.stride);
        let results = |i: usize| match self.direction {
            Direction::Forward => extent[i].div_ceil(stride[i]),
            Direction::Transposed => extent[i] * stride[i],
        };
        let output = Shape::new(std::array::from_fn(results), self.convolution.out_channels);
        let overlap = |i: usize| match self.direction {
            Direction::Forward => self.convolution.kernel[i] - 1,
            Direction::Transposed => self.convolution.kernel[i] - stride[i],
        };
        let (in_channels, out_channels) = (self.input.c, output.c);
        let layer = Layer {
            weight: values(in_channels * out_channels * self.convolution.taps()),
            bias: values(out_channels),
            norm: Some((values(out_channels), values(out_channels))),
        };
        let step = ConvolutionStep {
            direction: self.direction,
            kernel: self.convolution.kernel,
            stride: self.convolution.stride,
            padding: std::array::from_fn(|i| overlap(i) / 2),
            in_channels,
            out_channels,
            activation: self.convolution.activation,
            layer: Arc::new(layer),
        };
        let mut tensor =
            |shape: Shape| Tensor { shape, data: values(shape.len()).iter().map(|&v| v as f64).collect() };
        (tensor(self.input), tensor(output), step, output)
    }
}

/// PyTorch's definitions, one product at a time.
fn naive(step: &ConvolutionStep, x: &Tensor<f64>, added: &Tensor<f64>, output: Shape) -> Tensor<f64> {
    let transposed = step.direction == Direction::Transposed;
    let mut sums = Tensor::filled(output, 0.0);
    let at = |shape: Shape, [t, y, x]: [usize; 3], c: usize| ((t * shape.y + y) * shape.x + x) * shape.c + c;
    // Walks over the smaller-stepped side: for each pixel of `coarse` and each tap, the pixel of `fine`.
    let (coarse, fine) = if transposed { (x.shape, output) } else { (output, x.shape) };
    let [kt, ky, kx] = step.kernel;
    for (t, y, x0) in positions(coarse.extent()) {
        for (dt, dy, dx) in positions(step.kernel) {
            let (position, tap) = ([t, y, x0], [dt, dy, dx]);
            let other: [isize; 3] = std::array::from_fn(|i| {
                (position[i] * step.stride[i] + tap[i]) as isize - step.padding[i] as isize
            });
            if (0..3).any(|i| other[i] < 0 || other[i] >= fine.extent()[i] as isize) {
                continue;
            }
            let other = other.map(|v| v as usize);
            let (from, to) = if transposed { (position, other) } else { (other, position) };
            for o in 0..step.out_channels {
                for i in 0..step.in_channels {
                    let (row, column, columns) =
                        if transposed { (i, o, step.out_channels) } else { (o, i, step.in_channels) };
                    let weight = step.layer.weight
                        [(((row * columns + column) * kt + tap[0]) * ky + tap[1]) * kx + tap[2]];
                    sums.data[at(output, to, o)] += weight as f64 * x.data[at(x.shape, from, i)];
                }
            }
        }
    }
    let (scale, shift) = step.layer.norm.as_ref().expect("all cases have a norm");
    for (index, value) in sums.data.iter_mut().enumerate() {
        let c = index % step.out_channels;
        let v = *value + step.layer.bias[c] as f64;
        let v = if v < 0.0 { 0.2f32 as f64 * v } else { v };
        *value = v * scale[c] as f64 + shift[c] as f64 + added.data[index];
    }
    sums
}

fn positions([t, y, x]: [usize; 3]) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..t).flat_map(move |t| (0..y).flat_map(move |y| (0..x).map(move |x| (t, y, x))))
}

fn check(cases: &[Case]) {
    for (seed, case) in cases.iter().enumerate() {
        let (x, added, step, output) = case.random(seed as u64);
        let expected = naive(&step, &x, &added, output);
        let kernel = match step.direction {
            Direction::Forward => Kernel::Conv3d(Arc::new(step)),
            Direction::Transposed => Kernel::ConvTranspose3d(Arc::new(step)),
        };
        let actual = evaluate(&kernel, &[x, added], output, &no_camera(), 0);
        for (index, (a, e)) in actual.data.iter().zip(&expected.data).enumerate() {
            assert!(
                (a - e).abs() < 1e-11,
                "case {seed}, {:?} on {}, value {index}: {a}, not {e}",
                case.convolution,
                case.input
            );
        }
    }
}

#[test]
fn convolutions_are_their_definition() {
    let case =
        |kernel, stride, extent, channels| Case::new(Direction::Forward, kernel, stride, extent, channels);
    check(&[
        case([1, 1, 1], [1, 1, 1], [1, 1, 1], [1, 1]),
        case([3, 3, 3], [1, 1, 1], [1, 1, 1], [2, 3]),
        case([7, 7, 7], [1, 1, 1], [1, 1, 1], [1, 5]),
        case([7, 7, 7], [1, 1, 1], [5, 11, 13], [1, 17]),
        case([3, 3, 3], [1, 1, 1], [3, 7, 5], [3, 33]),
        case([3, 3, 3], [2, 2, 2], [5, 7, 9], [6, 4]),
        case([3, 3, 3], [2, 2, 2], [4, 6, 8], [5, 9]),
        case([1, 3, 3], [1, 2, 1], [2, 13, 67], [7, 8]),
        case([1, 3, 3], [1, 1, 1], [1, 17, 131], [12, 16]),
        case([1, 1, 1], [2, 2, 2], [3, 3, 3], [4, 19]),
        case([5, 1, 3], [4, 3, 2], [9, 10, 11], [2, 7]),
        // Runs that are longer than what is multiplied in one go.
        case([1, 3, 3], [1, 1, 1], [1, 3, 8], [401, 6]),
    ]);
}

#[test]
fn transposed_convolutions_are_their_definition() {
    let case =
        |kernel, stride, extent, channels| Case::new(Direction::Transposed, kernel, stride, extent, channels);
    check(&[
        case([1, 1, 1], [1, 1, 1], [1, 1, 1], [1, 1]),
        case([4, 4, 4], [2, 2, 2], [1, 1, 1], [3, 2]),
        case([4, 4, 4], [2, 2, 2], [3, 5, 7], [5, 18]),
        case([2, 2, 2], [2, 2, 2], [3, 4, 5], [4, 3]),
        case([3, 3, 3], [1, 1, 1], [3, 7, 11], [6, 5]),
        case([1, 4, 6], [1, 2, 2], [2, 5, 37], [7, 9]),
        case([3, 5, 3], [3, 3, 1], [2, 3, 4], [2, 13]),
        case([7, 4, 8], [3, 4, 4], [2, 2, 3], [1, 8]),
    ]);
}

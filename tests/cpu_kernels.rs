//! The kernels on pixels, at f64, against their definitions written plainly.

use pix2hdr::cpu::evaluate;
use pix2hdr::network::{
    BlendStep, BoxEstimate, Channel, Feature, FeaturesStep, Fuse, InverseResponse, Kernel, LogIrradiance,
    Shape, Tensor,
};
use pix2hdr::sensor::{Calibration, Form, Pattern, Response};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SCHEDULE: i64 = -3;

fn camera() -> Calibration {
    let pattern = Pattern::built_in("mpve-1-8").unwrap();
    Calibration::new(&pattern, &Response::new(Form::SoftKnee(0.6), 2.0).unwrap())
}

fn random(shape: Shape, range: std::ops::Range<f64>, seed: u64) -> Tensor<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Tensor { shape, data: (0..shape.len()).map(|_| rng.random_range(range.clone())).collect() }
}

fn run(kernel: &Kernel, inputs: &[Tensor<f64>], output: Shape) -> Tensor<f64> {
    evaluate(kernel, inputs, output, &camera(), SCHEDULE)
}

/// R⁻¹ from the table.
fn inverse_response(y: f64) -> f64 {
    let camera = camera();
    let table = camera.inverse_response();
    let n = table.len() - 1;
    if y >= 1.0 {
        return table[n] as f64;
    }
    let position = y.max(0.0) * n as f64;
    let i = position.floor() as usize;
    let fraction = position - position.floor();
    table[i] as f64 * (1.0 - fraction) + table[i + 1] as f64 * fraction
}

fn tone(p: f64) -> f64 {
    (1.0 + 5000.0 * p).ln() / 5001f64.ln()
}

fn at(x: &Tensor<f64>, t: usize, y: usize, x0: usize, c: usize) -> f64 {
    x.data[((t * x.shape.y + y) * x.shape.x + x0) * x.shape.c + c]
}

fn assert_close(actual: &Tensor<f64>, expected: impl Fn(usize, usize, usize, usize) -> f64) {
    let shape = actual.shape;
    for (index, a) in actual.data.iter().enumerate() {
        let (pixel, c) = (index / shape.c, index % shape.c);
        let (t, y, x) = (pixel / (shape.y * shape.x), pixel / shape.x % shape.y, pixel % shape.x);
        let e = expected(t, y, x, c);
        assert!((a - e).abs() <= 1e-12 * e.abs().max(1.0), "({t}, {y}, {x}, {c}) of {shape}: {a}, not {e}");
    }
}

#[test]
fn box_estimate_is_a_weighted_mean_of_what_is_not_saturated() {
    let mirror = |i: isize, n: usize| {
        let n = n as isize;
        let mirrored = if i < 0 {
            1
        } else if i >= n {
            n - 2
        } else {
            i
        };
        mirrored.clamp(0, n - 1) as usize
    };
    for (extent, top) in
        [([2, 1, 1], 1.2), ([1, 1, 7], 1.2), ([1, 5, 1], 1.2), ([3, 2, 2], 1.0), ([2, 37, 9], 3.0)]
    {
        let shape = Shape::new(extent, 1);
        let y = random(shape, 0.0..top, 1).map(|v| v.min(1.0));
        let estimate = run(&Kernel::BoxEstimate(BoxEstimate {}), std::slice::from_ref(&y), shape);
        assert_close(&estimate, |t, row, column, _| {
            let (mut sum, mut weight, mut sum_all) = (0.0, 0.0, 0.0);
            for dy in -1isize..=1 {
                for dx in -1isize..=1 {
                    let (r, c) = (mirror(row as isize + dy, shape.y), mirror(column as isize + dx, shape.x));
                    let w = ((2 - dy.abs()) * (2 - dx.abs())) as f64;
                    let measured = at(&y, t, r, c, 0);
                    let exposure = camera().exposure(SCHEDULE + t as i64, r, c) as f64;
                    let p = inverse_response(measured) / exposure;
                    sum_all += w * p;
                    if measured < 0.98 {
                        sum += w * p;
                        weight += w;
                    }
                }
            }
            if weight > 0.0 { sum / weight } else { sum_all / 16.0 }
        });
    }
}

#[test]
fn features_are_folded_blocks_of_channels() {
    let all = [
        (Feature::LogExposure, 0),
        (Feature::Saturated, 0),
        (Feature::LogEstimate, 0),
        (Feature::LogIrradiance, 0),
        (Feature::LogIrradiance, 2),
        (Feature::LogIrradiance, -2),
        (Feature::Measurement, 0),
    ]
    .map(|(feature, offset)| Channel { feature, offset });
    let shape = Shape::new([4, 6, 10], 1);
    let y = random(shape, 0.0..1.3, 2).map(|v| v.min(1.0));
    let estimate = random(shape, 0.0..1.0, 3);
    // A frame before the output's four, and two behind them.
    let (lead, logs) = (1, random(Shape { t: 7, ..shape }, 0.0..1.0, 9));
    for (block, channels, given) in [
        ([1, 1, 1], &all[..], true),
        ([4, 3, 5], &all[2..], true),
        ([1, 2, 5], &all[..4], false),
        ([2, 6, 1], &all[..1], false),
    ] {
        let [bt, by, bx] = block;
        let n = channels.len();
        let output = Shape::new([4 / bt, 6 / by, 10 / bx], n * bt * by * bx);
        let kernel = Kernel::Features(FeaturesStep { channels: channels.to_vec(), block, lead });
        let mut inputs = vec![y.clone(), estimate.clone()];
        inputs.extend(given.then(|| logs.clone()));
        let features = run(&kernel, &inputs, output);
        assert_close(&features, |t, row, column, c| {
            let (dt, dy, dx) = (c / n / bx / by, c / n / bx % by, c / n % bx);
            let (t, row, column) = (t * bt + dt, row * by + dy, column * bx + dx);
            let measured = at(&y, t, row, column, 0);
            let exposure = camera().exposure(SCHEDULE + t as i64, row, column) as f64;
            let Channel { feature, offset } = channels[c % n];
            match feature {
                Feature::Measurement => measured,
                Feature::LogIrradiance if given => match (t + lead) as i32 + offset {
                    frame @ 0..7 => at(&logs, frame as usize, row, column, 0),
                    _ => 0.0,
                },
                Feature::LogIrradiance => tone(inverse_response(measured) / exposure),
                Feature::LogEstimate => tone(at(&estimate, t, row, column, 0)),
                Feature::Saturated => f64::from(u8::from(measured >= 0.98)),
                Feature::LogExposure => exposure.log2(),
            }
        });
    }
}

#[test]
fn log_irradiance_is_the_tone_of_the_irradiance() {
    let shape = Shape::new([3, 5, 9], 1);
    let y = random(shape, 0.0..1.3, 10).map(|v| v.min(1.0));
    assert_close(
        &run(&Kernel::LogIrradiance(LogIrradiance {}), std::slice::from_ref(&y), shape),
        |t, row, column, _| {
            let exposure = camera().exposure(SCHEDULE + t as i64, row, column) as f64;
            tone(inverse_response(at(&y, t, row, column, 0)) / exposure)
        },
    );
}

#[test]
fn blend_weighs_the_taps_that_lie_inside() {
    let taps = [[0, 0, 0], [0, -1, 2], [-2, 0, 0], [3, 1, -1], [0, 0, -40]];
    let ([first_t, first_y], [by, bx], n) = ([1, 2], [2, 3], taps.len() + 1);
    let shape = Shape::new([3, 4, 9], 1);
    let weights = random(Shape::new([3, 4 / by, 9 / bx], n * by * bx), -0.5..0.5, 11);
    let logs = random(Shape { t: 6, y: 8, ..shape }, 0.0..1.0, 12);
    let estimate = random(shape, 0.0..1.0, 13);
    let kernel =
        Kernel::Blend(BlendStep { block: [1, by, bx], taps: taps.into(), origin: [first_t, first_y] });
    let radiance = run(&kernel, &[weights.clone(), logs.clone(), estimate.clone()], shape);
    assert_close(&radiance, |t, row, column, _| {
        let pixel = row % by * bx + column % bx;
        let weight = |i: usize| at(&weights, t, row / by, column / bx, i * by * bx + pixel);
        let base = tone(at(&estimate, t, row, column, 0));
        let mut v = base + weight(n - 1);
        for (i, [dt, dy, dx]) in taps.into_iter().enumerate() {
            let [frame, row, column] =
                [(first_t + t) as i32 + dt, (first_y + row) as i32 + dy, column as i32 + dx];
            if (0..6).contains(&frame) && (0..8).contains(&row) && (0..9).contains(&column) {
                v += weight(i) * (at(&logs, frame as usize, row as usize, column as usize, 0) - base);
            }
        }
        (5001f64.powf(v.clamp(0.0, 1.0)) - 1.0) / 5000.0
    });
}

#[test]
fn inverse_response_keeps_the_pixel_values() {
    let shape = Shape::new([2, 3, 5], 3);
    let y = random(shape, -0.2..1.2, 4);
    let exposures = [2.0, 4.0, 16.0];
    let kernel = Kernel::InverseResponse(InverseResponse { exposures: exposures.to_vec() });
    let rendered = run(&kernel, std::slice::from_ref(&y), Shape { c: 6, ..shape });
    assert_close(&rendered, |t, row, column, c| match c {
        0..3 => at(&y, t, row, column, c),
        _ => inverse_response(at(&y, t, row, column, c - 3)) / exposures[c - 3] as f64,
    });
}

#[test]
fn fuse_is_a_weighted_mean() {
    let weights = random(Shape::new([2, 3, 5], 3), 0.001..2.0, 5);
    let rendered = random(Shape::new([2, 3, 5], 6), 0.0..1.0, 6);
    let radiance =
        run(&Kernel::Fuse(Fuse {}), &[weights.clone(), rendered.clone()], Shape::new([2, 3, 5], 1));
    assert_close(&radiance, |t, row, column, _| {
        let sum: f64 =
            (0..3).map(|i| at(&weights, t, row, column, i) * at(&rendered, t, row, column, 3 + i)).sum();
        sum / (0..3).map(|i| at(&weights, t, row, column, i)).sum::<f64>()
    });
}

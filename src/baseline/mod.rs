//! The box filter, the baseline that every figure of quality is held against (design §4).

use rayon::prelude::*;

use crate::cpu;
use crate::network::{BoxEstimate, Kernel, Shape, Tensor};
use crate::sensor::Calibration;
use crate::video::Video;

/// Irradiance of a whole capture: per frame, each pixel's R⁻¹(y)/e averaged over its 3×3 neighbours. It is the kernel
/// `box_estimate`, which networks start from, on its own.
///
/// `measurement` holds pixel values y in [0, 1], each frame the exposure that covers it; its first frame is at schedule
/// time `schedule_start`. Does not depend on the number of threads.
pub fn box_filter(measurement: &Video, calibration: &Calibration, schedule_start: i64) -> Video {
    let Video { frames, height, width, .. } = *measurement;
    let mut irradiance = Video::black(frames, height, width);
    if irradiance.data.is_empty() {
        return irradiance;
    }
    let shape = Shape::new([1, height, width], 1);
    irradiance.data.par_chunks_mut(height * width).enumerate().for_each(|(t, output)| {
        let frame = Tensor { shape, data: measurement.frame(t).to_vec() };
        let schedule = schedule_start + t as i64;
        let filtered =
            cpu::evaluate(&Kernel::BoxEstimate(BoxEstimate {}), &[frame], shape, calibration, schedule);
        output.copy_from_slice(&filtered.data);
    });
    irradiance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Form, Pattern, Response};

    fn calibration(pattern: &str) -> Calibration {
        let response = Response::new(Form::Gamma(2.2), 2.0).unwrap();
        Calibration::new(&Pattern::built_in(pattern).unwrap(), &response)
    }

    /// Pixel values of a static, uniform scene of irradiance `p`.
    fn uniform(calibration: &Calibration, extents: [usize; 3], start: i64, p: f64) -> Video {
        let response = Response::new(Form::Gamma(2.2), 2.0).unwrap();
        let [frames, height, width] = extents;
        let mut video = Video::black(frames, height, width);
        for t in 0..frames {
            for (i, value) in video.frame_mut(t).iter_mut().enumerate() {
                let e = calibration.exposure(start + t as i64, i / width, i % width);
                *value = response.value(p * f64::from(e)) as f32;
            }
        }
        video
    }

    #[test]
    fn a_uniform_scene_comes_back_even_where_long_exposures_saturate() {
        for pattern in ["mpve-1-4", "interleaved", "coded"] {
            let calibration = calibration(pattern);
            for p in [0.001, 0.1, 0.2] {
                let video = uniform(&calibration, [11, 6, 9], -3, p);
                let filtered = box_filter(&video, &calibration, -3);
                assert!(
                    filtered.data.iter().all(|v| (f64::from(*v) / p - 1.0).abs() < 1e-2),
                    "{pattern} {p}"
                );
            }
        }
        // Exposures 4 and 8 saturate at 0.6 (x = 2.4, 4.8); each patch has one of 2.
        let calibration = calibration("mpve-1-4");
        let video = uniform(&calibration, [4, 6, 8], 0, 0.6);
        let filtered = box_filter(&video, &calibration, 0);
        assert!(filtered.data.iter().all(|v| (v - 0.6).abs() < 1e-3));
    }

    /// Every pixel against the definition, written as a sum over mirrored places.
    #[test]
    fn pixels_match_the_definition() {
        let calibration = calibration("mpve-1-4");
        for (height, width) in [(1, 1), (1, 5), (2, 2), (5, 1), (4, 7)] {
            let data = (0..3 * height * width).map(|i| (i * 37 % 101) as f32 / 100.0).collect();
            let video = Video::new(3, height, width, data).unwrap();
            let filtered = box_filter(&video, &calibration, 5);
            let mirror = |i: i64, n: usize| {
                let n = n as i64;
                let i = if i < 0 { -i } else { i };
                (if i >= n { 2 * (n - 1) - i } else { i }).clamp(0, n - 1) as usize
            };
            for (t, y, x) in
                (0..3).flat_map(|t| (0..height).flat_map(move |y| (0..width).map(move |x| (t, y, x))))
            {
                let (mut good, mut all) = ((0.0, 0.0), (0.0, 0.0));
                for (dy, dx) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx))) {
                    let (v, u) = (mirror(y as i64 + dy, height), mirror(x as i64 + dx, width));
                    let value = video.frame(t)[v * width + u];
                    let weight = f64::from((2 - dy.abs() as i32) * (2 - dx.abs() as i32));
                    let x = 2.0 * f64::from(value).powf(2.2);
                    let term = weight * x / f64::from(calibration.exposure(5 + t as i64, v, u));
                    all = (all.0 + term, all.1 + weight);
                    if f64::from(value) < 0.98 {
                        good = (good.0 + term, good.1 + weight);
                    }
                }
                let (sum, weight) = if good.1 > 0.0 { good } else { all };
                let found = f64::from(filtered.frame(t)[y * width + x]);
                assert!((found - sum / weight).abs() < 1e-5, "{height}×{width}: {t}, {y}, {x}");
            }
        }
    }

    #[test]
    fn all_saturated_gives_the_mean_of_all() {
        let calibration = calibration("global");
        let video = Video::new(1, 3, 3, vec![1.0; 9]).unwrap();
        // x_sat / e = 2/4.
        assert!(box_filter(&video, &calibration, 0).data.iter().all(|v| (v - 0.5).abs() < 1e-6));
        assert!(box_filter(&Video::black(2, 0, 3), &calibration, 0).data.is_empty());
    }
}

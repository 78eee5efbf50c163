//! A pixel over time, and what is read off it (paper, section on temporal resolution).

use std::sync::Arc;

use crate::frame::Frame;
use pix2hdr::sensor::Recording;

/// Irradiance of one pixel over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// What it is of.
    pub name: &'static str,
    /// Frame number and irradiance, in order.
    pub points: Vec<[f64; 2]>,
}

/// What is read off a series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Temporal contrast (peak − trough)/(peak + trough), paper eq. 26.
    pub contrast: f64,
    /// Frames for which it is above 15% of the peak, around it: the paper's full duration. `None` where it does not fall
    /// below that on both sides.
    pub full_duration: Option<f64>,
    /// Full width at half of the way from trough to peak, in frames.
    pub half_width: Option<f64>,
}

/// The part of the peak that the paper's full duration is measured at.
const DURATION_LEVEL: f64 = 0.15;

impl Series {
    /// The series of the pixel at row `y`, column `x`: raw value over exposure, box filter, net and truth, of what there
    /// is.
    pub fn of(frames: &[Arc<Frame>], recording: Option<&Recording>, [y, x]: [usize; 2]) -> Vec<Self> {
        let series = |name: &'static str, value: &dyn Fn(&Frame) -> Option<f64>| Self {
            name,
            points: frames.iter().filter_map(|f| Some([f.number as f64, value(f)?])).collect(),
        };
        let of = |frame: &Frame, plane: &Option<Vec<f32>>| {
            let inside = y < frame.height && x < frame.width;
            plane.as_ref().filter(|_| inside).map(|plane| f64::from(plane[y * frame.width + x]))
        };
        let raw = |frame: &Frame| {
            let recording = recording?;
            let covering = recording
                .pattern
                .schedule(y, x)
                .covering(recording.info.schedule_start + frame.number as i64);
            Some(recording.response.exposure(of(frame, &frame.mosaic)?) / covering.shutter.exposure() as f64)
        };
        let all = [
            series("raw / exposure", &raw),
            series("box filter", &|frame| of(frame, &frame.filtered)),
            series("pix2hdr", &|frame| of(frame, &frame.ours)),
            series("truth", &|frame| of(frame, &frame.truth)),
        ];
        all.into_iter().filter(|series| !series.points.is_empty()).collect()
    }

    /// Least and largest irradiance.
    pub fn range(&self) -> Option<[f64; 2]> {
        let values = || self.points.iter().map(|[_, v]| *v);
        let least = values().min_by(f64::total_cmp)?;
        Some([least, values().max_by(f64::total_cmp)?])
    }

    /// Contrast and durations; `None` for a series that is black or empty.
    pub fn read(&self) -> Option<Reading> {
        let [trough, peak] = self.range()?;
        if peak <= 0.0 || !peak.is_finite() {
            return None;
        }
        Some(Reading {
            contrast: (peak - trough) / (peak + trough),
            full_duration: self.duration(DURATION_LEVEL * peak),
            half_width: if peak > trough { self.duration(0.5 * (peak + trough)) } else { None },
        })
    }

    /// How long it is above `level`, around its peak, in frames; crossings are interpolated.
    fn duration(&self, level: f64) -> Option<f64> {
        // Of equal peaks, the one in the middle has most of both its sides.
        let off = |i: &usize| (2 * i + 1).abs_diff(self.points.len());
        let value = |i: &usize| self.points[*i][1];
        let peak = (0..self.points.len())
            .max_by(|a, b| value(a).total_cmp(&value(b)).then_with(|| off(b).cmp(&off(a))))?;
        let crossing = |above: [f64; 2], below: [f64; 2]| {
            above[0] + (below[0] - above[0]) * (above[1] - level) / (above[1] - below[1])
        };
        let before = (0..peak).rev().find(|i| self.points[*i][1] < level)?;
        let after = (peak + 1..self.points.len()).find(|i| self.points[*i][1] < level)?;
        let rise = crossing(self.points[before + 1], self.points[before]);
        let fall = crossing(self.points[after - 1], self.points[after]);
        Some(fall - rise)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(values: &[f64]) -> Series {
        let points = values.iter().enumerate().map(|(t, v)| [t as f64, *v]).collect();
        Series { name: "", points }
    }

    #[test]
    fn a_triangle_has_the_durations_of_a_triangle() {
        // 0 to 1 and back over 20 frames: above 0.15 for 17 of them, above half for 10.
        let values: Vec<f64> = (0..=20).map(|t| 1.0 - (f64::from(t) - 10.0).abs() / 10.0).collect();
        let reading = series(&values).read().unwrap();
        assert_eq!(reading.contrast, 1.0);
        assert!((reading.full_duration.unwrap() - 17.0).abs() < 1e-9);
        assert!((reading.half_width.unwrap() - 10.0).abs() < 1e-9);
    }

    #[test]
    fn a_pedestal_lowers_contrast_and_hides_the_duration() {
        let values: Vec<f64> = (0..=20).map(|t| 1.0 + 1.0 - (f64::from(t) - 10.0).abs() / 10.0).collect();
        let reading = series(&values).read().unwrap();
        assert!((reading.contrast - 1.0 / 3.0).abs() < 1e-9);
        assert_eq!(reading.full_duration, None);
        assert!((reading.half_width.unwrap() - 10.0).abs() < 1e-9);
    }

    #[test]
    fn of_equal_peaks_the_middle_one_is_read() {
        let reading = series(&[1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0]).read().unwrap();
        assert!((reading.half_width.unwrap() - 2.0).abs() < 1e-9);
    }

    #[test]
    fn what_has_no_event_has_no_duration() {
        assert_eq!(series(&[]).read(), None);
        assert_eq!(series(&[0.0, 0.0]).read(), None);
        let flat = series(&[0.3; 9]).read().unwrap();
        assert_eq!((flat.contrast, flat.full_duration, flat.half_width), (0.0, None, None));
        // It ends before it falls.
        assert_eq!(series(&[0.0, 0.5, 1.0]).read().unwrap().full_duration, None);
    }
}

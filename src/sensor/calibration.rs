//! What the kernels need to know about the camera, as tables.

use super::{Orientation, Pattern, Placement, Response, Schedule, SensorError, Symmetry};

/// Intervals of the table of R⁻¹: a multiple of 1023, so that every 10-bit level lies on a node.
const INTERVALS: usize = 4 * 1023;

/// Exposures, as a recording's frames show them, and inverse response as tables that a kernel can index.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Frames after which the exposures repeat.
    pub(crate) period: usize,
    /// Rows of the pattern's tile.
    pub(crate) rows: usize,
    /// Columns of the pattern's tile.
    pub(crate) cols: usize,
    /// Exposure in frames of the read-out that covers a frame: [period, rows, cols].
    pub(crate) exposures: Vec<f32>,
    /// R⁻¹ in p·frames at y = i/(n − 1), i = 0 … n − 1; linear in between. The last entry is x_sat.
    pub(crate) inverse_response: Vec<f32>,
    /// How frames lie on the sensor.
    pub(crate) placement: Placement,
    /// Views in which the sensor's pattern looks as before; the first one is as it is.
    pub(crate) symmetries: Vec<Symmetry>,
}

impl Calibration {
    /// Tables of a sensor's pattern and a response.
    pub fn new(pattern: &Pattern, response: &Response) -> Self {
        Self::placed(pattern, Placement::WHOLE, response)
    }

    /// Tables of the pattern that frames show, which lie on the sensor as `placement` says.
    pub fn placed(pattern: &Pattern, placement: Placement, response: &Response) -> Self {
        let period = pattern.period();
        let exposures = (0..period)
            .flat_map(|t| {
                let exposure = move |pixel: &Schedule| pixel.covering(t as i64).shutter.exposure() as f32;
                pattern.schedules().iter().map(exposure)
            })
            .collect();
        let node = |i: usize| response.exposure(i as f64 / INTERVALS as f64) as f32;
        Self {
            period,
            rows: pattern.rows(),
            cols: pattern.cols(),
            exposures,
            inverse_response: (0..=INTERVALS).map(node).collect(),
            placement,
            symmetries: Symmetry::all_of(&placement.on_sensor(pattern)),
        }
    }

    /// Tables that somebody else made: exposures in frames [period, rows, cols], and R⁻¹ at evenly spaced pixel values from
    /// 0 to 1. No view but the one as it is counts as a symmetry.
    pub fn from_tables(
        [period, rows, cols]: [usize; 3],
        exposures: Vec<f32>,
        inverse_response: Vec<f32>,
    ) -> Result<Self, SensorError> {
        let values = period.checked_mul(rows).and_then(|n| n.checked_mul(cols));
        if exposures.is_empty() || values != Some(exposures.len()) {
            let problem =
                format!("{} exposures for {period} frames of {rows}×{cols} pixels", exposures.len());
            return Err(SensorError::Pattern(problem));
        }
        if let Some(exposure) = exposures.iter().find(|e| !(e.is_finite() && **e > 0.0)) {
            return Err(SensorError::Pattern(format!("an exposure of {exposure} frames")));
        }
        let rises =
            inverse_response.is_sorted() && inverse_response.iter().all(|x| x.is_finite() && *x >= 0.0);
        if inverse_response.len() < 2 || !rises {
            return Err(SensorError::Response(
                "a table of R⁻¹ needs two numbers or more, which rise from 0 or more".into(),
            ));
        }
        let (placement, symmetries) = (Placement::WHOLE, vec![Symmetry::IDENTITY]);
        Ok(Self { period, rows, cols, exposures, inverse_response, placement, symmetries })
    }

    /// Frames, rows and columns after which the exposures repeat.
    pub fn repeat(&self) -> [usize; 3] {
        [self.period, self.rows, self.cols]
    }

    /// Exposure in frames of the read-out that covers a frame: [period, rows, cols].
    pub fn exposures(&self) -> &[f32] {
        &self.exposures
    }

    /// R⁻¹ in p·frames at evenly spaced pixel values from 0 to 1; linear in between. The last entry is x_sat.
    pub fn inverse_response(&self) -> &[f32] {
        &self.inverse_response
    }

    /// Views in which the sensor's pattern looks as before; the first one is as it is.
    pub fn symmetries(&self) -> &[Symmetry] {
        &self.symmetries
    }

    /// Tables for the whole frames of the sensor.
    #[must_use]
    pub fn on_sensor(&self) -> Self {
        let orientation = self.placement.orientation;
        let tile @ [rows, cols] = Orientation::turned([self.rows, self.cols], orientation.transposes());
        let mut exposures = self.exposures.clone();
        let places = self.placement.tile_places(tile);
        for (sensor, shown) in exposures.chunks_mut(places.len()).zip(self.exposures.chunks(places.len())) {
            places.iter().zip(shown).for_each(|(&place, &exposure)| sensor[place] = exposure);
        }
        Self { rows, cols, exposures, placement: Placement::WHOLE, ..self.clone() }
    }

    /// Exposure in frames of the read-out that covers schedule time `t` at row `y`, column `x`.
    pub fn exposure(&self, t: i64, y: usize, x: usize) -> f32 {
        self.row(t, y)[x % self.cols]
    }

    /// Exposures along row `y` at schedule time `t`, for one tile of the pattern.
    pub fn row(&self, t: i64, y: usize) -> &[f32] {
        let t = t.rem_euclid(self.period as i64) as usize;
        &self.exposures[(t * self.rows + y % self.rows) * self.cols..][..self.cols]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_that_do_not_fit_are_refused() {
        let tables = |extents, exposures: &[f32], inverse: &[f32]| {
            Calibration::from_tables(extents, exposures.to_vec(), inverse.to_vec())
                .map(|tables| tables.repeat())
        };
        assert_eq!(tables([1, 1, 2], &[1.0, 4.0], &[0.0, 1.0]).unwrap(), [1, 1, 2]);
        for (extents, exposures, inverse, problem) in [
            ([1, 1, 2], &[1.0][..], &[0.0, 1.0][..], "1 exposures for 1 frames of 1×2"),
            ([0, 1, 1], &[], &[0.0, 1.0], "0 exposures"),
            ([usize::MAX, 2, 1], &[1.0], &[0.0, 1.0], "1 exposures"),
            ([1, 1, 1], &[0.0], &[0.0, 1.0], "an exposure of 0 frames"),
            ([1, 1, 1], &[f32::NAN], &[0.0, 1.0], "an exposure of NaN frames"),
            ([1, 1, 1], &[1.0], &[1.0], "two numbers or more"),
            ([1, 1, 1], &[1.0], &[1.0, 0.0], "which rise"),
            ([1, 1, 1], &[1.0], &[-1.0, 0.0], "from 0 or more"),
        ] {
            let refusal = tables(extents, exposures, inverse).unwrap_err().to_string();
            assert!(refusal.contains(problem), "{refusal}");
        }
    }
}

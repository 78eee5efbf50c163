//! What the kernels need to know about the camera, as tables.

use super::{Orientation, Pattern, Placement, Response, Schedule, Symmetry};

/// Intervals of the table of R⁻¹: a multiple of 1023, so that every 10-bit level lies on a node.
const INTERVALS: usize = 4 * 1023;

/// Exposures, as a recording's frames show them, and inverse response as tables that a kernel can index.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Frames after which the exposures repeat.
    pub period: usize,
    /// Rows of the pattern's tile.
    pub rows: usize,
    /// Columns of the pattern's tile.
    pub cols: usize,
    /// Exposure in frames of the read-out that covers a frame: [period, rows, cols].
    pub exposures: Vec<f32>,
    /// R⁻¹ in p·frames at y = i/(n − 1), i = 0 … n − 1; linear in between. The last entry is x_sat.
    pub inverse_response: Vec<f32>,
    /// How frames lie on the sensor.
    pub placement: Placement,
    /// Views in which the sensor's pattern looks as before; the first one is as it is.
    pub symmetries: Vec<Symmetry>,
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

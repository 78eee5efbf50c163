//! From a recording's frames to the sensor's and back.
//!
//! A net was trained for frames that begin with the first pixel of its pattern's tile. Those of a crop, or of one that was
//! turned, are laid where they would lie in such frames: moved to their place in the net's grid, so that each pixel is
//! computed as in the whole, and turned back. Around them are the nearest pixels at the same place of the tile.

use std::sync::Arc;

use super::line::ResultFrame;
use super::skip::{Active, Skipped};
use super::windows::stand_in_row;
use crate::Result;
use crate::frame::{Extent, Frame};
use crate::sensor::{Calibration, Orientation, Placement, Recording, Source};

/// Where frames of a recording lie in the sensor's.
#[derive(Clone, Copy, Debug)]
pub struct OnSensor {
    orientation: Orientation,
    /// Rows and columns of the recording's frames, and of the tile that they show.
    frame: Extent,
    tile: [usize; 2],
    /// Rows and columns before them, turned as they are.
    before: [usize; 2],
    /// Rows and columns of the sensor's frames.
    sensor: Extent,
    whole: bool,
}

impl OnSensor {
    /// Frames of `extent` on a grid that repeats every `unit` [rows, columns] of the sensor.
    pub fn new(calibration: &Calibration, extent: Extent, unit: [usize; 2]) -> Self {
        let Placement { tile_origin, orientation } = calibration.placement;
        let tile = [calibration.rows, calibration.cols];
        let whole = calibration.placement == Placement::WHOLE;
        let unit = Orientation::turned(unit, orientation.transposes());
        let before = [0, 1].map(|axis| tile_origin[axis] % unit[axis]);
        let Extent { height, width } = extent;
        let around = [before[0] + height, before[1] + width];
        let around =
            if whole { around } else { [0, 1].map(|axis| around[axis].next_multiple_of(unit[axis])) };
        let sensor = Orientation::turned(around, orientation.transposes()).into();
        Self { orientation, frame: extent, tile, before, sensor, whole }
    }

    /// Whether both are the same.
    pub fn whole(&self) -> bool {
        self.whole
    }

    /// Rows and columns of the recording's frames.
    pub fn frame(&self) -> Extent {
        self.frame
    }

    /// Rows and columns of the sensor's frames.
    pub fn extent(&self) -> Extent {
        self.sensor
    }

    /// Rows and columns of the sensor's frames, turned as the recording's.
    fn around(&self) -> [usize; 2] {
        Orientation::turned(self.sensor.into(), self.orientation.transposes())
    }

    /// The number of the sensor's pixel that lies `y` rows and `x` columns from the corner of what is around a frame.
    fn sensor_pixel(&self, y: usize, x: usize) -> usize {
        let [v, u] = self.orientation.sensor_place(self.around(), [y, x]);
        v * self.sensor.width + u
    }

    /// The sensor's frame that shows what a recording's does.
    fn laid(&self, frame: &Frame) -> Frame {
        let Extent { height, width } = self.frame;
        let [rows, cols] = self.around();
        let [top, left] = self.before.map(|pixels| pixels as i64);
        let cols: Vec<usize> =
            (0..cols as i64).map(|x| stand_in_row(width, self.tile[1], x - left)).collect();
        let mut values = vec![0.0; self.sensor.pixels()];
        for y in 0..rows {
            let row = stand_in_row(height, self.tile[0], y as i64 - top);
            let row = &frame.values()[row * width..][..width];
            cols.iter().enumerate().for_each(|(x, &col)| values[self.sensor_pixel(y, x)] = row[col]);
        }
        Frame::new(self.sensor, frame.time(), values)
    }

    /// A mask of the sensor's pixels from one [y, x] of the recording's.
    pub fn laid_mask(&self, mask: &[bool]) -> Vec<bool> {
        let values = mask.iter().map(|&pixel| f32::from(pixel)).collect();
        self.laid(&Frame::new(self.frame, 0, values)).values().iter().map(|&value| value > 0.0).collect()
    }

    /// The recording's frame in one of the sensor.
    fn lifted(&self, frame: &Frame) -> Frame {
        let Extent { height, width } = self.frame;
        let [top, left] = self.before;
        let pixels = (top..top + height).flat_map(|y| (left..left + width).map(move |x| (y, x)));
        let values = pixels.map(|(y, x)| frame.values()[self.sensor_pixel(y, x)]).collect();
        Frame::new(self.frame, frame.time(), values)
    }

    /// Of values by cell of the sensor's frames, [rows, columns] of `cell` pixels, the largest in each cell of as many pixels
    /// of the recording's frame; the shape of both, and rows and columns of such a cell.
    fn cells<T: Copy + Ord>(&self, cell: [usize; 2], values: &[T]) -> (Vec<T>, [usize; 2], [usize; 2]) {
        let cols = self.sensor.width.div_ceil(cell[1]);
        let size = Orientation::turned(cell, self.orientation.transposes());
        let grid = [self.frame.height.div_ceil(size[0]), self.frame.width.div_ceil(size[1])];
        let corners = |axis: usize, number: usize| {
            let [first, end] = [number * size[axis], [self.frame.height, self.frame.width][axis]];
            [first, (first + size[axis]).min(end) - 1].map(|at| at + self.before[axis])
        };
        let value = |row: usize, col: usize| {
            let [ys, xs] = [corners(0, row), corners(1, col)];
            let at = ys.iter().flat_map(|&y| xs.map(|x| self.sensor_pixel(y, x)));
            let cells = at.map(|pixel| {
                let [v, u] = [pixel / self.sensor.width, pixel % self.sensor.width];
                values[v / cell[0] * cols + u / cell[1]]
            });
            cells.max().expect("a cell has corners")
        };
        let found = (0..grid[0]).flat_map(|row| (0..grid[1]).map(move |col| (row, col)));
        (found.map(|(row, col)| value(row, col)).collect(), grid, size)
    }

    /// The recording's result in one of the sensor.
    pub fn result(&self, result: ResultFrame) -> ResultFrame {
        if self.whole {
            return result;
        }
        let frame = Arc::new(self.lifted(&result.frame));
        let size = Orientation::turned(result.cell, self.orientation.transposes());
        let computed = result.computed.map(|(active, slab)| {
            let (cells, [rows, cols], _) = self.cells(result.cell, active.slab(slab));
            (Arc::new(Active::new([1, rows, cols], |cell| cells[cell])), 0)
        });
        ResultFrame { frame, computed, cell: size, ..result }
    }

    /// What was skipped of the recording's frames.
    pub fn skipped(&self, skipped: Skipped) -> Skipped {
        if self.whole {
            return skipped;
        }
        let (computed, grid, cell) = self.cells(skipped.cell, &skipped.computed);
        Skipped { cell, computed, grid, ..skipped }
    }

    /// What is known of the sensor's frames, if `recording` has those that lie in them. Its defects are filled by then.
    pub fn recording(&self, recording: &Recording) -> Recording {
        if self.whole {
            return recording.clone();
        }
        let Extent { height, width } = self.sensor;
        Recording { pattern: recording.sensor_pattern(), height, width, defects: None, ..recording.clone() }
    }
}

/// A source of the sensor's frames, which shows what one of a recording's does.
pub struct Laid<'a> {
    source: &'a mut dyn Source,
    place: OnSensor,
    recording: Recording,
}

impl<'a> Laid<'a> {
    pub fn new(source: &'a mut dyn Source, place: OnSensor) -> Self {
        let recording = place.recording(source.recording());
        Self { source, place, recording }
    }
}

impl Source for Laid<'_> {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    fn frames(&self) -> Option<usize> {
        self.source.frames()
    }

    fn next(&mut self) -> Result<Option<Frame>> {
        let frame = self.source.next()?;
        Ok(if self.place.whole { frame } else { frame.map(|frame| self.place.laid(&frame)) })
    }
}

//! Where a picture is on the screen: zoom and pan, the same for all panes.

use std::ops::Range;

use serde::{Deserialize, Serialize};

/// Least and largest zoom, in points per pixel.
const ZOOM: [f32; 2] = [1.0 / 64.0, 256.0];

/// How all panes look at their pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Look {
    /// Points per pixel; `None` fits the picture into the pane.
    pub zoom: Option<f32>,
    /// The place of the picture, [x, y] in pixels, in the middle of the pane, where there is a zoom.
    pub centre: [f32; 2],
}

/// A picture in a pane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Points per pixel.
    pub scale: f32,
    /// Where the picture's top left corner is, [x, y] in points from the pane's.
    pub origin: [f32; 2],
}

/// A part of a picture: every `stride`-th row and column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Rows.
    pub rows: Range<usize>,
    /// Columns.
    pub cols: Range<usize>,
    /// Pixels from one that is shown to the next.
    pub stride: usize,
}

impl Part {
    /// Rows and columns that are shown.
    pub fn extent(&self) -> [usize; 2] {
        [self.rows.len().div_ceil(self.stride), self.cols.len().div_ceil(self.stride)]
    }
}

impl Look {
    /// Places a picture of [rows, columns] in a pane of [width, height] points.
    pub fn place(self, [height, width]: [usize; 2], pane: [f32; 2]) -> Placement {
        let size = [width as f32, height as f32];
        let fit = (pane[0] / size[0].max(1.0)).min(pane[1] / size[1].max(1.0));
        let scale = self.zoom.unwrap_or(fit).clamp(ZOOM[0], ZOOM[1]);
        let centre = if self.zoom.is_some() { self.centre } else { size.map(|s| 0.5 * s) };
        Placement { scale, origin: std::array::from_fn(|i| 0.5 * pane[i] - centre[i] * scale) }
    }

    /// Zooms by `factor`; what is under `at` (in points from the pane's corner) stays there.
    pub fn zoom_by(&mut self, factor: f32, at: [f32; 2], extent: [usize; 2], pane: [f32; 2]) {
        let before = self.place(extent, pane);
        let scale = (before.scale * factor).clamp(ZOOM[0], ZOOM[1]);
        if !scale.is_finite() {
            return;
        }
        let under = before.to_picture(at);
        self.zoom = Some(scale);
        self.centre = std::array::from_fn(|i| under[i] + (0.5 * pane[i] - at[i]) / scale);
        self.keep_within(extent);
    }

    /// Moves the picture by points. A fitted picture stays.
    pub fn pan(&mut self, by: [f32; 2], extent: [usize; 2]) {
        if let Some(zoom) = self.zoom {
            self.centre = std::array::from_fn(|i| self.centre[i] - by[i] / zoom);
            self.keep_within(extent);
        }
    }

    /// The middle of a pane always shows some of the picture.
    fn keep_within(&mut self, [height, width]: [usize; 2]) {
        let size = [width as f32, height as f32];
        self.centre = std::array::from_fn(|i| self.centre[i].clamp(0.0, size[i]));
    }
}

impl Placement {
    /// The place in the picture, [x, y] in pixels, of a point of the pane.
    pub fn to_picture(self, point: [f32; 2]) -> [f32; 2] {
        std::array::from_fn(|i| (point[i] - self.origin[i]) / self.scale)
    }

    /// The point of the pane of a place in the picture.
    pub fn to_pane(self, place: [f32; 2]) -> [f32; 2] {
        std::array::from_fn(|i| self.origin[i] + place[i] * self.scale)
    }

    /// The row and column at a point of the pane, if it lies in a picture of `extent`.
    pub fn pixel(self, point: [f32; 2], [height, width]: [usize; 2]) -> Option<[usize; 2]> {
        let [x, y] = self.to_picture(point);
        let within = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
        within.then_some([y as usize, x as usize])
    }

    /// The part of a picture of `extent` that a pane of [width, height] points shows, at `density` pixels of the screen
    /// per point; `None` if it shows nothing of it.
    pub fn part(self, [height, width]: [usize; 2], pane: [f32; 2], density: f32) -> Option<Part> {
        let stride = (1.0 / (self.scale * density.max(0.1))).floor().clamp(1.0, 1024.0) as usize;
        let [left, top] = self.to_picture([0.0, 0.0]);
        let [right, bottom] = self.to_picture(pane);
        let range = |from: f32, to: f32, len: usize| {
            let first = (from.floor().max(0.0) as usize).min(len) / stride * stride;
            let last = ((to.ceil().max(0.0) as usize).min(len)).next_multiple_of(stride).min(len);
            first..last
        };
        let part = Part { rows: range(top, bottom, height), cols: range(left, right, width), stride };
        (!part.rows.is_empty() && !part.cols.is_empty()).then_some(part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fitted_picture_is_whole_and_in_the_middle() {
        let placement = Look::default().place([100, 200], [400.0, 400.0]);
        assert_eq!(placement, Placement { scale: 2.0, origin: [0.0, 100.0] });
        let part = placement.part([100, 200], [400.0, 400.0], 1.0).unwrap();
        assert_eq!(part, Part { rows: 0..100, cols: 0..200, stride: 1 });
        assert_eq!(placement.pixel([10.0, 99.0], [100, 200]), None);
        assert_eq!(placement.pixel([10.0, 101.0], [100, 200]), Some([0, 5]));
    }

    #[test]
    fn zooming_keeps_what_is_under_the_pointer() {
        let (extent, pane) = ([100, 200], [400.0, 300.0]);
        let mut look = Look::default();
        for (factor, at) in [(3.0, [120.0, 80.0]), (2.0, [300.0, 200.0]), (0.7, [10.0, 140.0])] {
            let before = look.place(extent, pane).to_picture(at);
            look.zoom_by(factor, at, extent, pane);
            let after = look.place(extent, pane).to_picture(at);
            assert!((0..2).all(|i| (before[i] - after[i]).abs() < 1e-3), "{before:?} {after:?}");
        }
    }

    #[test]
    fn a_picture_can_not_be_lost() {
        let (extent, pane) = ([100, 200], [400.0, 300.0]);
        let mut look = Look { zoom: Some(4.0), centre: [100.0, 50.0] };
        for _ in 0..50 {
            look.pan([-1e4, 3e3], extent);
        }
        assert!(look.place(extent, pane).part(extent, pane, 1.0).is_some());
        for factor in [1e9, 1e-9, f32::NAN] {
            look.zoom_by(factor, [0.0, 0.0], extent, pane);
            assert!(look.zoom.unwrap().is_finite());
        }
        for pane in [[0.0, 0.0], [1.0, 1e5]] {
            // Anything but a panic.
            let _ = Look::default().place(extent, pane).part(extent, pane, 1.0);
        }
    }

    #[test]
    fn only_what_is_seen_is_shown_and_no_finer_than_the_screen() {
        let look = Look { zoom: Some(8.0), centre: [50.0, 50.0] };
        let part = look.place([1000, 1000], [80.0, 160.0]).part([1000, 1000], [80.0, 160.0], 1.0).unwrap();
        assert_eq!((part.rows, part.cols), (40..60, 45..55));
        let small = Look::default().place([4000, 8000], [1000.0, 500.0]);
        let part = small.part([4000, 8000], [1000.0, 500.0], 2.0).unwrap();
        assert_eq!((part.stride, part.extent()), (4, [1000, 2000]));
    }
}

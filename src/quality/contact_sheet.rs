//! Contact sheets: labelled pictures, methods below each other, frames side by side.

use std::path::Path;

use super::canvas::{BLACK, Canvas, INK, Surface, WHITE, text_height, text_width};
use crate::Result;
use crate::frame::Plane;
use crate::video::{ToneRange, VideoError};

const SCALE: usize = 2;
const MARGIN: usize = 12;
const GAP: usize = 8;
/// Pixels below which panels are not made smaller.
const LEAST: usize = 1 << 12;

/// One grey picture of a sheet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Panel {
    /// Columns.
    pub width: usize,
    /// 8-bit grey values [y, x].
    pub pixels: Vec<u8>,
}

impl Panel {
    /// A frame of irradiance under the tone curve, between black and white.
    pub fn toned(frame: Plane<'_>, levels: ToneRange) -> Self {
        let pixels = frame.values().iter().map(|&p| levels.byte(p)).collect();
        Self { width: frame.extent().width, pixels }
    }

    fn height(&self) -> usize {
        self.pixels.len().div_ceil(self.width.max(1))
    }

    /// Means over blocks of 2×2 pixels.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height().div_ceil(2));
        let mean = |y: usize, x: usize| {
            let rows = 2 * y..(2 * y + 2).min(self.height());
            let block = rows.flat_map(|y| (2 * x..(2 * x + 2).min(self.width)).map(move |x| (y, x)));
            let (sum, count) = block
                .filter_map(|(y, x)| self.pixels.get(y * self.width + x))
                .fold((0, 0), |(sum, count), &pixel| (sum + u32::from(pixel), count + 1));
            ((sum + count / 2) / count.max(1)) as u8
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| mean(y, x))).collect();
        Self { width, pixels }
    }
}

/// A sheet of labelled rows of panels.
#[derive(Clone, Debug, Default)]
pub struct ContactSheet {
    zoom: usize,
    columns: Vec<String>,
    rows: Vec<(String, Vec<Panel>)>,
}

impl ContactSheet {
    /// An empty sheet on which each pixel of a panel becomes `zoom`×`zoom` (at least 1).
    pub fn new(zoom: usize) -> Self {
        Self { zoom: zoom.max(1), ..Self::default() }
    }

    /// Headings above the columns.
    #[must_use]
    pub fn columns(mut self, headings: impl IntoIterator<Item = impl Into<String>>) -> Self {
        self.columns = headings.into_iter().map(Into::into).collect();
        self
    }

    /// A row of panels.
    #[must_use]
    pub fn row(mut self, label: impl Into<String>, panels: impl IntoIterator<Item = Panel>) -> Self {
        self.rows.push((label.into(), panels.into_iter().collect()));
        self
    }

    /// The same sheet with panels half as wide and high.
    fn halved(&self) -> Self {
        let half = |(label, panels): &(String, Vec<Panel>)| {
            (label.clone(), panels.iter().map(Panel::halved).collect())
        };
        Self { rows: self.rows.iter().map(half).collect(), ..self.clone() }
    }

    /// Draws the sheet; an error if it would have no pixels. Panels are made smaller where it would have too many.
    pub fn draw(&self) -> Result<Canvas, VideoError> {
        let largest = self.rows.iter().flat_map(|(_, panels)| panels).map(|panel| panel.pixels.len()).max();
        let drawn = self.draw_whole();
        if drawn.is_err() && largest > Some(LEAST) { self.halved().draw() } else { drawn }
    }

    fn draw_whole(&self) -> Result<Canvas, VideoError> {
        let size = |n: usize| n.saturating_mul(self.zoom);
        let line = text_height(SCALE);
        let label_width =
            self.rows.iter().map(|(label, _)| text_width(label, SCALE)).max().unwrap_or(0) + GAP;
        let count = self.rows.iter().map(|(_, panels)| panels.len()).max().unwrap_or(0);
        if count == 0 {
            return Err(VideoError::Shape("a contact sheet without pictures cannot be drawn".into()));
        }
        let widths: Vec<usize> = (0..count)
            .map(|i| {
                let panels = self.rows.iter().filter_map(|(_, panels)| panels.get(i));
                let panel = panels.map(|panel| size(panel.width)).max().unwrap_or(0);
                panel.max(self.columns.get(i).map_or(0, |heading| text_width(heading, SCALE)))
            })
            .collect();
        let heights: Vec<usize> = self
            .rows
            .iter()
            .map(|(_, panels)| panels.iter().map(|panel| size(panel.height())).max().unwrap_or(0).max(line))
            .collect();
        let total = |sizes: &[usize], extra: usize| {
            let start = 2 * MARGIN + extra + GAP * sizes.len().saturating_sub(1);
            sizes.iter().fold(start, |sum, size| sum.saturating_add(*size))
        };
        let heading = if self.columns.is_empty() { 0 } else { line + GAP };
        let mut canvas = Canvas::new(total(&widths, label_width), total(&heights, heading), WHITE)?;

        let lefts: Vec<usize> = places(MARGIN + label_width, &widths);
        for (heading, left) in self.columns.iter().zip(&lefts) {
            canvas.text(*left as i64, MARGIN as i64, heading, SCALE, INK);
        }
        let tops = places(MARGIN + heading, &heights);
        for (((label, panels), top), height) in self.rows.iter().zip(tops).zip(&heights) {
            canvas.text(MARGIN as i64, (top + height / 2 - line / 2) as i64, label, SCALE, BLACK);
            for (panel, left) in panels.iter().zip(&lefts) {
                canvas.grey(*left as i64, top as i64, &panel.pixels, panel.width, self.zoom);
            }
        }
        Ok(canvas)
    }

    /// Draws the sheet and writes it as PNG.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        self.draw()?.write(path)
    }
}

/// Where things of the given sizes begin if the first one is at `start`.
fn places(start: usize, sizes: &[usize]) -> Vec<usize> {
    let mut at = start;
    let place = |size: &usize| {
        let place = at;
        at += size + GAP;
        place
    };
    sizes.iter().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of 66,000×66,000 pixels, which comes of two thin panels.
    #[test]
    fn panels_that_are_too_large_are_made_smaller() {
        let panel = |len: usize, width: usize| Panel {
            width,
            pixels: (0..len).map(|i| if i < 8 { 200 } else { 40 }).collect(),
        };
        let canvas = ContactSheet::new(1).row("", [panel(66_000, 66_000), panel(66_000, 1)]).draw().unwrap();
        assert_eq!(canvas.height(), 2 * MARGIN + 66_000 / 8);
        assert_eq!(canvas.width(), 2 * MARGIN + GAP + 66_000 / 8 + GAP + 1);
        // A mean of eight pixels, in either direction.
        let grey = |x: usize, y: usize| canvas.pixels()[y * canvas.width() + x][0];
        let (left, right) = (MARGIN + GAP, MARGIN + GAP + 66_000 / 8 + GAP);
        assert_eq!([grey(left, MARGIN), grey(left + 1, MARGIN)], [200, 40]);
        assert_eq!([grey(right, MARGIN), grey(right, MARGIN + 1)], [200, 40]);
    }

    #[test]
    fn panels_are_where_they_belong() {
        let panel = |p: f32| Panel::toned(Plane::new([2, 3], &[p; 6]), ToneRange::WHOLE);
        // l(p) = 0.2.
        let (bright, dark) = (panel(1.0), panel(((0.2 * 5001_f64.ln()).exp_m1() / 5000.0) as f32));
        let sheet = ContactSheet::new(20).row("ours", [bright.clone(), bright]);
        let sheet = sheet.row("mosaic", [dark.clone(), dark]);
        let canvas = sheet.columns(["0 ms", "1 ms"]).draw().unwrap();
        let label = 6 * 16 + GAP;
        let heading = 16 + GAP;
        // "0 ms" is 64 wide, a panel 60 wide and 40 high.
        assert_eq!(canvas.width(), 2 * MARGIN + label + 64 + GAP + 64);
        assert_eq!(canvas.height(), 2 * MARGIN + heading + 40 + GAP + 40);
        let pixel = |x: usize, y: usize| canvas.pixels()[y * canvas.width() + x];
        let (left, top) = (MARGIN + label, MARGIN + heading + 40 + GAP);
        assert_eq!(pixel(left, top), [51; 3]);
        assert_eq!(pixel(left + 59, top + 39), [51; 3]);
        assert_eq!(pixel(left + 60, top), WHITE);
        assert_eq!(pixel(left + 64 + GAP, top), [51; 3]);
    }

    #[test]
    fn sheets_that_cannot_be_drawn_are_refused() {
        assert!(ContactSheet::new(1).draw().is_err());
        assert!(ContactSheet::new(1).row("empty", []).draw().is_err());
        let huge = ContactSheet::new(usize::MAX).row("huge", [Panel { width: 2, pixels: vec![0; 4] }]);
        assert!(huge.draw().is_err());
        let odd = ContactSheet::new(1).row("odd", [Panel { width: 0, pixels: vec![1, 2] }]);
        assert!(odd.draw().is_ok());
    }
}

//! Plots of several series over a common axis, such as one pixel's irradiance over time.

use std::path::Path;

use super::canvas::{Canvas, Colour, INK, RULE, WHITE, text_height, text_width};
use crate::Result;
use crate::video::VideoError;

const SCALE: usize = 2;
const MARGIN: usize = 16;
const TICK: usize = 8;
const SAMPLE: usize = 36;
const THICKNESS: f32 = 2.5;

/// Colours that the colour-blind can tell apart (Okabe and Ito), the ones with contrast to white first.
const PALETTE: [Colour; 7] =
    [[0, 0, 0], [213, 94, 0], [0, 114, 178], [0, 158, 115], [204, 121, 167], [230, 159, 0], [86, 180, 233]];

/// A plot: axes, ticks, a legend and one line for each series.
#[derive(Clone, Debug, Default)]
pub struct Plot {
    title: String,
    x_label: String,
    y_label: String,
    series: Vec<(String, Vec<(f64, f64)>)>,
}

impl Plot {
    /// An empty plot. Labels name quantity and unit, such as `time (ms)`.
    pub fn new(title: impl Into<String>, x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self { title: title.into(), x_label: x_label.into(), y_label: y_label.into(), series: Vec::new() }
    }

    /// A line through points (x, y); it is broken where one is not finite.
    #[must_use]
    pub fn series(mut self, name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.series.push((name.into(), points.into_iter().collect()));
        self
    }

    /// A line through values that are `step` apart, the first one at 0.
    #[must_use]
    pub fn time_series(
        self,
        name: impl Into<String>,
        step: f64,
        values: impl IntoIterator<Item = f32>,
    ) -> Self {
        let point = |(i, value): (usize, f32)| (i as f64 * step, f64::from(value));
        let points: Vec<_> = values.into_iter().enumerate().map(point).collect();
        self.series(name, points)
    }

    /// Draws the plot; an error if it is too small for its texts.
    pub fn draw(&self, width: usize, height: usize) -> Result<Canvas, VideoError> {
        let line = text_height(SCALE);
        let x_axis = Axis::over(self.points().map(|point| point.0), (width / 140).max(2));
        let y_axis = Axis::over(self.points().map(|point| point.1), (height / 80).max(2));

        let legend = self.legend(width.saturating_sub(2 * MARGIN));
        let legend_height: usize = legend.iter().map(|row| row.1).max().map_or(0, |top| top + line + TICK);
        let tick_width = y_axis.ticks().map(|tick| text_width(&y_axis.label(tick), SCALE)).max().unwrap_or(0);
        let title_height = if self.title.is_empty() { 0 } else { line + TICK };
        let left = MARGIN + tick_width + 2 * TICK;
        // The axis' label, and half of the topmost tick's.
        let top = MARGIN + title_height + legend_height + line + TICK + line / 2;
        // Half of the last tick's label stands out to the right.
        let last_label = x_axis.ticks().last().map_or(0, |tick| text_width(&x_axis.label(tick), SCALE));
        let right = width.saturating_sub(MARGIN + last_label / 2);
        let bottom = height.saturating_sub(MARGIN + 2 * line + 3 * TICK);
        if right < left + line || bottom < top + line {
            return Err(VideoError::Shape(format!("{width}×{height} pixels are too few for this plot")));
        }
        let mut canvas = Canvas::new(width, height, WHITE)?;
        let frame = Frame { left, right, top, bottom, x_axis, y_axis };

        canvas.text(MARGIN as i64, MARGIN as i64, &self.title, SCALE, INK);
        for ((x, y), (index, (name, _))) in legend.iter().zip(self.series.iter().enumerate()) {
            let (x, y) = (MARGIN + x, MARGIN + title_height + y);
            let middle = (y + line / 2) as f32;
            let colour = PALETTE[index % PALETTE.len()];
            canvas.line((x as f32, middle), ((x + SAMPLE) as f32, middle), 2.0 * THICKNESS, colour);
            canvas.text((x + SAMPLE + TICK) as i64, y as i64, name, SCALE, INK);
        }
        frame.draw(&mut canvas, &self.x_label, &self.y_label);
        for (index, (_, points)) in self.series.iter().enumerate() {
            let colour = PALETTE[index % PALETTE.len()];
            for pair in points.windows(2) {
                canvas.line(frame.place(pair[0]), frame.place(pair[1]), THICKNESS, colour);
            }
            for (i, &point) in points.iter().enumerate() {
                let alone = |other: Option<&(f64, f64)>| other.is_none_or(|p| !is_finite(*p));
                if alone(i.checked_sub(1).and_then(|i| points.get(i))) && alone(points.get(i + 1)) {
                    canvas.line(frame.place(point), frame.place(point), 3.0 * THICKNESS, colour);
                }
            }
        }
        Ok(canvas)
    }

    /// Draws the plot and writes it as PNG.
    pub fn write(&self, path: impl AsRef<Path>, width: usize, height: usize) -> Result<()> {
        self.draw(width, height)?.write(path)
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.series.iter().flat_map(|(_, points)| points).copied().filter(|point| is_finite(*point))
    }

    /// Places of the legend's entries, in as many lines as the width asks for.
    fn legend(&self, width: usize) -> Vec<(usize, usize)> {
        let (mut x, mut y) = (0, 0);
        let entry = |(name, _): &(String, _)| {
            let needed = SAMPLE + TICK + text_width(name, SCALE) + 2 * MARGIN;
            if x > 0 && x + needed - 2 * MARGIN > width {
                (x, y) = (0, y + text_height(SCALE) + TICK);
            }
            let place = (x, y);
            x += needed;
            place
        };
        self.series.iter().map(entry).collect()
    }
}

fn is_finite((x, y): (f64, f64)) -> bool {
    x.is_finite() && y.is_finite()
}

/// Where the plot lies on the canvas.
struct Frame {
    left: usize,
    right: usize,
    top: usize,
    bottom: usize,
    x_axis: Axis,
    y_axis: Axis,
}

impl Frame {
    fn place(&self, (x, y): (f64, f64)) -> (f32, f32) {
        let along =
            |share: f64, from: usize, to: usize| (from as f64 + share * (to as f64 - from as f64)) as f32;
        let x = along(self.x_axis.share(x), self.left, self.right);
        (x, along(self.y_axis.share(y), self.bottom, self.top))
    }

    /// Grid, ticks and labels.
    fn draw(&self, canvas: &mut Canvas, x_label: &str, y_label: &str) {
        let Self { left, right, top, bottom, x_axis, y_axis } = self;
        let line = text_height(SCALE);
        for tick in y_axis.ticks() {
            let y = self.place((0.0, tick)).1;
            canvas.fill(*left as i64, y.round() as i64, right - left, 1, RULE);
            canvas.fill((left - TICK) as i64, y.round() as i64, TICK, 2, INK);
            let label = y_axis.label(tick);
            let x = left - 2 * TICK - text_width(&label, SCALE);
            canvas.text(x as i64, y.round() as i64 - line as i64 / 2, &label, SCALE, INK);
        }
        for tick in x_axis.ticks() {
            let x = self.place((tick, 0.0)).0.round() as i64;
            canvas.fill(x, *top as i64, 1, bottom - top, RULE);
            canvas.fill(x, *bottom as i64, 2, TICK, INK);
            let label = x_axis.label(tick);
            let x = x - text_width(&label, SCALE) as i64 / 2;
            canvas.text(x, (bottom + 2 * TICK) as i64, &label, SCALE, INK);
        }
        canvas.fill(*left as i64, *top as i64, 2, bottom - top, INK);
        canvas.fill(*left as i64, *bottom as i64, right - left, 2, INK);
        canvas.text(MARGIN as i64, (top - line - TICK - line / 2) as i64, y_label, SCALE, INK);
        let x = (left + right) / 2 - (text_width(x_label, SCALE) / 2).min((left + right) / 2);
        canvas.text(x as i64, (bottom + line + 3 * TICK) as i64, x_label, SCALE, INK);
    }
}

/// A linear axis with ticks at round numbers.
struct Axis {
    low: f64,
    high: f64,
    /// Distance of ticks: 1, 2 or 5 times a power of ten.
    step: f64,
}

impl Axis {
    /// The axis over all values, with about `count` ticks; both ends are ticks.
    fn over(values: impl Iterator<Item = f64>, count: usize) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in values {
            // Beyond that, the distances would overflow.
            let value = value.clamp(-1e300, 1e300);
            low = low.min(value);
            high = high.max(value);
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        // An axis of one value gets some room, above the resolution of the numbers themselves.
        let least = low.abs().max(high.abs()).max(1e-300) * 1e-6;
        if high - low < least {
            (low, high) =
                if low == 0.0 { (0.0, 1.0) } else { (low - low.abs() / 2.0, high + high.abs() / 2.0) };
        }
        let raw = (high - low) / count.max(1) as f64;
        let power = 10.0_f64.powf(raw.log10().floor());
        let factor = [1.0, 2.0, 5.0].into_iter().find(|factor| factor * power >= raw * 0.999).unwrap_or(10.0);
        let step = factor * power;
        Self { low: (low / step + 1e-6).floor() * step, high: (high / step - 1e-6).ceil() * step, step }
    }

    fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    fn ticks(&self) -> impl Iterator<Item = f64> + use<> {
        let (low, step) = (self.low, self.step);
        // At most twice the number asked for; the limit only guards against rounding at absurd scales.
        let count = ((self.high - self.low) / step).round().min(1000.0) as usize;
        (0..=count).map(move |i| low + i as f64 * step)
    }

    fn label(&self, tick: f64) -> String {
        let largest = self.low.abs().max(self.high.abs());
        // Ticks that rounding keeps from being zero.
        let tick = if tick.abs() < self.step * 1e-6 { 0.0 } else { tick };
        if !(1e-4..1e6).contains(&largest) {
            return format!("{tick:.1e}");
        }
        let digits = (-self.step.log10().floor()).max(0.0) as usize;
        format!("{tick:.digits$}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(values: &[f64], count: usize) -> Vec<String> {
        let axis = Axis::over(values.iter().copied(), count);
        axis.ticks().map(|tick| axis.label(tick)).collect()
    }

    #[test]
    fn ticks_are_round_numbers_around_the_values() {
        assert_eq!(labels(&[0.0, 1.0], 5), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(&[0.03, 0.19], 4), ["0.00", "0.05", "0.10", "0.15", "0.20"]);
        assert_eq!(labels(&[-3.0, 99.0], 4), ["-50", "0", "50", "100"]);
        assert_eq!(labels(&[], 2), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(&[4.0, 4.0], 4), ["2", "3", "4", "5", "6"]);
        assert_eq!(labels(&[0.0, 2e-6], 2), ["0.0e0", "1.0e-6", "2.0e-6"]);
    }

    #[test]
    fn absurd_values_are_drawn_or_refused_but_never_panic() {
        let extremes = [f64::MAX, -f64::MAX, f64::MIN_POSITIVE, 0.0, f64::NAN, f64::INFINITY, 1.0];
        for a in extremes {
            for b in extremes {
                let plot = Plot::new("", "x", "y").series("s", [(0.0, a), (1.0, b), (b, a)]);
                let _ = plot.draw(900, 500);
            }
        }
        assert!(Plot::new("", "", "").draw(800, 500).is_ok());
        assert!(Plot::new("", "", "").draw(40, 30).is_err());
        assert!(Plot::new("", "", "").draw(0, 0).is_err());
    }

    #[test]
    fn lines_have_their_colours_and_break_at_gaps() {
        let plot = Plot::new("", "time (ms)", "irradiance")
            .time_series("truth", 1.0, [0.0, 1.0])
            .series("ours", [(0.0, 0.5), (0.4, 0.5), (0.5, f64::NAN), (0.6, 0.5), (1.0, 0.5)]);
        let canvas = plot.draw(700, 500).unwrap();
        let count = |colour: Colour| canvas.pixels().iter().filter(|pixel| **pixel == colour).count();
        assert!(count(PALETTE[0]) > 100 && count(PALETTE[1]) > 100);
        let row =
            canvas.pixels().chunks(700).rfind(|row| row.iter().filter(|p| **p == PALETTE[1]).count() > 100);
        let row = row.unwrap();
        let first = row.iter().position(|p| *p == PALETTE[1]).unwrap();
        let last = row.iter().rposition(|p| *p == PALETTE[1]).unwrap();
        assert!(row[first..last].contains(&WHITE));
    }
}

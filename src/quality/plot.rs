//! Plots of several series over a common axis, such as one pixel's irradiance over time, or error over run time.

use std::path::Path;

use super::canvas::{Canvas, Colour, INK, RULE, Surface, WHITE, text_height, text_width};
use super::svg::Svg;
use crate::Result;
use crate::video::ending;
use crate::video::{VideoError, atomic};

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
    x_scale: Scale,
    series: Vec<Series>,
}

/// How values are laid out along an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Scale {
    #[default]
    Linear,
    Logarithmic,
}

#[derive(Clone, Debug)]
struct Series {
    name: String,
    points: Vec<(f64, f64)>,
    /// Texts beside the points, which are marked then.
    labels: Vec<String>,
}

impl Plot {
    /// An empty plot. Labels name quantity and unit, such as `time (ms)`.
    pub fn new(title: impl Into<String>, x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self { title: title.into(), x_label: x_label.into(), y_label: y_label.into(), ..Self::default() }
    }

    /// With a logarithmic x axis. Points with x ≤ 0 have no place on it.
    #[must_use]
    pub fn logarithmic_x(mut self) -> Self {
        self.x_scale = Scale::Logarithmic;
        self
    }

    /// A line through points (x, y); it is broken where one is not finite.
    #[must_use]
    pub fn series(mut self, name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let points = points.into_iter().collect();
        self.series.push(Series { name: name.into(), points, labels: Vec::new() });
        self
    }

    /// A line through marked points (x, y), each with a text beside it.
    #[must_use]
    pub fn marked_series(
        mut self,
        name: impl Into<String>,
        points: impl IntoIterator<Item = (String, (f64, f64))>,
    ) -> Self {
        let (labels, points) = points.into_iter().unzip();
        self.series.push(Series { name: name.into(), points, labels });
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
        let mut canvas = Canvas::new(width, height, WHITE)?;
        self.draw_on(&mut canvas, width, height)?;
        Ok(canvas)
    }

    /// Draws the plot as a vector picture (SVG); an error if it is too small for its texts.
    pub fn draw_svg(&self, width: usize, height: usize) -> Result<String, VideoError> {
        let mut svg = Svg::new(width, height);
        self.draw_on(&mut svg, width, height)?;
        Ok(svg.finish())
    }

    /// Draws the plot and writes it as SVG if the name ends so, else as PNG.
    pub fn write(&self, path: impl AsRef<Path>, width: usize, height: usize) -> Result<()> {
        let path = path.as_ref();
        if ending(path) == "svg" {
            return atomic::write_bytes(path, self.draw_svg(width, height)?.as_bytes());
        }
        self.draw(width, height)?.write(path)
    }

    fn draw_on(&self, surface: &mut impl Surface, width: usize, height: usize) -> Result<(), VideoError> {
        let line = text_height(SCALE);
        let x_axis = Axis::over(self.points().map(|point| point.0), (width / 140).max(2), self.x_scale);
        let y_axis = Axis::over(self.points().map(|point| point.1), (height / 80).max(2), Scale::Linear);

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
        let axes = Axes { left, right, top, bottom, x_axis, y_axis };

        surface.text(MARGIN as i64, MARGIN as i64, &self.title, SCALE, INK);
        for ((x, y), (index, series)) in legend.iter().zip(self.series.iter().enumerate()) {
            let (x, y) = (MARGIN + x, MARGIN + title_height + y);
            let middle = (y + line / 2) as f32;
            let colour = PALETTE[index % PALETTE.len()];
            surface.line((x as f32, middle), ((x + SAMPLE) as f32, middle), 2.0 * THICKNESS, colour);
            surface.text((x + SAMPLE + TICK) as i64, y as i64, &series.name, SCALE, INK);
        }
        axes.draw(surface, &self.x_label, &self.y_label);
        for (index, Series { points, labels, .. }) in self.series.iter().enumerate() {
            let colour = PALETTE[index % PALETTE.len()];
            for pair in points.windows(2) {
                surface.line(axes.point(pair[0]), axes.point(pair[1]), THICKNESS, colour);
            }
            for (i, &point) in points.iter().enumerate() {
                let alone = |other: Option<&(f64, f64)>| other.is_none_or(|p| !self.has_place(*p));
                if labels.is_empty()
                    && alone(i.checked_sub(1).and_then(|i| points.get(i)))
                    && alone(points.get(i + 1))
                {
                    surface.line(axes.point(point), axes.point(point), 3.0 * THICKNESS, colour);
                }
            }
            for (&point, label) in points.iter().zip(labels).filter(|(point, _)| self.has_place(**point)) {
                let (x, y) = axes.point(point);
                surface.line((x, y), (x, y), 5.0 * THICKNESS, colour);
                // To the right of the mark, unless the picture ends there.
                let (after, text) = (x as usize + 2 * TICK, text_width(label, SCALE));
                let x =
                    if after + text <= width { after } else { (x as usize).saturating_sub(text + 2 * TICK) };
                surface.text(x as i64, y as i64 - line as i64 - 2, label, SCALE, colour);
            }
        }
        Ok(())
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let all = self.series.iter().flat_map(|series| &series.points).copied();
        all.filter(|point| self.has_place(*point))
    }

    fn has_place(&self, (x, y): (f64, f64)) -> bool {
        x.is_finite() && y.is_finite() && (self.x_scale == Scale::Linear || x > 0.0)
    }

    /// Places of the legend's entries, in as many lines as the width asks for.
    fn legend(&self, width: usize) -> Vec<(usize, usize)> {
        let (mut x, mut y) = (0, 0);
        let entry = |series: &Series| {
            let needed = SAMPLE + TICK + text_width(&series.name, SCALE) + 2 * MARGIN;
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

/// Where the plot lies on the canvas.
struct Axes {
    left: usize,
    right: usize,
    top: usize,
    bottom: usize,
    x_axis: Axis,
    y_axis: Axis,
}

impl Axes {
    fn point(&self, (x, y): (f64, f64)) -> (f32, f32) {
        let along =
            |share: f64, from: usize, to: usize| (from as f64 + share * (to as f64 - from as f64)) as f32;
        let x = along(self.x_axis.share(x), self.left, self.right);
        (x, along(self.y_axis.share(y), self.bottom, self.top))
    }

    /// Grid, ticks and labels.
    fn draw(&self, surface: &mut impl Surface, x_label: &str, y_label: &str) {
        let Self { left, right, top, bottom, x_axis, y_axis } = self;
        let line = text_height(SCALE);
        for tick in y_axis.ticks() {
            let y = self.point((x_axis.low, tick)).1;
            surface.fill(*left as i64, y.round() as i64, right - left, 1, RULE);
            surface.fill((left - TICK) as i64, y.round() as i64, TICK, 2, INK);
            let label = y_axis.label(tick);
            let x = left - 2 * TICK - text_width(&label, SCALE);
            surface.text(x as i64, y.round() as i64 - line as i64 / 2, &label, SCALE, INK);
        }
        for tick in x_axis.ticks() {
            let x = self.point((tick, 0.0)).0.round() as i64;
            surface.fill(x, *top as i64, 1, bottom - top, RULE);
            surface.fill(x, *bottom as i64, 2, TICK, INK);
            let label = x_axis.label(tick);
            let x = x - text_width(&label, SCALE) as i64 / 2;
            surface.text(x, (bottom + 2 * TICK) as i64, &label, SCALE, INK);
        }
        surface.fill(*left as i64, *top as i64, 2, bottom - top, INK);
        surface.fill(*left as i64, *bottom as i64, right - left, 2, INK);
        surface.text(MARGIN as i64, (top - line - TICK - line / 2) as i64, y_label, SCALE, INK);
        let x = (left + right) / 2 - (text_width(x_label, SCALE) / 2).min((left + right) / 2);
        surface.text(x as i64, (bottom + line + 3 * TICK) as i64, x_label, SCALE, INK);
    }
}

/// An axis with ticks at round numbers.
struct Axis {
    low: f64,
    high: f64,
    scale: Scale,
    /// Distance of ticks: 1, 2 or 5 times a power of ten. On a logarithmic axis, ticks are 1, 2 and 5 times each power
    /// of ten, or every so many powers if this is not 0.
    step: f64,
}

impl Axis {
    /// The axis over all values, with about `count` ticks; both ends are ticks.
    fn over(values: impl Iterator<Item = f64>, count: usize, scale: Scale) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in values {
            // Beyond that, the distances would overflow.
            let value = value.clamp(-1e300, 1e300);
            low = low.min(value);
            high = high.max(value);
        }
        match scale {
            Scale::Linear => Self::linear(low, high, count),
            Scale::Logarithmic => Self::logarithmic(low, high, count),
        }
    }

    fn linear(mut low: f64, mut high: f64, count: usize) -> Self {
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
        let (low, high) = ((low / step + 1e-6).floor() * step, (high / step - 1e-6).ceil() * step);
        Self { low, high, scale: Scale::Linear, step }
    }

    /// Of positive values.
    fn logarithmic(mut low: f64, mut high: f64, count: usize) -> Self {
        if low > high {
            (low, high) = (1.0, 10.0);
        }
        // Some room to both sides, for the marks.
        let exponents = ((low.max(1e-300) / 1.1).log10(), (high.max(1e-300) * 1.1).log10());
        let decades = exponents.1 - exponents.0;
        // 1, 2, 5 times each power, or whole powers.
        let step = if 3.0 * decades <= 2.0 * count as f64 { 0.0 } else { (decades / count as f64).ceil() };
        let round = |exponent: f64, up: bool| {
            let unit = step.max(1.0);
            let whole = (exponent / unit).floor() * unit;
            let steps: &[f64] = if step > 0.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
            let mut ticks = steps.iter().map(|factor| factor * 10_f64.powf(whole));
            let next = 10_f64.powf(whole + unit);
            let value = 10_f64.powf(exponent);
            if up {
                ticks.chain([next]).find(|tick| *tick >= value * 0.999).unwrap_or(next)
            } else {
                ticks.rfind(|tick| *tick <= value * 1.001).unwrap_or(value)
            }
        };
        let (low, high) = (round(exponents.0, false), round(exponents.1, true));
        Self { low, high, scale: Scale::Logarithmic, step }
    }

    fn share(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => (value - self.low) / (self.high - self.low),
            Scale::Logarithmic => (value / self.low).ln() / (self.high / self.low).ln(),
        }
    }

    fn ticks(&self) -> impl Iterator<Item = f64> + use<> {
        // At most twice the number asked for; the limit only guards against rounding at absurd scales.
        const LIMIT: usize = 1000;
        let (low, high, step) = (self.low, self.high, self.step);
        let ticks: Vec<f64> = match self.scale {
            Scale::Linear => {
                let count = ((high - low) / step).round().min(LIMIT as f64) as usize;
                (0..=count).map(|i| low + i as f64 * step).collect()
            }
            Scale::Logarithmic => {
                let steps: &[f64] = if step > 0.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
                let first = low.log10().floor();
                let powers = (0..LIMIT).map(|i| 10_f64.powf(first + i as f64 * step.max(1.0)));
                let all = powers.flat_map(|power| steps.iter().map(move |factor| factor * power));
                all.skip_while(|tick| *tick < low * 0.999).take_while(|tick| *tick <= high * 1.001).collect()
            }
        };
        ticks.into_iter()
    }

    fn label(&self, tick: f64) -> String {
        let largest = self.low.abs().max(self.high.abs());
        // Ticks that rounding keeps from being zero.
        let tick = if self.scale == Scale::Linear && tick.abs() < self.step * 1e-6 { 0.0 } else { tick };
        if !(1e-4..1e6).contains(&largest) {
            return format!("{tick:.1e}");
        }
        // As many digits as the distance of ticks wants, which is the tick itself on a logarithmic axis.
        let distance = if self.scale == Scale::Linear { self.step } else { tick };
        let digits = (-(distance * 1.001).log10().floor()).clamp(0.0, 9.0) as usize;
        format!("{tick:.digits$}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(values: &[f64], count: usize) -> Vec<String> {
        labels_on(Scale::Linear, values, count)
    }

    fn labels_on(scale: Scale, values: &[f64], count: usize) -> Vec<String> {
        let axis = Axis::over(values.iter().copied(), count, scale);
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
    fn logarithmic_ticks_are_round_too() {
        let labels = |values: &[f64], count| labels_on(Scale::Logarithmic, values, count);
        assert_eq!(labels(&[0.03, 0.19], 4), ["0.02", "0.05", "0.1", "0.2", "0.5"]);
        assert_eq!(labels(&[1.0, 1.0], 4), ["0.5", "1", "2"]);
        assert_eq!(labels(&[0.02, 900.0], 6), ["0.01", "0.1", "1", "10", "100", "1000"]);
        assert_eq!(labels(&[], 4), ["0.5", "1", "2", "5", "10", "20"]);
    }

    #[test]
    fn marked_points_are_drawn_as_pixels_and_as_vectors() {
        let points = [("small".to_owned(), (0.5, 30.0)), ("large".to_owned(), (50.0, 40.0))];
        let plot =
            Plot::new("run time against error", "ms", "dB").logarithmic_x().marked_series("cpu", points);
        let canvas = plot.draw(700, 500).unwrap();
        assert!(canvas.pixels().iter().filter(|pixel| **pixel == PALETTE[0]).count() > 300);
        let svg = plot.draw_svg(700, 500).unwrap();
        assert!(svg.contains(">small</text>") && svg.contains(">large</text>") && svg.contains("<line"));
        assert!(plot.draw_svg(40, 30).is_err());
    }

    #[test]
    fn absurd_values_are_drawn_or_refused_but_never_panic() {
        let extremes = [f64::MAX, -f64::MAX, f64::MIN_POSITIVE, 0.0, f64::NAN, f64::INFINITY, 1.0];
        for a in extremes {
            for b in extremes {
                let plot = Plot::new("", "x", "y").series("s", [(0.0, a), (1.0, b), (b, a)]);
                let _ = plot.clone().logarithmic_x().draw_svg(900, 500);
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

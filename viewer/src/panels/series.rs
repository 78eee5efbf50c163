//! Picked pixels over time.

use eframe::egui::{Align2, Color32, FontId, Rect, Sense, Stroke, Ui, pos2, vec2};

use crate::app::Viewer;
use crate::panes::{PICKS, short};
use crate::series::Series;

/// Colours of the lines of a time series, told apart with any colour vision (Okabe and Ito); widths too.
const LINES: [(Color32, f32); 4] = [
    (Color32::from_rgb(150, 150, 150), 1.0),
    (Color32::from_rgb(230, 159, 0), 1.5),
    (Color32::from_rgb(86, 180, 233), 2.5),
    (Color32::from_rgb(0, 158, 115), 1.5),
];
/// Most frames of a time series.
const SERIES_FRAMES: usize = 512;

impl Viewer {
    pub(super) fn draw_series(&mut self, ui: &mut Ui) {
        let picks = self.state.picks.clone();
        if picks.is_empty() {
            ui.centered_and_justified(|ui| {
                ui.label("click a pixel, or press X over it, to see it over time")
            });
            return;
        }
        let Some(shown) = &self.shown else { return };
        let half = SERIES_FRAMES / 2;
        let frames = self.engine.store.between(shown.number.saturating_sub(half), shown.number + half);
        let recording = self.status.recording.clone();
        let area = ui.available_rect_before_wrap();
        ui.allocate_rect(area, Sense::hover());
        let width = area.width() / picks.len() as f32;
        for (i, pick) in picks.iter().enumerate() {
            let rect =
                Rect::from_min_size(area.min + vec2(i as f32 * width, 0.0), vec2(width - 4.0, area.height()));
            let series = Series::of(&frames, recording.as_deref(), *pick);
            draw_plot(ui, rect, *pick, PICKS[i % PICKS.len()], &series, shown.number as f64);
        }
    }
}

/// One pixel's series with what is read off them.
fn draw_plot(ui: &Ui, rect: Rect, [y, x]: [usize; 2], colour: Color32, series: &[Series], now: f64) {
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 2.0, ui.visuals().extreme_bg_color);
    let font = FontId::proportional(11.0);
    painter.text(
        rect.left_top() + vec2(4.0, 2.0),
        Align2::LEFT_TOP,
        format!("row {y}, column {x}"),
        font.clone(),
        colour,
    );
    let ranges: Vec<[f64; 2]> = series.iter().filter_map(Series::range).collect();
    let most = ranges.iter().map(|[_, most]| *most).fold(0.0, f64::max);
    let ends = series.iter().filter_map(|s| Some([s.points.first()?[0], s.points.last()?[0]]));
    let Some([first, last]) = ends.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]) else { return };
    if most <= 0.0 || last <= first {
        return;
    }
    // Readings stand in a column of their own.
    let column = (0.4 * rect.width()).min(215.0);
    let plot = Rect::from_min_max(rect.min + vec2(4.0, 18.0), rect.max - vec2(column + 4.0, 4.0));
    let at = |[t, p]: [f64; 2]| {
        pos2(
            plot.left() + plot.width() * ((t - first) / (last - first)) as f32,
            plot.bottom() - plot.height() * (p / most) as f32,
        )
    };
    painter.hline(plot.x_range(), plot.bottom(), Stroke::new(1.0, ui.visuals().weak_text_color()));
    painter.vline(at([now, 0.0]).x, plot.y_range(), Stroke::new(1.0, ui.visuals().warn_fg_color));
    for (i, line) in series.iter().enumerate() {
        let (line_colour, width) = LINES[i % LINES.len()];
        painter.line(line.points.iter().map(|point| at(*point)).collect(), Stroke::new(width, line_colour));
    }
    let left = plot.right() + 8.0;
    let small = FontId::monospace(10.0);
    painter.text(
        pos2(left, rect.top() + 2.0),
        Align2::LEFT_TOP,
        format!("{:15}TC       FD  FWHM", "frames"),
        small.clone(),
        ui.visuals().weak_text_color(),
    );
    for (i, line) in series.iter().enumerate() {
        let frames = |d: Option<f64>| d.map_or("    -".into(), |d| format!("{d:5.1}"));
        let reading = line.read().map_or(String::new(), |reading| {
            format!(
                "{:.3} {} {}",
                reading.contrast,
                frames(reading.full_duration),
                frames(reading.half_width)
            )
        });
        let top = rect.top() + 16.0 + 13.0 * i as f32;
        let (line_colour, _) = LINES[i % LINES.len()];
        painter.text(
            pos2(left, top),
            Align2::LEFT_TOP,
            format!("{:15}{reading}", line.name),
            small.clone(),
            line_colour,
        );
    }
    let note = format!("0 to p = {}; {} frames", short(most as f32), last - first + 1.0);
    painter.text(
        pos2(left, rect.bottom() - 3.0),
        Align2::LEFT_BOTTOM,
        note,
        small,
        ui.visuals().weak_text_color(),
    );
}

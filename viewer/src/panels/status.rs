//! How the engine is.

use std::time::Instant;

use eframe::egui::{Align, Align2, Color32, FontId, Layout, RichText, Sense, Stroke, Ui, pos2, vec2};

use crate::app::Viewer;
use crate::engine::{HISTORY, Phase};
use crate::pace::resident_bytes;

impl Viewer {
    pub(super) fn draw_status(&self, ui: &mut Ui) {
        let status = &self.status;
        let phase = match &status.phase {
            Phase::Preparing => "preparing",
            Phase::Running => "running",
            Phase::Finished => "all frames computed",
            Phase::Failed(_) => "failed",
        };
        ui.label(RichText::new(format!("{phase}: {}", status.executor)).small());
        let about = &status.about;
        let pattern = about.pattern.as_deref().unwrap_or("no camera");
        ui.label(RichText::new(format!("{}×{} pixels, {pattern}", about.width, about.height)).small());
        if let Some(notice) = &status.notice {
            ui.colored_label(ui.visuals().warn_fg_color, notice);
        }
        self.draw_times(ui);
        self.draw_figures(ui);
    }

    /// How fast it is, and what it takes.
    fn draw_figures(&self, ui: &mut Ui) {
        let (status, about) = (&self.status, &self.status.about);
        let now = Instant::now();
        line(
            ui,
            "net per frame (median)",
            words_of_ms(status.median_ms()),
            "time in which the net computed, per frame, as `bench` measures it",
        );
        line(
            ui,
            "frames delivered",
            format!("{:.0} /s", status.frames_per_s(now)),
            "over the last five seconds",
        );
        let live = about.frames.is_none();
        let dropped = if live { status.dropped.to_string() } else { "none (file)".into() };
        line(
            ui,
            "frames dropped",
            dropped,
            "a live camera goes on when synthesis falls behind: the oldest frames are dropped, so latency stays bounded",
        );
        let computed = status.computed.iter().sum::<f32>() / status.computed.len().max(1) as f32;
        let computed =
            if status.computed.is_empty() { "-".into() } else { format!("{:.0} %", 100.0 * computed) };
        line(ui, "cells computed", computed, "the others kept their last result (skip)");
        let drawn = if self.is_drawn_from_gpu() { "where they are" } else { "from main memory" };
        line(
            ui,
            "results drawn",
            drawn.into(),
            "where they are: on the GPU that computed them, which draws the window too (--window-device)",
        );
        let (frames, bytes) = self.engine.store.size();
        line(
            ui,
            "frames in memory",
            format!("{frames} ({} MiB)", bytes >> 20),
            "what can be scrubbed through",
        );
        if let Some(bytes) = resident_bytes() {
            line(ui, "memory of the viewer", format!("{} MiB", bytes >> 20), "resident");
        }
        if about.latency > 0 {
            let ms = about.latency as f64 * about.period_ms;
            line(
                ui,
                "least latency",
                format!("{ms:.0} ms"),
                "what any live source of this pattern costs: the longest exposure, and the frames that the net sees ahead",
            );
        }
    }

    /// Milliseconds of the net per frame over the last frames, and the part of cells that was computed.
    fn draw_times(&self, ui: &mut Ui) {
        let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 56.0), Sense::hover());
        response.on_hover_text(
            "time of the net for each of the last frames; orange: part of the cells that was computed",
        );
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 2.0, ui.visuals().extreme_bg_color);
        let times = &self.status.inference_ms;
        let most = times.iter().copied().fold(0.0_f32, f32::max);
        if times.is_empty() {
            return;
        }
        let x = |i: usize| rect.left() + rect.width() * (i as f32 + 0.5) / HISTORY as f32;
        let y = |part: f32| rect.bottom() - 2.0 - part * (rect.height() - 14.0);
        let line = |values: &mut dyn Iterator<Item = f32>| {
            values.enumerate().map(|(i, v)| pos2(x(i), y(v))).collect::<Vec<_>>()
        };
        if self.status.computed.iter().any(|part| *part < 1.0) {
            let points = line(&mut self.status.computed.iter().copied());
            painter.line(points, Stroke::new(1.0, Color32::from_rgb(230, 159, 0)));
        }
        let points = line(&mut times.iter().map(|ms| ms / most.max(1e-6)));
        painter.line(points, Stroke::new(1.5, ui.visuals().text_color()));
        let font = FontId::proportional(9.0);
        let text = format!("{most:.1} ms");
        painter.text(
            rect.left_top() + vec2(2.0, 0.0),
            Align2::LEFT_TOP,
            text,
            font,
            ui.visuals().weak_text_color(),
        );
    }
}

/// A line with a figure to the right.
fn line(ui: &mut Ui, name: &str, value: String, tip: &str) {
    ui.horizontal(|ui| {
        ui.label(RichText::new(name).small());
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            ui.label(RichText::new(value).small().monospace());
        });
    })
    .response
    .on_hover_text(tip);
}

/// Time of the net per frame.
fn words_of_ms(ms: Option<f32>) -> String {
    match ms {
        None => "-".into(),
        // Skipping left nothing to compute in most windows.
        Some(0.0) => "nothing computed".into(),
        Some(ms) if ms < 0.01 => "below 0.01 ms".into(),
        Some(ms) => format!("{ms:.2} ms"),
    }
}

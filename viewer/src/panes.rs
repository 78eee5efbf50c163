//! The panes: pictures, their names, marks and pixel values.

use std::sync::Arc;

use eframe::egui::{
    Align2, Color32, FontId, Id, Painter, Pos2, Rect, Response, Sense, Stroke, StrokeKind, Ui, Vec2, pos2,
    vec2,
};
use eframe::egui_wgpu::Callback;

use crate::action::Action;
use crate::app::Viewer;
use crate::engine::Phase;
use crate::frame::Frame;
use crate::picture::Picture;
use crate::place::{Part, Placement};
use crate::preferences::{Arrangement, Preferences};
use crate::screen::{Painting, Shown};

/// Points per pixel from which values are written into pixels.
const VALUES_FROM: f32 = 44.0;
/// Half the width of the strip where the divider is taken.
const GRIP: f32 = 6.0;
/// Colour of picked pixels, in order; told apart with any colour vision (Okabe and Ito).
pub(crate) const PICKS: [Color32; 4] = [
    Color32::from_rgb(230, 159, 0),
    Color32::from_rgb(86, 180, 233),
    Color32::from_rgb(0, 158, 115),
    Color32::from_rgb(204, 121, 167),
];

impl Viewer {
    /// Draws all panes.
    pub(crate) fn draw_panes(&mut self, ui: &mut Ui) {
        let area = ui.available_rect_before_wrap();
        if area.width() < 8.0 || area.height() < 8.0 {
            return;
        }
        ui.allocate_rect(area, Sense::hover());
        self.state.pointer = None;
        let Preferences { arrangement, divider, .. } = self.state.preferences;
        let pictures = self.state.preferences.pictures().to_vec();
        match arrangement {
            Arrangement::Divider => self.draw_divided(ui, area, [pictures[0], pictures[1]], divider),
            _ => {
                for (i, (rect, picture)) in
                    self.rects(area, pictures.len()).into_iter().zip(pictures).enumerate()
                {
                    let response = ui.interact(rect, Id::unique(("pane", i)), Sense::click_and_drag());
                    self.draw_pane(ui, rect, rect, i, picture);
                    self.handle(ui, &response, rect);
                    if i == self.state.pane {
                        let stroke = Stroke::new(1.5, ui.visuals().selection.stroke.color);
                        ui.painter().rect_stroke(rect, 0.0, stroke, StrokeKind::Inside);
                    }
                    if response.clicked() || response.drag_started() {
                        self.state.pane = i;
                    }
                }
            }
        }
        self.draw_state(ui, area);
    }

    /// Where panes are: in as many even columns as show the pictures largest.
    fn rects(&self, area: Rect, count: usize) -> Vec<Rect> {
        const GAP: f32 = 2.0;
        let [height, width] = self.shown.as_ref().map_or([1, 1], |frame| [frame.height, frame.width]);
        let size = |columns: usize| {
            let rows = count.div_ceil(columns);
            vec2(
                (area.width() - GAP * (columns - 1) as f32) / columns as f32,
                (area.height() - GAP * (rows - 1) as f32) / rows as f32,
            )
        };
        let scale = |columns: &usize| {
            let size = size(*columns);
            (size.x / width as f32).min(size.y / height as f32)
        };
        let even = (1..=count).filter(|columns| count.is_multiple_of(*columns));
        let columns = even.max_by(|a, b| scale(a).total_cmp(&scale(b))).unwrap_or(1);
        let size = size(columns);
        let corner = |i: usize| {
            area.min + vec2((i % columns) as f32 * (size.x + GAP), (i / columns) as f32 * (size.y + GAP))
        };
        (0..count).map(|i| Rect::from_min_size(corner(i), size)).collect()
    }

    fn draw_divided(&mut self, ui: &mut Ui, area: Rect, [a, b]: [Picture; 2], divider: f32) {
        let x = area.left() + divider * area.width();
        let response = ui.interact(area, Id::unique("divided"), Sense::click_and_drag());
        self.draw_pane(ui, area, Rect::from_min_max(area.min, pos2(x, area.bottom())), 0, a);
        self.draw_pane(ui, area, Rect::from_min_max(pos2(x, area.top()), area.max), 1, b);
        self.handle(ui, &response, area);
        let grip = Rect::from_min_max(pos2(x - GRIP, area.top()), pos2(x + GRIP, area.bottom()));
        let grip = ui
            .interact(grip, Id::unique("divider"), Sense::drag())
            .on_hover_text("drag to compare ([ and ])");
        if let Some(pointer) = grip.interact_pointer_pos().filter(|_| grip.dragged()) {
            self.actions.push(Action::Divider((pointer.x - area.left()) / area.width()));
        }
        if grip.hovered() || grip.dragged() {
            ui.ctx().set_cursor_icon(eframe::egui::CursorIcon::ResizeHorizontal);
        }
        let white = Stroke::new(1.5, Color32::WHITE);
        ui.painter().vline(x, area.y_range(), Stroke::new(3.5, Color32::BLACK));
        ui.painter().vline(x, area.y_range(), white);
        ui.painter().circle(pos2(x, area.center().y), 5.0, Color32::WHITE, Stroke::new(1.0, Color32::BLACK));
    }

    /// Draws a picture into `pane`, as much of it as `clip` lets be seen.
    fn draw_pane(&mut self, ui: &Ui, pane: Rect, clip: Rect, i: usize, picture: Picture) {
        let painter = ui.painter_at(clip);
        let Some(frame) = self.shown.clone() else {
            paint_black(&painter, clip, i);
            return;
        };
        let (extent, size) = ([frame.height, frame.width], [pane.width(), pane.height()]);
        self.state.drawn = (extent, size);
        let placement = self.state.look.place(extent, size);
        let density = ui.ctx().pixels_per_point();
        if !picture.is_there(&frame) {
            paint_black(&painter, clip, i);
            let text = if self.status.recording.is_none() {
                "a plain video has only its frames"
            } else if frame.ours.is_none() {
                "the first frames are being computed"
            } else {
                "there is no ground truth of this source"
            };
            painter.text(
                pane.center(),
                Align2::CENTER_CENTER,
                text,
                FontId::proportional(14.0),
                Color32::GRAY,
            );
        } else if let Some(part) = placement.part(extent, size, density) {
            let corner = placement.to_pane([part.cols.start as f32, part.rows.start as f32]);
            let [rows, cols] = part.extent();
            let step = placement.scale * part.stride as f32;
            let rect = Rect::from_min_size(
                pane.min + Vec2::from(corner),
                vec2(cols as f32 * step, rows as f32 * step),
            );
            let shown = Shown {
                frame: Arc::clone(&frame),
                picture,
                part: part.clone(),
                kinds: Arc::clone(&self.kinds),
                table: Arc::clone(&self.table),
                marked: self.state.preferences.overlay,
            };
            // Pixels are seen as such where they are large.
            let painting =
                Painting { pane: i, shown: Some(shown), rect, around: clip, sharp: step * density >= 2.0 };
            painter.add(Callback::new_paint_callback(clip, painting));
            if placement.scale >= VALUES_FROM {
                self.draw_values(&painter, pane, placement, &frame, picture, &part);
            }
            self.draw_picks(&painter, pane, placement, picture);
        }
        let corner = clip.min + vec2(6.0, 6.0);
        label(&painter, corner, Align2::LEFT_TOP, picture.name(), Color32::WHITE);
        if picture == Picture::SubFrames {
            for (name, [y, x]) in self.kinds.corners(extent) {
                let at = pane.min + Vec2::from(placement.to_pane([x as f32, y as f32])) + vec2(6.0, 24.0);
                label(&painter, at, Align2::LEFT_TOP, name, Color32::LIGHT_GRAY);
            }
        }
    }

    fn draw_values(
        &self,
        painter: &Painter,
        pane: Rect,
        placement: Placement,
        frame: &Frame,
        picture: Picture,
        part: &Part,
    ) {
        let font = FontId::monospace((placement.scale / 5.0).min(14.0));
        for y in part.rows.clone() {
            for x in part.cols.clone() {
                let Some(value) = picture.value(frame, &self.kinds, y, x) else { continue };
                let at = placement.to_pane([x as f32 + 0.5, y as f32 + 0.5]);
                let at = pane.min + Vec2::from(at);
                let text = short(value);
                painter.text(at + vec2(1.0, 1.0), Align2::CENTER_CENTER, &text, font.clone(), Color32::BLACK);
                painter.text(at, Align2::CENTER_CENTER, text, font.clone(), Color32::WHITE);
            }
        }
    }

    fn draw_picks(&self, painter: &Painter, pane: Rect, placement: Placement, picture: Picture) {
        if picture == Picture::SubFrames {
            return;
        }
        for ([y, x], colour) in self.state.picks.iter().zip(PICKS) {
            let at = placement.to_pane([*x as f32 + 0.5, *y as f32 + 0.5]);
            let at = pane.min + Vec2::from(at);
            let radius = (0.7 * placement.scale).max(5.0);
            painter.circle_stroke(at, radius, Stroke::new(3.5, Color32::BLACK));
            painter.circle_stroke(at, radius, Stroke::new(1.5, colour));
        }
    }

    /// Zoom, pan and picks, and what is under the pointer.
    fn handle(&mut self, ui: &Ui, response: &Response, pane: Rect) {
        let Some(frame) = &self.shown else { return };
        let extent = [frame.height, frame.width];
        let size = [pane.width(), pane.height()];
        let placement = self.state.look.place(extent, size);
        if let Some(pointer) = response.hover_pos() {
            let at = pointer - pane.min;
            let pixel = placement.pixel([at.x, at.y], extent);
            self.state.pointer = pixel;
            let (scroll, zoom) = ui.input(|input| (input.smooth_scroll_delta().y, input.zoom_delta()));
            let factor = zoom * (scroll / 200.0).exp();
            if factor != 1.0 {
                self.actions.push(Action::Zoom(factor, Some([at.x, at.y])));
            }
            if let Some(pixel) = pixel.filter(|_| response.clicked()) {
                self.actions.push(Action::Pick(pixel));
            }
        }
        if response.double_clicked() {
            self.actions.push(Action::Fit);
        } else if response.dragged() {
            let by = response.drag_delta();
            self.actions.push(Action::Pan([by.x, by.y]));
        }
    }

    /// What the engine does, where there is no picture to say it.
    fn draw_state(&self, ui: &Ui, area: Rect) {
        let painter = ui.painter_at(area);
        match &self.status.phase {
            Phase::Failed(problem) => {
                let width = (area.width() - 40.0).clamp(60.0, 640.0);
                let galley =
                    painter.layout(problem.clone(), FontId::proportional(15.0), Color32::WHITE, width);
                let rect = Rect::from_center_size(area.center(), galley.size() + vec2(24.0, 20.0));
                painter.rect_filled(rect, 6.0, Color32::from_rgb(120, 40, 10));
                painter.galley(rect.min + vec2(12.0, 10.0), galley, Color32::WHITE);
            }
            Phase::Preparing | Phase::Running if self.shown.is_none() => {
                let does = if self.status.phase == Phase::Preparing { "opening" } else { "computing" };
                let text = format!("{does} {} …", self.status.about.name);
                label(&painter, area.center(), Align2::CENTER_CENTER, &text, Color32::WHITE);
            }
            _ => {}
        }
    }
}

/// A pane without a picture.
fn paint_black(painter: &Painter, area: Rect, pane: usize) {
    let painting = Painting { pane, shown: None, rect: area, around: area, sharp: true };
    painter.add(Callback::new_paint_callback(area, painting));
}

/// Text on a picture, readable on anything.
fn label(painter: &Painter, at: Pos2, align: Align2, text: &str, colour: Color32) {
    let galley = painter.layout_no_wrap(text.to_owned(), FontId::proportional(13.0), colour);
    let rect = align.anchor_size(at, galley.size());
    painter.rect_filled(rect.expand(4.0), 3.0, Color32::from_black_alpha(190));
    painter.galley(rect.min, galley, colour);
}

/// A value in few characters.
pub(crate) fn short(value: f32) -> String {
    match value.abs() {
        0.0 => "0".into(),
        v if v < 0.001 => format!("{value:.0e}"),
        v if v < 0.1 => format!("{value:.4}"),
        _ => format!("{value:.3}"),
    }
}

//! The panels around the panes: source and arrangement, dials and how the engine is, time, time series, keys.

mod dials;
mod series;
mod status;
mod time;
mod top;

use eframe::egui::{self, Align2, CentralPanel, Color32, Frame, Panel, ScrollArea, Ui, vec2};

use crate::action::Action;
use crate::app::Viewer;

/// Windows smaller than this have no room for a panel besides the panes.
const ROOM_FOR_DIALS: f32 = 560.0;
const ROOM_FOR_SERIES: f32 = 420.0;

impl Viewer {
    /// Draws everything.
    pub(crate) fn draw(&mut self, ui: &mut Ui) {
        self.set_theme(ui.ctx());
        let size = ui.available_size();
        let mut frame = Frame::side_top_panel(ui.style());
        if self.drawing.is_cleared {
            frame.fill = Color32::TRANSPARENT;
        }
        Panel::top("top").frame(frame).show(ui, |ui| self.draw_top(ui));
        Panel::bottom("time").frame(frame).show(ui, |ui| self.draw_time(ui));
        if self.state.preferences.series && size.y > ROOM_FOR_SERIES {
            let panel = Panel::bottom("series").frame(frame).resizable(true);
            panel.default_size(170.0).min_size(90.0).show(ui, |ui| self.draw_series(ui));
        }
        if self.state.preferences.dials && size.x > ROOM_FOR_DIALS {
            let panel = Panel::right("dials").frame(frame).resizable(false);
            panel.exact_size(250.0).show(ui, |ui| {
                ScrollArea::vertical().auto_shrink(false).show(ui, |ui| self.draw_dials(ui));
            });
        }
        CentralPanel::default().frame(Frame::NONE).show(ui, |ui| self.draw_panes(ui));
        self.draw_help(ui);
        self.draw_messages(ui);
    }

    fn draw_help(&mut self, ui: &Ui) {
        let mut open = self.state.help;
        egui::Window::new("Keys").open(&mut open).default_width(380.0).vscroll(true).show(ui, |ui| {
            egui::Grid::new("keys").num_columns(2).striped(true).show(ui, |ui| {
                for binding in self.bindings.iter().filter(|binding| !binding.does.is_empty()) {
                    ui.monospace(binding.name());
                    ui.label(binding.does);
                    ui.end_row();
                }
                ui.monospace("wheel, drag");
                ui.label("zoom and pan all panes; a double click fits, a click picks a pixel");
                ui.end_row();
                ui.monospace("Ctrl + − 0");
                ui.label("larger, smaller or usual text");
                ui.end_row();
                ui.monospace("Tab");
                ui.label("the next button or field; Escape leaves it");
                ui.end_row();
                ui.monospace("Ctrl C");
                ui.label("copy the values of the picked pixels, or of the one under the pointer");
                ui.end_row();
            });
        });
        if open != self.state.help {
            self.actions.push(Action::Help);
        }
    }

    fn draw_messages(&mut self, ui: &Ui) {
        if self.messages.is_empty() {
            return;
        }
        egui::Area::new(egui::Id::unique("messages")).anchor(Align2::LEFT_BOTTOM, vec2(8.0, -64.0)).show(
            ui,
            |ui| {
                for message in &self.messages {
                    let colour =
                        if message.bad { ui.visuals().error_fg_color } else { ui.visuals().text_color() };
                    Frame::popup(ui.style()).show(ui, |ui| {
                        ui.set_max_width(480.0);
                        ui.colored_label(colour, &message.text);
                    });
                }
            },
        );
    }
}

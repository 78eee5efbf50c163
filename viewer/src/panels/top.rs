//! Source, arrangement, and what is written.

use eframe::egui::{self, ComboBox, ScrollArea, Ui, WidgetInfo};

use crate::action::Action;
use crate::app::Viewer;
use crate::picture::Picture;
use crate::preferences::Arrangement;
use crate::source::SourceName;
use pix2hdr::scene::procedural;

impl Viewer {
    pub(super) fn draw_top(&mut self, ui: &mut Ui) {
        ScrollArea::horizontal().show(ui, |ui| {
            ui.horizontal(|ui| {
                ui.menu_button("scene", |ui| {
                    for name in procedural::NAMES {
                        let describe = procedural::describe(name).unwrap_or_default();
                        if ui.button(name).on_hover_text(describe).clicked() {
                            name.clone_into(&mut self.typed);
                            self.actions.push(Action::Open(SourceName::Scene(name.to_owned())));
                            ui.close();
                        }
                    }
                })
                .response
                .on_hover_text("a simulated camera in front of a built-in scene");
                let typed = ui
                    .add(egui::TextEdit::singleline(&mut self.typed).desired_width(130.0).hint_text("file or scene"))
                    .on_hover_text(
                        "a scene, a capture (.npy with .json, or its folder), a video (.npy, folder of .exr), or a \
                         panorama (.exr, .hdr); Enter opens it (Ctrl O). Files can be dropped \
                         anywhere",
                    );
                if std::mem::take(&mut self.type_now) {
                    typed.request_focus();
                }
                if typed.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter)) {
                    self.actions.push(Action::Open(SourceName::parse(self.typed.trim())));
                }
                ui.separator();
                for arrangement in Arrangement::ALL {
                    let chosen = self.state.preferences.arrangement == arrangement;
                    if ui.selectable_label(chosen, arrangement.name()).on_hover_text("panes (V)").clicked() {
                        self.actions.push(Action::Arrange(arrangement));
                    }
                }
                for i in 0..self.state.preferences.pictures().len() {
                    self.choose_picture(ui, i);
                }
                ui.separator();
                let mut button = |ui: &mut Ui, text: &str, tip: &str, action: Action| {
                    if ui.button(text).on_hover_text(tip).clicked() {
                        self.actions.push(action);
                    }
                };
                button(ui, "fit", "fit pictures into their panes (F, or a double click)", Action::Fit);
                button(ui, "EXR", "save the chosen pane's frame as EXR (S)", Action::SaveExr);
                button(ui, "PNG", "save the chosen pane as PNG (Shift S)", Action::SavePng);
                button(
                    ui,
                    "record",
                    "write the range (I and O; else all of memory) as EXR pictures, and as a video if ffmpeg is \
                     installed (R)",
                    Action::Record,
                );
                button(ui, "copy", "copy the values of the picked pixels (Ctrl C)", Action::Copy);
                button(ui, "series", "time series of picked pixels (P)", Action::Series);
                button(ui, "dials", "dials (K)", Action::Dials);
                button(ui, "theme", "light, dark, or as the system (B)", Action::NextTheme);
                button(ui, "keys", "all keys (H)", Action::Help);
            });
        });
    }

    fn choose_picture(&mut self, ui: &mut Ui, i: usize) {
        let mut picture = self.state.preferences.pictures()[i];
        let before = picture;
        let combo = ComboBox::from_id_salt(("picture", i)).width(84.0).selected_text(picture.name());
        let shown = combo.show_ui(ui, |ui| {
            for other in Picture::ALL {
                ui.selectable_value(&mut picture, other, other.name()).on_hover_text(other.describe());
            }
        });
        let name = format!("picture in pane {}", i + 1);
        shown.response.widget_info(|| WidgetInfo::labeled(egui::Role::ComboBox, true, &name));
        shown.response.on_hover_text(format!("{name} (N, then 1 to 7)"));
        if picture != before {
            self.actions.push(Action::Show(i, picture));
        }
    }
}

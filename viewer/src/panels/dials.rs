//! The dials of the picture and of the engine.

use eframe::egui::{self, Align2, ComboBox, FontId, Rect, Sense, Slider, Stroke, TextStyle, Ui, pos2, vec2};

use crate::action::Action;
use crate::app::Viewer;
use crate::choices::{ALLOWED_ERRORS, EXECUTORS, PRECISIONS, skips};
use crate::histogram::{BINS, FIRST, histogram};
use crate::picture::Picture;
use crate::preferences::EXPOSURES;
use crate::tone::{Curve, STOPS};
use pix2hdr::network::presets;
use pix2hdr::synth::Settings;
use pix2hdr::synth::{self, Skip};

impl Viewer {
    pub(super) fn draw_dials(&mut self, ui: &mut Ui) {
        // Figures are read, not only looked up.
        if let Some(small) = ui.style_mut().text_styles.get_mut(&TextStyle::Small) {
            small.size = 11.0;
        }
        ui.add_space(4.0);
        ui.strong("Picture");
        self.draw_display(ui);
        ui.separator();
        ui.strong("Engine");
        self.draw_engine(ui);
        ui.separator();
        self.draw_status(ui);
    }

    fn draw_display(&mut self, ui: &mut Ui) {
        let display = self.state.preferences.display;
        let mut curve = display.curve;
        ComboBox::from_label("tone curve").selected_text(curve.name()).show_ui(ui, |ui| {
            for other in Curve::ALL {
                ui.selectable_value(&mut curve, other, other.name()).on_hover_text(other.describe());
            }
        });
        if curve != display.curve {
            self.actions.push(Action::Curve(curve));
        }
        let mut exposure = display.exposure;
        let slider = Slider::new(&mut exposure, EXPOSURES[0]..=EXPOSURES[1]).text("EV").max_decimals(2);
        if ui.add(slider).on_hover_text("exposure in stops (E and Shift E)").changed() {
            self.actions.push(Action::Exposure(exposure));
        }
        ui.horizontal(|ui| {
            let mut clipping = display.clipping;
            let tip = "mark pixels at the end of the scale, and saturated ones of the mosaic (C)";
            if ui.checkbox(&mut clipping, "clipping").on_hover_text(tip).changed() {
                self.actions.push(Action::Clipping);
            }
            let mut dither = display.dither;
            if ui.checkbox(&mut dither, "dither").on_hover_text("break up steps between greys (G)").changed()
            {
                self.actions.push(Action::Dither);
            }
        });
        if self
            .state
            .preferences
            .pictures()
            .iter()
            .any(|p| matches!(p, Picture::Difference | Picture::FilteredDifference))
        {
            let mut range = display.difference;
            let slider =
                Slider::new(&mut range, 0.005..=1.0).logarithmic(true).text("difference").max_decimals(3);
            let tip = "difference of the tone curve l at which blue and orange are strongest (D and Shift D)";
            if ui.add(slider).on_hover_text(tip).changed() {
                self.actions.push(Action::Difference(range));
            }
        }
        if display.curve == Curve::FalseColour {
            ui.small(format!("{STOPS:.0} stops, dark to bright, up to p = 2^{:.1}", 0.0 - display.exposure));
        }
        self.draw_histogram(ui);
    }

    fn draw_histogram(&self, ui: &mut Ui) {
        let size = vec2(ui.available_width(), 60.0);
        let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
        response.on_hover_text("how often which irradiance occurs: stops below p = 1, height logarithmic; the mark is the end of the scale");
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 2.0, ui.visuals().extreme_bg_color);
        let plane = self.shown.as_ref().and_then(|frame| frame.ours.as_ref().or(frame.truth.as_ref()));
        let Some(plane) = plane else { return };
        let counts = histogram(plane);
        let most = (counts.iter().copied().max().unwrap_or(1) as f32).ln_1p();
        let place = |bin: f32| rect.left() + rect.width() * bin / BINS as f32;
        for (i, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let height = (*count as f32).ln_1p() / most.max(1e-6) * (rect.height() - 14.0);
            let bar = Rect::from_min_max(
                pos2(place(i as f32), rect.bottom() - 12.0 - height),
                pos2(place(i as f32 + 1.0), rect.bottom() - 12.0),
            );
            painter.rect_filled(bar, 0.0, ui.visuals().text_color());
        }
        let font = FontId::proportional(9.0);
        for stop in [-16, -12, -8, -4, 0] {
            let x = place(8.0 * (stop as f32 - FIRST));
            let align = if stop == -16 { Align2::LEFT_BOTTOM } else { Align2::CENTER_BOTTOM };
            painter.text(pos2(x, rect.bottom()), align, stop, font.clone(), ui.visuals().weak_text_color());
        }
        let end = place((8.0 * (-self.state.preferences.display.exposure - FIRST)).clamp(0.0, BINS as f32));
        painter.vline(end, rect.y_range(), Stroke::new(1.0, ui.visuals().warn_fg_color));
    }

    fn draw_engine(&mut self, ui: &mut Ui) {
        let mut settings: Settings = self.state.settings.clone();
        ComboBox::from_label("net")
            .selected_text(short_name(&settings.weights))
            .show_ui(ui, |ui| {
                for net in &self.state.nets {
                    let purpose =
                        presets::by_name(net).map_or_else(|_| net.clone(), |p| p.purpose.to_owned());
                    ui.selectable_value(&mut settings.weights, net.clone(), short_name(net))
                        .on_hover_text(purpose);
                }
            })
            .response
            .on_hover_text("presets with weights for this pattern, and what --weights named (W)");
        let executor = |request| match request {
            synth::ExecutorChoice::Auto => "auto",
            synth::ExecutorChoice::Gpu => "GPU",
            synth::ExecutorChoice::Cpu => "CPU",
        };
        ComboBox::from_label("executor")
            .selected_text(executor(settings.executor))
            .show_ui(ui, |ui| {
                for request in EXECUTORS {
                    ui.selectable_value(&mut settings.executor, request, executor(request));
                }
            })
            .response
            .on_hover_text(
                "auto: a real GPU if there is one, else the CPU. GPU takes software Vulkan too (U)",
            );
        ComboBox::from_label("precision")
            .selected_text(settings.precision.name())
            .show_ui(ui, |ui| {
                for precision in PRECISIONS {
                    ui.selectable_value(&mut settings.precision, precision, precision.name());
                }
            })
            .response
            .on_hover_text("f16 stores feature channels and weights in 16 bits, on a GPU only (Y)");
        ComboBox::from_label("skip")
            .selected_text(settings.skip.name())
            .show_ui(ui, |ui| {
                for skip in skips(settings.skip) {
                    ui.selectable_value(&mut settings.skip, skip, skip.name());
                }
            })
            .response
            .on_hover_text(
                "exact: what gives the same bits is kept; bounded: what noise or the allowed error hides (Z)",
            );
        if let Skip::Bounded(error) = settings.skip {
            let dragged = egui::Id::unique("allowed error");
            let mut error = ui.data(|data| data.get_temp(dragged)).unwrap_or(error);
            let slider = Slider::new(&mut error, ALLOWED_ERRORS[0]..=ALLOWED_ERRORS[1])
                .logarithmic(true)
                .text("error")
                .max_decimals(4);
            let response =
                ui.add(slider).on_hover_text("allowed error in l: 0.002 is 1.7% of the irradiance (, and .)");
            if response.dragged() {
                // The engine is left in peace until it is let go.
                ui.data_mut(|data| data.insert_temp(dragged, error));
            } else if response.changed() || response.drag_stopped() {
                ui.data_mut(|data| data.remove::<f64>(dragged));
                settings.skip = Skip::Bounded(error);
            }
        }
        if settings.skip != Skip::Off {
            let mut overlay = self.state.preferences.overlay;
            if ui.checkbox(&mut overlay, "mark computed cells").on_hover_text("in orange (M)").changed() {
                self.actions.push(Action::Overlay);
            }
        }
        if settings != self.state.settings {
            self.actions.push(Action::Tune(settings));
        }
    }
}

/// The last part of a path.
fn short_name(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

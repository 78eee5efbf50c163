//! The panels around the panes: source and arrangement, dials and how the engine is, time, time series, keys.

use std::time::Instant;

use eframe::egui::{
    self, Align, Align2, CentralPanel, Color32, ComboBox, DragValue, FontId, Frame, Layout, Panel, Rect,
    RichText, ScrollArea, Sense, Slider, Stroke, TextStyle, Ui, WidgetInfo, pos2, vec2,
};

use crate::app::{Viewer, resident_bytes};
use crate::clock::RATE_RANGE;
use crate::engine::{Dials, HISTORY, Phase};
use crate::histogram::{BINS, FIRST, histogram};
use crate::panes::{PICKS, short};
use crate::picture::Picture;
use crate::series::Series;
use crate::source::Request;
use crate::state::{ALLOWED_ERRORS, Action, Arrangement, EXECUTORS, EXPOSURES, PRECISIONS, skips};
use crate::tone::{Curve, STOPS};
use pix2hdr::network::presets;
use pix2hdr::scene::procedural;
use pix2hdr::synth::{self, Skip};

/// Colours of the lines of a time series, told apart with any colour vision (Okabe and Ito); widths too.
const LINES: [(Color32, f32); 4] = [
    (Color32::from_rgb(150, 150, 150), 1.0),
    (Color32::from_rgb(230, 159, 0), 1.5),
    (Color32::from_rgb(86, 180, 233), 2.5),
    (Color32::from_rgb(0, 158, 115), 1.5),
];
/// Most frames of a time series.
const SERIES_FRAMES: usize = 512;
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
        if self.state.settings.series && size.y > ROOM_FOR_SERIES {
            let panel = Panel::bottom("series").frame(frame).resizable(true);
            panel.default_size(170.0).min_size(90.0).show(ui, |ui| self.draw_series(ui));
        }
        if self.state.settings.dials && size.x > ROOM_FOR_DIALS {
            let panel = Panel::right("dials").frame(frame).resizable(false);
            panel.exact_size(250.0).show(ui, |ui| {
                ScrollArea::vertical().auto_shrink(false).show(ui, |ui| self.draw_dials(ui));
            });
        }
        CentralPanel::default().frame(Frame::NONE).show(ui, |ui| self.draw_panes(ui));
        self.draw_help(ui);
        self.draw_messages(ui);
    }

    fn draw_top(&mut self, ui: &mut Ui) {
        ScrollArea::horizontal().show(ui, |ui| {
            ui.horizontal(|ui| {
                ui.menu_button("scene", |ui| {
                    for name in procedural::NAMES {
                        let describe = procedural::describe(name).unwrap_or_default();
                        if ui.button(name).on_hover_text(describe).clicked() {
                            name.clone_into(&mut self.typed);
                            self.actions.push(Action::Open(Request::Scene(name.to_owned())));
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
                    self.actions.push(Action::Open(Request::parse(self.typed.trim())));
                }
                ui.separator();
                for arrangement in Arrangement::ALL {
                    let chosen = self.state.settings.arrangement == arrangement;
                    if ui.selectable_label(chosen, arrangement.name()).on_hover_text("panes (V)").clicked() {
                        self.actions.push(Action::Arrange(arrangement));
                    }
                }
                for i in 0..self.state.settings.pictures().len() {
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
        let mut picture = self.state.settings.pictures()[i];
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

    fn draw_time(&mut self, ui: &mut Ui) {
        ScrollArea::horizontal().show(ui, |ui| {
            ui.horizontal(|ui| {
                let playing = self.state.clock.playing;
                let mut button = |ui: &mut Ui, text: &str, tip: &str, action: Action| {
                    if ui.button(text).on_hover_text(tip).clicked() {
                        self.actions.push(action);
                    }
                };
                let play = if playing { "pause" } else { "play" };
                button(ui, play, "play or pause (space)", Action::Play);
                button(ui, "|<", "first frame; live: the oldest in memory (Home)", Action::First);
                button(ui, "<", "one frame back (left arrow)", Action::Step(-1));
                button(ui, ">", "one frame on (right arrow)", Action::Step(1));
                button(ui, ">|", "last frame; live: the newest (End)", Action::Last);
                let mut looping = self.state.clock.looping;
                if ui.checkbox(&mut looping, "loop").on_hover_text("begin again at the end (L)").changed() {
                    self.actions.push(Action::Loop);
                }
                let mut rate = self.state.clock.rate;
                let speed = 0.02 * rate;
                let value = DragValue::new(&mut rate)
                    .range(RATE_RANGE[0]..=RATE_RANGE[1])
                    .speed(speed)
                    .max_decimals(1)
                    .suffix(" frames/s");
                if ui.add(value).on_hover_text("frames shown per second (up and down arrow)").changed() {
                    self.actions.push(Action::Rate(rate));
                }
                let slowed = self.state.clock.slowed(self.status.about.period_ms.max(1e-9));
                let words = if self.status.about.period_ms <= 0.0 {
                    String::new()
                } else if (0.99..1.01).contains(&slowed) {
                    "real speed".to_owned()
                } else if slowed > 1.0 {
                    format!("slowed {slowed:.3}×")
                } else {
                    format!("{:.3}× real speed", 1.0 / slowed)
                };
                ui.label(words);
                let frame = self.shown.as_ref().map_or(0, |frame| frame.number);
                let period = self.status.about.period_ms;
                ui.label(
                    RichText::new(format!("frame {frame}  {:.1} ms", frame as f64 * period)).monospace(),
                );
                if let Some([first, last]) = self.reach.span {
                    let range = self.reach.frames.map_or([first, last], |n| [0, n.saturating_sub(1)]);
                    let mut at = self.state.clock.frame().clamp(range[0], range[1].max(range[0]));
                    ui.spacing_mut().slider_width = (ui.available_width() - 12.0).clamp(80.0, 900.0);
                    let slider = Slider::new(&mut at, range[0]..=range[1].max(range[0])).show_value(false);
                    if ui.add(slider).on_hover_text("scrub; live: what is in memory").changed() {
                        self.state.clock.playing = false;
                        self.actions.push(Action::GoTo(at));
                    }
                }
            });
            self.draw_pointer(ui);
        });
    }

    /// What is under the pointer, in words.
    fn draw_pointer(&self, ui: &mut Ui) {
        let mut text = String::new();
        if let (Some(frame), Some([y, x])) = (&self.shown, self.state.pointer) {
            text = format!("row {y}, column {x}:");
            for picture in [Picture::Mosaic, Picture::Filtered, Picture::Ours, Picture::Truth] {
                if let Some(value) = picture.value(frame, &self.kinds, y, x) {
                    text += &format!("  {} {}", picture.name(), short(value));
                }
            }
            if let Some(recording) = &self.status.recording {
                let t = recording.info.schedule_start + frame.number as i64;
                let covering = recording.pattern.schedule(y, x).covering(t);
                text += &format!("  exposure {} frames", covering.shutter.exposure());
            }
        }
        match self.state.range {
            [None, None] => {}
            [first, last] => {
                let show = |end: Option<usize>| end.map_or("…".into(), |frame| frame.to_string());
                text += &format!("  range {} to {}", show(first), show(last));
            }
        }
        ui.label(RichText::new(if text.is_empty() { " ".into() } else { text }).monospace().small());
    }

    fn draw_dials(&mut self, ui: &mut Ui) {
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
        let display = self.state.settings.display;
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
            .settings
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
        let end = place((8.0 * (-self.state.settings.display.exposure - FIRST)).clamp(0.0, BINS as f32));
        painter.vline(end, rect.y_range(), Stroke::new(1.0, ui.visuals().warn_fg_color));
    }

    fn draw_engine(&mut self, ui: &mut Ui) {
        let mut dials: Dials = self.state.dials.clone();
        ComboBox::from_label("net")
            .selected_text(short_name(&dials.weights))
            .show_ui(ui, |ui| {
                for net in &self.state.nets {
                    let purpose =
                        presets::by_name(net).map_or_else(|_| net.clone(), |p| p.purpose.to_owned());
                    ui.selectable_value(&mut dials.weights, net.clone(), short_name(net))
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
            .selected_text(executor(dials.executor))
            .show_ui(ui, |ui| {
                for request in EXECUTORS {
                    ui.selectable_value(&mut dials.executor, request, executor(request));
                }
            })
            .response
            .on_hover_text(
                "auto: a real GPU if there is one, else the CPU. GPU takes software Vulkan too (U)",
            );
        ComboBox::from_label("precision")
            .selected_text(dials.precision.name())
            .show_ui(ui, |ui| {
                for precision in PRECISIONS {
                    ui.selectable_value(&mut dials.precision, precision, precision.name());
                }
            })
            .response
            .on_hover_text("f16 stores feature channels and weights in 16 bits, on a GPU only (Y)");
        ComboBox::from_label("skip")
            .selected_text(dials.skip.name())
            .show_ui(ui, |ui| {
                for skip in skips(dials.skip) {
                    ui.selectable_value(&mut dials.skip, skip, skip.name());
                }
            })
            .response
            .on_hover_text(
                "exact: what gives the same bits is kept; bounded: what noise or the allowed error hides (Z)",
            );
        if let Skip::Bounded(error) = dials.skip {
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
                dials.skip = Skip::Bounded(error);
            }
        }
        if dials.skip != Skip::Off {
            let mut overlay = self.state.settings.overlay;
            if ui.checkbox(&mut overlay, "mark computed cells").on_hover_text("in orange (M)").changed() {
                self.actions.push(Action::Overlay);
            }
        }
        if dials != self.state.dials {
            self.actions.push(Action::Tune(dials));
        }
    }

    fn draw_status(&self, ui: &mut Ui) {
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
        let line = |ui: &mut Ui, name: &str, value: String, tip: &str| {
            ui.horizontal(|ui| {
                ui.label(RichText::new(name).small());
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    ui.label(RichText::new(value).small().monospace());
                });
            })
            .response
            .on_hover_text(tip);
        };
        let now = Instant::now();
        let median = match status.median_ms() {
            None => "-".into(),
            // Skipping left nothing to compute in most windows.
            Some(0.0) => "nothing computed".into(),
            Some(ms) if ms < 0.01 => "below 0.01 ms".into(),
            Some(ms) => format!("{ms:.2} ms"),
        };
        line(
            ui,
            "net per frame (median)",
            median,
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

    fn draw_series(&mut self, ui: &mut Ui) {
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

/// The last part of a path.
fn short_name(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

//! Time, and what is under the pointer.

use eframe::egui::{DragValue, RichText, ScrollArea, Slider, Ui};

use crate::action::Action;
use crate::app::Viewer;
use crate::clock::RATE_RANGE;
use crate::panes::short;
use crate::picture::Picture;

impl Viewer {
    pub(super) fn draw_time(&mut self, ui: &mut Ui) {
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
}

//! What actions ask of others: the engine, files, the clipboard. What takes long runs on a thread of its own.

use std::path::PathBuf;

use eframe::egui;

use crate::action::Effect;
use crate::app::Viewer;
use crate::export;
use crate::message::Message;
use crate::picture::Picture;
use pix2hdr::Result;
use pix2hdr::video::PreviewWriter;

impl Viewer {
    /// Does what an action asks of others.
    pub(crate) fn carry_out(&mut self, effect: Option<Effect>, ctx: &egui::Context) {
        let Some(effect) = effect else { return };
        let picture =
            self.state.preferences.pictures().get(self.state.pane).copied().unwrap_or(Picture::Ours);
        let folder = self.start.out.clone();
        match effect {
            Effect::Seek(frame) => self.engine.seek(frame),
            Effect::Tune(settings, frame) => self.engine.tune(settings, frame),
            Effect::Open(source) => {
                self.typed = source.to_string();
                self.shown = None;
                self.engine.open(source);
            }
            Effect::SaveExr => {
                let Some(frame) = self.shown.clone() else { return };
                self.job(move || export::save_exr(&folder, &frame, picture).map(|path| vec![path]));
            }
            Effect::SavePng => {
                let Some(frame) = self.shown.clone() else { return };
                let (kinds, table) = (self.kinds.clone(), self.table.clone());
                self.job(move || {
                    export::save_png(&folder, &frame, picture, &kinds, &table).map(|path| vec![path])
                });
            }
            Effect::Record([first, last]) => {
                let frames = self.engine.store.between(first, last);
                let rate = self.state.clock.rate.clamp(1.0, 120.0).round() as u32;
                let hear = self.jobs.0.clone();
                self.job(move || {
                    let (files, problem) = export::record(&folder, &frames, rate)?;
                    let note = match problem {
                        Some(problem) => Some(Message::bad(problem.to_string())),
                        None if PreviewWriter::is_installed() => None,
                        None => {
                            Some(Message::good("with ffmpeg installed there would be a video too".into()))
                        }
                    };
                    if let Some(note) = note {
                        // The viewer may have been closed.
                        let _ = hear.send(note);
                    }
                    Ok(files)
                });
            }
            Effect::Copy => {
                let text = self.values();
                if !text.is_empty() {
                    ctx.copy_text(text);
                    self.messages.push_back(Message::good("values copied".into()));
                }
            }
            Effect::Type => self.type_now = true,
            Effect::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
        }
    }

    /// Does something that takes long on a thread of its own, and says how it went.
    fn job(&self, work: impl FnOnce() -> Result<Vec<PathBuf>> + Send + 'static) {
        let hear = self.jobs.0.clone();
        let spawned = std::thread::Builder::new().name("writer".into()).spawn({
            let hear = hear.clone();
            move || {
                let message = match work() {
                    Ok(files) => {
                        let names: Vec<_> = files.iter().map(|file| file.display().to_string()).collect();
                        Message::good(format!("written: {}", names.join(", ")))
                    }
                    Err(error) => Message::bad(error.to_string()),
                };
                // The viewer may have been closed.
                let _ = hear.send(message);
            }
        });
        if let Err(error) = spawned {
            let _ = hear.send(Message::bad(format!("nothing was written: {error}")));
        }
    }

    /// Values of the picked pixels, or else of the one under the pointer, as a table.
    fn values(&self) -> String {
        let Some(frame) = &self.shown else { return String::new() };
        let pointer = self.state.pointer.into_iter().collect();
        let pixels: Vec<[usize; 2]> =
            if self.state.picks.is_empty() { pointer } else { self.state.picks.clone() };
        if pixels.is_empty() {
            return String::new();
        }
        let pictures = [Picture::Mosaic, Picture::Filtered, Picture::Ours, Picture::Truth];
        let mut text = "frame\trow\tcolumn".to_owned();
        for picture in pictures {
            text += &format!("\t{}", picture.name());
        }
        for [y, x] in pixels {
            text += &format!("\n{}\t{y}\t{x}", frame.number);
            for picture in pictures {
                text += "\t";
                text += &picture.value(frame, &self.kinds, y, x).map_or(String::new(), |v| format!("{v}"));
            }
        }
        text
    }
}

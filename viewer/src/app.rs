//! The viewer: the engine, the state, and what is drawn of them.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use eframe::{egui, egui_wgpu};

use crate::action::Action;
use crate::choices::nets;
use crate::clock::Reach;
use crate::engine::{Engine, Phase, Status};
use crate::frame::Frame;
use crate::keys::{Binding, bindings};
use crate::message::{MESSAGE_TIME, Message};
use crate::pace::{Measured, Pace, resident_bytes};
use crate::picture::Kinds;
use crate::preferences::{Preferences, SCALES, Theme, WINDOW};
use crate::screen::Screen;
use crate::source::SourceName;
use crate::start::Start;
use crate::state::State;
use crate::tone::ToneTable;
use pix2hdr::gpu::Gpu;

/// Bytes of frames that are kept.
const STORE_BYTES: usize = 512 << 20;
/// Passes per second at most: what screens show, and what is shown of it where software draws, which takes the cores that
/// synthesis needs, and as long as half of such a pass.
const PASSES: f64 = 60.0;
const PASSES_OF_SOFTWARE: f64 = 30.0;
/// The pace at which changes are looked for where nothing plays.
const IDLE: Duration = Duration::from_millis(200);

/// The viewer.
pub struct Viewer {
    /// What the interface is set to.
    pub state: State,
    pub(crate) engine: Engine,
    /// How the engine was at the beginning of this pass.
    pub(crate) status: Status,
    pub(crate) reach: Reach,
    /// The frame that is shown.
    pub(crate) shown: Option<Arc<Frame>>,
    pub(crate) kinds: Arc<Kinds>,
    pub(crate) table: Arc<ToneTable>,
    /// What is typed as a source.
    pub(crate) typed: String,
    /// Whether the cursor is to be put there.
    pub(crate) type_now: bool,
    pub(crate) messages: VecDeque<Message>,
    pub(crate) actions: Vec<Action>,
    pub(crate) bindings: Vec<Binding>,
    /// The GPU that synthesises and draws the window.
    pub(crate) shared: Option<Gpu>,
    pub(crate) drawing: Drawing,
    /// Whether the next frame was not there yet.
    waits: bool,
    pub(crate) start: Start,
    pub(crate) jobs: (Sender<Message>, Receiver<Message>),
    saved: Preferences,
    last: Instant,
    pub(crate) measured: Measured,
}

/// How the window is drawn.
pub(crate) struct Drawing {
    /// Whether it was not drawn yet.
    pub(crate) is_new: bool,
    /// Whether it has the panels' colour before anything is drawn.
    pub(crate) is_cleared: bool,
    /// Whether software draws it.
    pub(crate) is_software: bool,
}

impl Drawing {
    /// A new window.
    const NEW: Self = Self { is_new: true, is_cleared: false, is_software: false };

    /// Passes per second at most.
    fn most_passes(&self) -> f64 {
        if self.is_software { PASSES_OF_SOFTWARE } else { PASSES }
    }
}

impl Viewer {
    /// Starts the engine; the viewer has been about to start since `begun`. `shared` synthesises and draws the window.
    pub fn new(start: Start, begun: Instant, shared: Option<Gpu>) -> Self {
        let mut preferences = start.preferences();
        preferences.rate = start.rate.unwrap_or(preferences.rate);
        let (opening, source, settings) =
            (start.opening.clone(), start.source.clone(), start.settings.clone());
        let engine = Engine::with(opening, source, settings, STORE_BYTES, shared.clone());
        let table = Arc::new(ToneTable::new(preferences.display));
        let now = Instant::now();
        Self {
            state: State::new(preferences.clone(), start.settings.clone()),
            engine,
            status: Status::default(),
            reach: Reach { span: None, frames: None, burst: 1 },
            shown: None,
            kinds: Arc::default(),
            table,
            typed: start.source.to_string(),
            type_now: false,
            messages: VecDeque::new(),
            actions: Vec::new(),
            bindings: bindings(),
            shared,
            drawing: Drawing::NEW,
            waits: false,
            start,
            jobs: channel(),
            saved: preferences,
            last: now,
            measured: Measured::new(begun),
        }
    }

    /// How the engine is.
    pub fn status(&self) -> Status {
        self.engine.status()
    }

    /// Why the GPU that draws the window is gone, if it is.
    pub fn lost(&self) -> Option<String> {
        self.shared.as_ref().and_then(Gpu::lost)
    }

    /// Goes on in a new window, which `shared` draws, after the last one's GPU was lost.
    pub fn reopen(&mut self, shared: Option<Gpu>, problem: &str) {
        self.messages.push_back(Message::bad(format!("{problem}; the window was opened anew")));
        self.engine.share(shared.clone(), self.state.clock.frame());
        self.shared = shared;
        self.shown = None;
        self.drawing = Drawing::NEW;
    }

    /// The frame that is shown.
    pub fn shown(&self) -> Option<&Arc<Frame>> {
        self.shown.as_ref()
    }

    /// Gets ready to be drawn by a window's device.
    pub fn drawn_by(&mut self, state: &egui_wgpu::RenderState) {
        if self.shared.is_none() {
            state.device.on_uncaptured_error(Arc::new(|error| tracing::error!("the window: {error}")));
        }
        Screen::install(state);
        self.drawing.is_software = state.adapter.get_info().device_type == wgpu::DeviceType::Cpu;
    }

    /// Draws one pass of the interface, and does what the user wanted in it.
    pub fn show(&mut self, ui: &mut egui::Ui) {
        let begun = Instant::now();
        if self.lost().is_some() {
            // Nothing can be drawn any more; whoever opened the window opens another one.
            ui.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
            return;
        }
        self.tick(begun, ui.ctx());
        self.listen(ui.ctx());
        self.remember_window(ui.ctx());
        self.draw(ui);
        for action in std::mem::take(&mut self.actions) {
            tracing::trace!(?action, "{:.1} ms", 1e3 * self.measured.begun.elapsed().as_secs_f64());
            let effect = self.state.apply(action, self.reach);
            self.carry_out(effect, ui.ctx());
        }
        self.engine
            .clock
            .set_rate(if self.state.clock.playing { self.state.clock.rate } else { 0.0 }, Instant::now());
        self.measured.passes.push(begun.elapsed().as_secs_f32());
        self.ask_for_next_pass(ui.ctx());
    }

    /// Takes in what has happened since the last pass.
    fn tick(&mut self, now: Instant, ctx: &egui::Context) {
        let seconds = now.saturating_duration_since(self.last).as_secs_f64();
        self.last = now;
        self.measured.first[0].get_or_insert(now);
        self.measured.intervals.push(seconds as f32);
        // Ten minutes at 60 passes a second are kept.
        if self.measured.intervals.len() > 1 << 16 {
            self.measured.intervals.drain(..1 << 15);
            self.measured.passes.drain(..1 << 15);
        }
        let lasted = now.saturating_duration_since(self.measured.begun).as_secs_f64();
        if self.measured.memory.is_none() && lasted > self.start.seconds.map_or(10.0, |s| (0.5 * s).min(10.0))
        {
            self.measured.memory = resident_bytes();
        }
        if self.start.seconds.is_some_and(|seconds| lasted > seconds) {
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
        let status = self.engine.status();
        let pattern = |status: &Status| status.recording.as_ref().map(|recording| recording.pattern.clone());
        if pattern(&status) != pattern(&self.status) {
            let pattern = pattern(&status);
            self.state.nets = nets(pattern.as_ref(), &self.start.settings.weights);
            self.kinds = Arc::new(pattern.map_or_else(Kinds::default, |pattern| Kinds::new(&pattern)));
        }
        self.status = status;
        self.reach = Reach {
            span: self.engine.store.span(),
            frames: self.status.about.frames,
            burst: self.status.hop.max(1),
        };
        // A frame that was waited for has its time before it, not behind it.
        let passed = if self.waits { seconds.min(1.0 / self.drawing.most_passes()) } else { seconds };
        let effect = self.state.advance(passed, self.reach);
        self.carry_out(effect, ctx);
        let frame = self.state.clock.frame();
        self.engine.store.move_to(frame);
        // Until something new is there, the last picture stays.
        let preview = || self.status.preview(self.engine.clock.exposed(now)).cloned();
        if let Some(shown) = self.engine.store.at(frame).or_else(preview) {
            self.measured.first[1].get_or_insert(now);
            self.shown = Some(shown);
        }
        if self.table.display() != self.state.preferences.display {
            self.table = Arc::new(ToneTable::new(self.state.preferences.display));
        }
        while let Ok(message) = self.jobs.1.try_recv() {
            self.messages.push_back(message);
        }
        self.messages.retain(|message| message.since.elapsed() < MESSAGE_TIME);
    }

    /// Keys, dropped files, and the clipboard.
    fn listen(&mut self, ctx: &egui::Context) {
        let typing = ctx.egui_wants_keyboard_input();
        let (events, dropped) = ctx.input(|input| (input.events.clone(), input.raw.dropped_files.clone()));
        for event in events {
            match event {
                egui::Event::Key { key, pressed: true, modifiers, .. } if !typing => {
                    let is = |binding: &&Binding| {
                        // Plus needs shift on most keyboards.
                        let shift = key == egui::Key::Plus || binding.modifiers.shift == modifiers.shift;
                        binding.key == key
                            && shift
                            && binding.modifiers.command == modifiers.command
                            && !modifiers.alt
                    };
                    self.actions.extend(self.bindings.iter().find(is).map(|b| b.action.clone()));
                }
                egui::Event::Copy if !typing => self.actions.push(Action::Copy),
                _ => {}
            }
        }
        if let Some(file) = dropped.first() {
            self.actions.push(Action::Open(SourceName::Path(file.path().to_owned())));
        }
    }

    /// Takes over, at first, how large everything was drawn last time, and remembers it and the window's size.
    fn remember_window(&mut self, ctx: &egui::Context) {
        let preferences = &mut self.state.preferences;
        if std::mem::take(&mut self.drawing.is_new) {
            ctx.set_zoom_factor(preferences.scale);
            self.engine.on_arrival({
                let ctx = ctx.clone();
                move || ctx.request_repaint()
            });
            return;
        }
        preferences.scale = ctx.zoom_factor().clamp(SCALES[0], SCALES[1]);
        let window = ctx.input(|input| {
            let viewport = input.viewport();
            let usual = viewport.maximized != Some(true) && viewport.fullscreen != Some(true);
            viewport.inner_rect.filter(|_| usual).map(|rect| rect.size() * preferences.scale)
        });
        if let Some(size) = window {
            preferences.window = [size.x, size.y].map(|side| side.clamp(WINDOW[0], WINDOW[1]));
        }
    }

    fn ask_for_next_pass(&mut self, ctx: &egui::Context) {
        let playing =
            self.state.clock.playing && matches!(self.status.phase, Phase::Running | Phase::Finished);
        // Passes that would show the same again are left out, which counts where software draws: it takes the cores
        // that the next frame needs.
        let next = self.state.clock.frame() + 1;
        let ends = self.status.about.frames.is_some_and(|frames| next >= frames);
        self.waits = playing && !ends && !self.engine.is_there(next) && self.engine.store.span().is_some();
        let pause = if playing && !self.waits {
            Duration::from_secs_f64(1.0 / self.state.clock.rate.clamp(5.0, self.drawing.most_passes()))
        } else if self.status.phase == Phase::Preparing || self.shown.is_none() {
            Duration::from_millis(50)
        } else {
            IDLE
        };
        ctx.request_repaint_after(pause);
    }

    /// How the interface kept up.
    pub fn pace(&self) -> Pace {
        let quantiles = |times: &[f32]| {
            let mut times = times.to_vec();
            times.sort_unstable_by(f32::total_cmp);
            [0.5, 0.95, 1.0].map(|q| {
                let i = ((times.len() as f64 * q) as usize).min(times.len().saturating_sub(1));
                times.get(i).map_or(0.0, |s| 1e3 * f64::from(*s))
            })
        };
        let status = self.engine.status();
        Pace {
            seconds: self.measured.begun.elapsed().as_secs_f64(),
            passes: self.measured.passes.len(),
            // The first passes open the window.
            interval_ms: quantiles(self.measured.intervals.get(5..).unwrap_or_default()),
            pass_ms: quantiles(self.measured.passes.get(5..).unwrap_or_default()),
            start_ms: self
                .measured
                .first
                .map(|first| first.map(|first| 1e3 * (first - self.measured.begun).as_secs_f64())),
            net_ms: status.median_ms(),
            on_gpu: self.is_drawn_from_gpu(),
            frames: status.frames,
            dropped: status.dropped,
            memory: [self.measured.memory, resident_bytes()],
            failure: match status.phase {
                Phase::Failed(problem) => Some(problem),
                _ => None,
            },
        }
    }

    /// Whether results are drawn where the GPU left them.
    pub fn is_drawn_from_gpu(&self) -> bool {
        self.shared.is_some() && self.shown.as_ref().is_some_and(|frame| frame.on_gpu.is_some())
    }

    /// Sets light or dark.
    pub(crate) fn set_theme(&self, ctx: &egui::Context) {
        ctx.set_theme(match self.state.preferences.theme {
            Theme::System => egui::ThemePreference::System,
            Theme::Dark => egui::ThemePreference::Dark,
            Theme::Light => egui::ThemePreference::Light,
        });
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        if let Some(path) = self.start.preferences.as_ref().filter(|_| self.saved != self.state.preferences)
            && let Err(error) = self.state.preferences.write(path)
        {
            tracing::warn!("preferences are not kept: {error}");
        }
    }
}

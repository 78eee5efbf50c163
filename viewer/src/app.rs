//! The viewer: the engine, the state, and what is drawn of them.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use eframe::{egui, egui_wgpu};

use crate::clock::Reach;
use crate::engine::{Dials, Engine, Phase, Status};
use crate::export;
use crate::frame::Frame;
use crate::keys::{Binding, bindings};
use crate::picture::{Kinds, Picture};
use crate::screen::Screen;
use crate::source::{Opening, Request};
use crate::state::{Action, Effect, SCALES, Settings, State, Theme, WINDOW, nets};
use crate::tone::ToneTable;
use pix2hdr::gpu::Gpu;
use pix2hdr::synth::{self, Backend};
use pix2hdr::system;
use pix2hdr::video::PreviewWriter;
use pix2hdr::{Error, Result};

/// Bytes of frames that are kept.
const STORE_BYTES: usize = 512 << 20;
/// How long messages are shown.
const MESSAGE_TIME: Duration = Duration::from_secs(8);
/// Passes per second at most: what screens show, and what is shown of it where software draws, which takes the cores that
/// synthesis needs, and as long as half of such a pass.
const PASSES: f64 = 60.0;
const PASSES_OF_SOFTWARE: f64 = 30.0;
/// The pace at which changes are looked for where nothing plays.
const IDLE: Duration = Duration::from_millis(200);
/// How often a window is opened again after its GPU was lost.
const REOPENINGS: usize = 3;

/// Which wgpu device draws the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WindowDevice {
    /// A real GPU that synthesises draws as well. Where software stands for a GPU, the window has a device of its own:
    /// in one queue every pass would wait for windows of synthesis.
    #[default]
    Auto,
    /// The one that synthesises, of whatever kind.
    Shared,
    /// One of its own.
    Own,
}

/// How the viewer is started.
#[derive(Clone, Debug)]
pub struct Start {
    /// What is shown first.
    pub request: Request,
    /// How sources are opened.
    pub opening: Opening,
    /// The engine's dials.
    pub dials: Dials,
    /// Where files are written.
    pub out: PathBuf,
    /// Where settings are kept, if anywhere.
    pub settings: Option<PathBuf>,
    /// Frames per second, in place of the remembered rate.
    pub rate: Option<f64>,
    /// End after so many seconds.
    pub seconds: Option<f64>,
    /// What draws the window.
    pub device: WindowDevice,
}

impl Start {
    /// What is remembered from last time.
    fn settings(&self) -> Settings {
        self.settings.as_ref().map_or_else(Settings::default, |path| Settings::read(path))
    }

    /// The GPU that synthesises and draws the window, if one is to do both.
    fn shared_gpu(&self, dials: &Dials) -> Result<Option<Gpu>> {
        if self.device == WindowDevice::Own
            || dials.executor == synth::ExecutorChoice::Cpu && self.device == WindowDevice::Auto
        {
            return Ok(None);
        }
        match (Backend::choose(dials.executor, dials.adapter.as_deref(), dials.precision), self.device) {
            (Ok(Backend::Gpu(gpu, _)), device)
                if device == WindowDevice::Shared || !gpu.adapter().is_software() =>
            {
                Ok(Some(gpu.shared()))
            }
            (Ok(Backend::Cpu), WindowDevice::Shared) => Err(Error::Usage(
                "no GPU synthesises, so none can be shared with the window; --executor gpu takes software Vulkan too"
                    .into(),
            )),
            (Err(error), WindowDevice::Shared) => Err(error),
            // What is wrong with the choice is said in the window.
            _ => Ok(None),
        }
    }
}

/// A line for the user.
#[derive(Clone, Debug)]
pub(crate) struct Message {
    pub(crate) text: String,
    pub(crate) bad: bool,
    since: Instant,
}

/// How the interface kept up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pace {
    /// Seconds since the window opened.
    pub seconds: f64,
    /// Passes of the interface.
    pub passes: usize,
    /// Milliseconds from one pass to the next: median, 95th percentile, largest.
    pub interval_ms: [f64; 3],
    /// Milliseconds that a pass took: median, 95th percentile, largest.
    pub pass_ms: [f64; 3],
    /// Milliseconds from the start to the first pass, and to the first picture, if there was one.
    pub start_ms: [Option<f64>; 2],
    /// Median milliseconds of the net per frame, of the last ones.
    pub net_ms: Option<f32>,
    /// Whether results are drawn where the GPU left them.
    pub on_gpu: bool,
    /// Frames that were delivered.
    pub frames: u64,
    /// Frames that the camera dropped.
    pub dropped: u64,
    /// Bytes of memory of the process after ten seconds (or half of the time), and at the end; `None` where the system
    /// does not say.
    pub memory: [Option<u64>; 2],
    /// What failed, if anything did.
    pub failure: Option<String>,
}

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
    shared: Option<Gpu>,
    pub(crate) drawing: Drawing,
    /// Whether the next frame was not there yet.
    waits: bool,
    start: Start,
    jobs: (Sender<Message>, Receiver<Message>),
    saved: Settings,
    last: Instant,
    measured: Measured,
}

/// How the window is drawn.
pub(crate) struct Drawing {
    /// Whether it was not drawn yet.
    is_new: bool,
    /// Whether it has the panels' colour before anything is drawn.
    pub(crate) is_cleared: bool,
    /// Whether software draws it.
    is_software: bool,
}

impl Drawing {
    /// A new window.
    const NEW: Self = Self { is_new: true, is_cleared: false, is_software: false };

    /// Passes per second at most.
    fn most_passes(&self) -> f64 {
        if self.is_software { PASSES_OF_SOFTWARE } else { PASSES }
    }
}

/// Times of the interface's passes.
struct Measured {
    begun: Instant,
    /// The first pass, and the first picture.
    first: [Option<Instant>; 2],
    intervals: Vec<f32>,
    passes: Vec<f32>,
    memory: Option<u64>,
}

impl Viewer {
    /// Starts the engine; the viewer has been about to start since `begun`. `shared` synthesises and draws the window.
    pub fn new(start: Start, begun: Instant, shared: Option<Gpu>) -> Self {
        let mut settings = start.settings();
        settings.rate = start.rate.unwrap_or(settings.rate);
        let (opening, request, dials) = (start.opening.clone(), start.request.clone(), start.dials.clone());
        let engine = Engine::with(opening, request, dials, STORE_BYTES, shared.clone());
        let table = Arc::new(ToneTable::new(settings.display));
        let now = Instant::now();
        Self {
            state: State::new(settings.clone(), start.dials.clone()),
            engine,
            status: Status::default(),
            reach: Reach { span: None, frames: None, burst: 1 },
            shown: None,
            kinds: Arc::default(),
            table,
            typed: start.request.name(),
            type_now: false,
            messages: VecDeque::new(),
            actions: Vec::new(),
            bindings: bindings(),
            shared,
            drawing: Drawing::NEW,
            waits: false,
            start,
            jobs: channel(),
            saved: settings,
            last: now,
            measured: Measured {
                begun,
                first: [None; 2],
                intervals: Vec::new(),
                passes: Vec::new(),
                memory: None,
            },
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
            self.state.nets = nets(pattern.as_ref(), &self.start.dials.weights);
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
        if self.table.display() != self.state.settings.display {
            self.table = Arc::new(ToneTable::new(self.state.settings.display));
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
            self.actions.push(Action::Open(Request::Path(file.path().to_owned())));
        }
    }

    /// Takes over, at first, how large everything was drawn last time, and remembers it and the window's size.
    fn remember_window(&mut self, ctx: &egui::Context) {
        let settings = &mut self.state.settings;
        if std::mem::take(&mut self.drawing.is_new) {
            ctx.set_zoom_factor(settings.scale);
            self.engine.on_news({
                let ctx = ctx.clone();
                move || ctx.request_repaint()
            });
            return;
        }
        settings.scale = ctx.zoom_factor().clamp(SCALES[0], SCALES[1]);
        let window = ctx.input(|input| {
            let viewport = input.viewport();
            let usual = viewport.maximized != Some(true) && viewport.fullscreen != Some(true);
            viewport.inner_rect.filter(|_| usual).map(|rect| rect.size() * settings.scale)
        });
        if let Some(size) = window {
            settings.window = [size.x, size.y].map(|side| side.clamp(WINDOW[0], WINDOW[1]));
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

    /// Does what an action asks of others.
    fn carry_out(&mut self, effect: Option<Effect>, ctx: &egui::Context) {
        let Some(effect) = effect else { return };
        let picture = self.state.settings.pictures().get(self.state.pane).copied().unwrap_or(Picture::Ours);
        let folder = self.start.out.clone();
        match effect {
            Effect::Seek(frame) => self.engine.seek(frame),
            Effect::Tune(dials, frame) => self.engine.tune(dials, frame),
            Effect::Open(request) => {
                self.typed = request.name();
                self.shown = None;
                self.engine.open(request);
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
        ctx.set_theme(match self.state.settings.theme {
            Theme::System => egui::ThemePreference::System,
            Theme::Dark => egui::ThemePreference::Dark,
            Theme::Light => egui::ThemePreference::Light,
        });
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        if let Some(path) = self.start.settings.as_ref().filter(|_| self.saved != self.state.settings)
            && let Err(error) = self.state.settings.write(path)
        {
            tracing::warn!("settings are not kept: {error}");
        }
    }
}

impl Message {
    fn good(text: String) -> Self {
        Self { text, bad: false, since: Instant::now() }
    }

    fn bad(text: String) -> Self {
        Self { text, bad: true, since: Instant::now() }
    }
}

/// Bytes of memory that the process holds, where the system says (Linux).
pub(crate) fn resident_bytes() -> Option<u64> {
    system::status("VmRSS:")
}

/// The viewer as eframe wants it; it is handed back when the window is closed.
struct Window {
    viewer: Option<Viewer>,
    back: Rc<RefCell<Option<Viewer>>>,
}

impl eframe::App for Window {
    /// What panels are filled with: where software draws, filling them costs as much as all that they hold.
    fn clear_color(&self, visuals: &egui::Visuals) -> [f32; 4] {
        visuals.panel_fill.to_normalized_gamma_f32()
    }

    fn ui(&mut self, ui: &mut egui::Ui, frame: &mut eframe::Frame) {
        if let Some(viewer) = &mut self.viewer {
            if viewer.drawing.is_new && viewer.drawing.is_software {
                // There is no screen to wait for, and what is drawn by software should not queue as well.
                frame.set_wgpu_surface_config(egui_wgpu::SurfaceConfig {
                    present_mode: wgpu::PresentMode::AutoNoVsync,
                    desired_maximum_frame_latency: Some(1),
                });
            }
            viewer.show(ui);
        }
    }

    fn on_exit(&mut self) {
        *self.back.borrow_mut() = self.viewer.take();
    }
}

/// Opens the window, and returns when it is closed.
pub fn run(start: Start) -> Result<Pace> {
    let begun = Instant::now();
    // Before anything else: the engine and its drivers may have more to say about a missing display than one line.
    if let Some(problem) = no_display() {
        return Err(no_window(&problem));
    }
    let shared = start.shared_gpu(&start.dials)?;
    let mut viewer = Viewer::new(start, begun, shared);
    for _ in 0..=REOPENINGS {
        viewer = open_window(viewer)?;
        let Some(problem) = viewer.lost() else { return Ok(viewer.pace()) };
        tracing::warn!("{problem}; the window is opened anew");
        let shared = viewer.start.shared_gpu(&viewer.state.dials).unwrap_or_else(|error| {
            tracing::warn!("no GPU is shared any more: {error}");
            None
        });
        viewer.reopen(shared, &problem);
    }
    Err(Error::Usage(format!(
        "the GPU was lost {} times; --window-device own keeps the window",
        REOPENINGS + 1
    )))
}

/// Opens a window, and gives the viewer back when it is closed.
fn open_window(viewer: Viewer) -> Result<Viewer> {
    let viewport = egui::ViewportBuilder::default()
        .with_title(format!("pix2hdr: {}", viewer.start.request.name()))
        .with_app_id("pix2hdr")
        .with_inner_size(viewer.state.settings.window)
        .with_min_inner_size([200.0, 150.0])
        .with_drag_and_drop(true);
    // Pictures are dithered by themselves; the rest has no gradients.
    let mut options =
        eframe::NativeOptions { viewport, dithering: false, ..eframe::NativeOptions::default() };
    options.wgpu_options.wgpu_setup = match &viewer.shared {
        Some(gpu) => {
            let (instance, adapter, device, queue) = gpu.parts();
            egui_wgpu::WgpuSetup::Existing(egui_wgpu::WgpuSetupExisting { instance, adapter, device, queue })
        }
        None => own_device(),
    };
    let back = Rc::new(RefCell::new(None));
    let outcome = eframe::run_native(
        "pix2hdr",
        options,
        Box::new({
            let back = Rc::clone(&back);
            move |context| {
                let mut viewer = viewer;
                viewer.drawing.is_cleared = true;
                if let Some(state) = &context.wgpu_render_state {
                    viewer.drawn_by(state);
                    // Smooth edges are many small triangles.
                    let smooth = !viewer.drawing.is_software;
                    context.egui_ctx.tessellation_options_mut(|options| options.feathering = smooth);
                }
                Ok(Box::new(Window { viewer: Some(viewer), back }))
            }
        }),
    );
    outcome.map_err(|error| no_window(&error.to_string()))?;
    back.take().ok_or_else(|| no_window("it was closed before it was open"))
}

/// How a device is opened that draws and does nothing else.
fn own_device() -> egui_wgpu::WgpuSetup {
    let mut setup = egui_wgpu::WgpuSetupCreateNew::without_display_handle();
    setup.device_descriptor = Arc::new(|adapter| {
        let most = adapter.limits();
        wgpu::DeviceDescriptor {
            label: Some("window"),
            required_limits: wgpu::Limits {
                // Planes of large frames.
                max_buffer_size: most.max_buffer_size,
                max_storage_buffer_binding_size: most.max_storage_buffer_binding_size,
                max_texture_dimension_2d: most.max_texture_dimension_2d,
                ..wgpu::Limits::default()
            },
            ..wgpu::DeviceDescriptor::default()
        }
    });
    setup.into()
}

/// Why there can be no window, where that can be told without opening one.
fn no_display() -> Option<String> {
    let named = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
    if !cfg!(all(unix, not(target_os = "macos")))
        || named("WAYLAND_DISPLAY").is_some()
        || named("WAYLAND_SOCKET").is_some()
    {
        return None;
    }
    let Some(display) = named("DISPLAY") else { return Some("there is no display".into()) };
    (!answers(&display)).then(|| format!("no X server answers at DISPLAY={display}"))
}

/// Whether a server may answer at an X display; only those of this machine are asked.
#[cfg(target_os = "linux")]
fn answers(display: &str) -> bool {
    use std::os::linux::net::SocketAddrExt;
    use std::os::unix::net::{SocketAddr, UnixStream};

    let display = display.strip_prefix("unix:").map_or(display.strip_prefix(':'), Some);
    let Some(number) = display.and_then(|rest| rest.split('.').next()) else { return true };
    // Servers listen at a path and, for those in a container of their own, at the same name without a file.
    let path = format!("/tmp/.X11-unix/X{number}");
    let unnamed =
        SocketAddr::from_abstract_name(&path).and_then(|address| UnixStream::connect_addr(&address));
    unnamed.or_else(|_| UnixStream::connect(&path)).is_ok()
}

#[cfg(not(target_os = "linux"))]
fn answers(_: &str) -> bool {
    true
}

fn no_window(problem: &str) -> Error {
    // What the window's library says begins with where in its source it says it.
    let problem = problem.lines().next().unwrap_or_default().rsplit(": ").next().unwrap_or_default();
    Error::Usage(format!(
        "cannot open a window: {problem}; without one, `pix2hdr synth` and `pix2hdr demo` write files"
    ))
}

//! The viewer without a window: the engine's promises, and the interface through its accessibility tree.

#[path = "support/offscreen.rs"]
mod offscreen;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use eframe::egui::{self, Key, Modifiers};
use eframe::egui_wgpu::{self, RenderState};
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};
use pix2hdr::gpu::{AdapterChoice, Gpu};
use pix2hdr::network::Precision;
use pix2hdr::scene::{Rendering, Speed, procedural, render};
use pix2hdr::sensor::{Capture, Form, Pattern, Sampler, Timing};
use pix2hdr::synth::{Backend, ExecutorChoice as Executor, Settings, Skip, Synthesizer};
use pix2hdr::video::{self, Video, Writing};
use pix2hdr_viewer::action::Action;
use pix2hdr_viewer::clock::Reach;
use pix2hdr_viewer::engine::{Engine, Phase, Status};
use pix2hdr_viewer::picture::Picture;
use pix2hdr_viewer::preferences::{Arrangement, Preferences};
use pix2hdr_viewer::source::{Opening, SourceName};
use pix2hdr_viewer::tone::Curve;
use pix2hdr_viewer::{Start, Viewer, WindowDevice};

const EXTENT: [usize; 2] = [24, 32];
/// Long enough for the slowest machine; nothing waits for as long where all is well.
const PATIENCE: Duration = Duration::from_mins(2);

fn sampler() -> Sampler {
    Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap()
}

fn opening() -> Opening {
    Opening {
        sampler: sampler(),
        extent: EXTENT,
        seed: 0,
        speed: Speed::Slow,
        keys: serde_json::Map::new(),
        truth: None,
        plain: false,
    }
}

fn settings() -> Settings {
    Settings {
        weights: "fast".into(),
        executor: Executor::Cpu,
        adapter: None,
        precision: Precision::F32,
        skip: Skip::Off,
        tile: None,
        hop: None,
        ensemble: 1,
        accumulate: false,
    }
}

fn scene(frames: usize) -> Video {
    let [height, width] = EXTENT;
    let scene = procedural::by_name("fan", height, width, 0).unwrap();
    let how = Rendering { frames, height, width, instants: 2, positions: 1, seed: 0 };
    let mut video = render(&*scene, how, || ());
    video.normalise();
    video
}

/// A capture in `folder`, with what `synth` makes of it.
fn capture(folder: &Path, frames: usize) -> (PathBuf, Capture, Video) {
    let capture = sampler().sample(&scene(frames)).unwrap();
    capture.write(folder.join("capture")).unwrap();
    let model = pix2hdr::network::Model::load("fast").unwrap();
    let mut synthesizer =
        Synthesizer::new(&model, capture.calibration(), EXTENT, &Backend::Cpu, &Settings::default()).unwrap();
    let (result, _) = synthesizer.video(&capture).unwrap();
    (folder.join("capture"), capture, result)
}

/// Waits until something is there.
fn wait<T>(what: &str, mut found: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(found) = found() {
            return found;
        }
        assert!(begun.elapsed() < PATIENCE, "{what} does not come");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn failure(status: &Status) -> Option<String> {
    match &status.phase {
        Phase::Failed(problem) => Some(problem.clone()),
        _ => None,
    }
}

/// A file loses no frame, in whatever order it is looked at, and each one is what `synth` writes, to the bit.
#[test]
fn a_file_is_shown_to_the_bit_and_none_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let frames = 70;
    let (path, capture, result) = capture(folder.path(), frames);
    let measurement = capture.measurement();
    // Room for the least number of frames: most of them have to wait.
    let engine = Engine::start(opening(), SourceName::Path(path), settings(), 1);
    let check = |number: usize| {
        engine.store.move_to(number);
        let frame = wait("a frame", || {
            assert_eq!(failure(&engine.status()), None);
            engine.store.at(number).filter(|frame| frame.number == number)
        });
        assert_eq!(frame.ours.as_deref(), Some(result.frame(number)), "frame {number}");
        assert_eq!(frame.mosaic.as_deref(), Some(measurement.frame(number)), "mosaic of frame {number}");
        assert!(frame.truth.is_none() && frame.filtered.is_some());
    };
    (0..frames).for_each(check);
    for number in [50, 3, 69, 0] {
        engine.seek(number);
        check(number);
    }
    (1..frames).for_each(check);
    wait("the end", || (engine.status().phase == Phase::Finished).then_some(()));
    assert_eq!(engine.status().dropped, 0);
    assert_eq!(engine.status().about.frames, Some(frames));
}

/// A live camera that runs faster than anything can follow: frames are dropped and counted, none twice or out of
/// order, and what is shown stays near the camera.
#[test]
fn a_live_camera_drops_frames_and_counts_them() {
    let engine = Engine::start(opening(), SourceName::Scene("fan".into()), settings(), 1 << 20);
    wait("the engine", || (engine.status().phase == Phase::Running).then_some(()));
    engine.clock.set_rate(200_000.0, Instant::now());
    wait("drops", || {
        assert_eq!(failure(&engine.status()), None);
        (engine.status().dropped > 1000 && engine.status().frames > 100).then_some(())
    });
    engine.clock.set_rate(0.0, Instant::now());
    let status = wait("quiet", || {
        let (before, newest) = (engine.status(), engine.store.span());
        std::thread::sleep(Duration::from_millis(300));
        (engine.status().frames == before.frames && engine.store.span() == newest).then(|| engine.status())
    });
    let [_, last] = engine.store.span().unwrap();
    let exposed = engine.clock.exposed(Instant::now());
    // All frames up to the newest were either delivered or dropped; those on their way are neither.
    let accounted = status.frames + status.dropped;
    assert!(
        accounted > last as u64 && accounted as f64 <= exposed,
        "{accounted}, newest {last} of {exposed}"
    );
    let numbers: Vec<usize> = engine.store.between(0, usize::MAX).iter().map(|frame| frame.number).collect();
    assert!(numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
    let (frames, bytes) = engine.store.size();
    assert!(bytes <= 1 << 20, "{frames} frames of {bytes} bytes");
}

/// At a pace that can be followed nothing is dropped, and each frame has its truth.
#[test]
fn a_slow_live_camera_drops_nothing() {
    let engine = Engine::start(opening(), SourceName::Scene("leds".into()), settings(), 1 << 24);
    wait("the engine", || (engine.status().phase == Phase::Running).then_some(()));
    engine.clock.set_rate(40.0, Instant::now());
    wait("frames", || engine.store.span().filter(|[_, last]| *last >= 20));
    let frames = engine.store.between(0, 20);
    assert_eq!(frames.iter().map(|frame| frame.number).collect::<Vec<_>>(), (0..=20).collect::<Vec<_>>());
    assert!(frames.iter().all(|frame| frame.truth.is_some() && frame.ours.is_some()));
    assert_eq!(engine.status().dropped, 0);
}

/// Dials change while the engine runs; what cannot be done is said, and can be undone.
#[test]
fn dials_respond_and_a_refusal_can_be_undone() {
    let folder = tempfile::tempdir().unwrap();
    let (path, _, result) = capture(folder.path(), 40);
    let engine = Engine::start(opening(), SourceName::Path(path), settings(), 1 << 24);
    wait("a frame", || engine.store.at(0));
    engine.tune(Settings { skip: Skip::Bounded(0.002), ..settings() }, 5);
    let frame =
        wait("a frame with cells", || engine.store.at_or_after(5).filter(|frame| frame.computed.is_some()));
    assert_eq!(frame.number, 5);
    engine.tune(Settings { precision: Precision::F16, ..settings() }, 7);
    let problem = wait("a refusal", || failure(&engine.status()));
    assert!(problem.contains("f16") && !problem.contains('\n'), "{problem}");
    engine.tune(Settings { weights: "no such net".into(), ..settings() }, 7);
    wait("a refusal", || failure(&engine.status()).filter(|problem| problem.contains("no such net")));
    engine.tune(settings(), 7);
    let frame = wait("a frame", || engine.store.at(7).filter(|frame| frame.number == 7));
    assert_eq!(frame.ours.as_deref(), Some(result.frame(7)));
}

/// Bad files, missing ones, and odd sizes end in a line that names the file, and the next source opens.
#[test]
fn bad_sources_are_named_and_odd_sizes_are_shown() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("broken.npy"), b"\x93NUMPY nonsense").unwrap();
    std::fs::write(path("broken.exr"), b"nonsense").unwrap();
    std::fs::write(path("note.txt"), b"nonsense").unwrap();
    std::fs::create_dir(path("empty")).unwrap();
    let (good, ..) = capture(folder.path(), 20);
    std::fs::copy(good.join("capture.npy"), path("bare.npy")).unwrap();
    let engine = Engine::start(opening(), SourceName::Path(path("missing")), settings(), 1 << 24);
    wait("a refusal", || failure(&engine.status()).filter(|p| p.contains("missing") && p.contains("fan")));
    // Of a bare array, what is missing is named.
    for (name, named) in [
        ("broken.npy", "broken.npy"),
        ("broken.exr", "broken.exr"),
        ("note.txt", "note.txt"),
        ("empty", "empty"),
        ("bare.npy", "bare.json"),
    ] {
        engine.open(SourceName::Path(path(name)));
        let problem = wait(name, || failure(&engine.status()).filter(|problem| problem.contains(named)));
        assert!(!problem.contains('\n'), "{problem}");
    }
    // The smallest a pattern allows, a prime and a flat one.
    for [height, width] in [[2, 4], [13, 17], [2, 61]] {
        let video = Video::new(9, height, width, vec![0.25; 9 * height * width]).unwrap();
        let name = format!("{height}x{width}.npy");
        video::write(path(&name), &video, Writing::default()).unwrap();
        engine.open(SourceName::Path(path(&name)));
        let frame = wait("a frame", || {
            assert!(failure(&engine.status()).is_none_or(|p| !p.contains(&name)), "{:?}", engine.status());
            engine.store.at(8).filter(|frame| frame.number == 8 && frame.width == width)
        });
        assert!(frame.ours.iter().flatten().all(|p| p.is_finite()));
        assert_eq!(frame.truth.as_ref().map(Vec::len), Some(height * width));
    }
    // One too small for the pattern is refused in words.
    video::write(path("dot.npy"), &Video::black(3, 1, 1), Writing::default()).unwrap();
    engine.open(SourceName::Path(path("dot.npy")));
    wait("a refusal", || failure(&engine.status()).filter(|problem| problem.contains("dot.npy")));
}

/// A source that is unplugged while it plays ends in a line that names it; what was there stays.
#[test]
fn a_source_that_goes_away_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    // Longer than what the reader has in its buffer.
    let [height, width] = EXTENT;
    let grey = Video::new(2000, height, width, vec![0.25; 2000 * height * width]).unwrap();
    sampler().sample(&grey).unwrap().write(&path).unwrap();
    let engine = Engine::start(opening(), SourceName::Path(path.clone()), settings(), 1);
    let shown = wait("a frame", || engine.store.at(0));
    let array = std::fs::OpenOptions::new().write(true).open(path.join("capture.npy")).unwrap();
    array.set_len(array.metadata().unwrap().len() / 4).unwrap();
    let mut playhead = 0;
    let problem = wait("a message", || {
        playhead = (playhead + 4).min(1999);
        engine.store.move_to(playhead);
        let status = engine.status();
        assert_ne!(status.phase, Phase::Finished, "{} frames", status.frames);
        failure(&status)
    });
    assert!(problem.contains("capture.npy") && !problem.contains('\n'), "{problem}");
    assert!(engine.store.span().is_some() && shown.ours.is_some());
    std::fs::remove_dir_all(&path).unwrap();
    engine.seek(5);
    wait("a message", || failure(&engine.status()).filter(|p| p.contains("capture") && *p != problem));
}

/// What a live camera sees is there before there is a result, and moves on with its clock.
#[test]
fn a_live_camera_shows_what_it_sees_before_there_is_a_result() {
    // Large enough for the first window to take a while.
    let large = Opening { extent: [192, 192], ..opening() };
    let engine = Engine::start(large, SourceName::Scene("fan".into()), settings(), 1 << 24);
    let status = wait("frames of the camera", || {
        let status = engine.status();
        assert_eq!(status.frames, 0, "the test is too slow to see them");
        (status.arriving.len() == 64).then_some(status)
    });
    let number = |exposed| status.preview(exposed).map(|frame| frame.number);
    assert_eq!([number(64.0), number(70.5), number(900.0)], [Some(0), Some(6), Some(63)]);
    let frame = status.preview(64.0).unwrap();
    assert!(frame.mosaic.is_some() && frame.truth.is_some() && frame.ours.is_none());
    wait("a result", || engine.store.at(0));
    assert!(engine.status().arriving.is_empty());
}

/// Sample and hold, ground truth, and videos as they are.
#[test]
fn captures_that_hold_have_their_truth_and_videos_can_be_plain() {
    let folder = tempfile::tempdir().unwrap();
    let truth = scene(30);
    let mut sampler = sampler();
    sampler.timing = Timing::Hold;
    sampler.sample(&truth).unwrap().write(folder.path().join("held")).unwrap();
    let video = folder.path().join("truth.npy");
    video::write(&video, &truth, Writing { half: false, ..Writing::default() }).unwrap();
    let with_truth = Opening { truth: Some(video.clone()), ..opening() };
    let engine = Engine::start(with_truth, SourceName::Path(folder.path().join("held")), settings(), 1 << 24);
    let frame = wait("a frame", || {
        assert_eq!(failure(&engine.status()), None);
        engine.store.at(12).filter(|frame| frame.number == 12)
    });
    assert_eq!(frame.truth.as_deref(), Some(truth.frame(12)));
    let plain =
        Engine::start(Opening { plain: true, ..opening() }, SourceName::Path(video), settings(), 1 << 24);
    let frame = wait("a frame", || plain.store.at(29).filter(|frame| frame.number == 29));
    assert_eq!(frame.ours.as_deref(), Some(truth.frame(29)));
    assert!(frame.mosaic.is_none() && frame.truth.is_none());
}

/// An array of counts alone is no video; what it lacks can be said.
#[test]
fn a_bare_array_is_a_capture_if_its_pattern_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let (path, capture, _) = capture(folder.path(), 40);
    let bare = folder.path().join("bare.npy");
    std::fs::copy(path.join("capture.npy"), &bare).unwrap();
    let engine = Engine::start(opening(), SourceName::Path(bare.clone()), settings(), 1 << 24);
    let problem = wait("a message", || failure(&engine.status()));
    assert!(problem.contains("bare.json") && problem.contains("--pattern"), "{problem}");
    let keys = serde_json::json!({ "pattern": "mpve-1-4", "bit_depth": 10 });
    let named = Opening { keys: keys.as_object().unwrap().clone(), ..opening() };
    let engine = Engine::start(named, SourceName::Path(bare), settings(), 1 << 24);
    let frame = wait("a frame", || {
        assert_eq!(failure(&engine.status()), None);
        engine.store.at(12).filter(|frame| frame.number == 12)
    });
    assert_eq!(frame.mosaic.as_deref(), Some(capture.measurement().frame(12)));
}

/// Software Vulkan, or whatever GPU there is.
fn gpu() -> Gpu {
    Gpu::open(&AdapterChoice { substring: None, allow_software: true }).unwrap()
}

/// What egui draws with on the device of `gpu`.
fn render_state(gpu: &Gpu) -> RenderState {
    let (instance, adapter, device, queue) = gpu.parts();
    let existing = egui_wgpu::WgpuSetupExisting { instance: instance.clone(), adapter, device, queue };
    let config = egui_wgpu::WgpuConfiguration { wgpu_setup: existing.into(), ..Default::default() };
    let options = egui_wgpu::RendererOptions::PREDICTABLE;
    pollster::block_on(RenderState::create(&config, &instance, None, options)).unwrap()
}

/// Gives egui's renderer the fonts that the harness has.
struct Textures(Option<RenderState>);

impl egui_kittest::TestRenderer for Textures {
    fn handle_delta(&mut self, delta: &mut egui::TexturesDelta) {
        let Some(RenderState { device, queue, renderer, .. }) = &self.0 else {
            delta.clear();
            return;
        };
        let mut renderer = renderer.write();
        for (id, images) in delta.set.drain() {
            images.iter().for_each(|image| renderer.update_texture(device, queue, id, image));
        }
        delta.free.drain().for_each(|id| renderer.free_texture(&id));
    }
}

/// Width, height, and R, G, B of every pixel.
type Image = (usize, usize, Vec<u8>);

/// What a screen would show after the last pass.
fn image(interface: &Interface) -> Image {
    let RenderState { device, queue, renderer, target_format, .. } = interface.state.as_ref().unwrap();
    let ctx = &interface.harness.ctx;
    let jobs = ctx.tessellate(interface.harness.output().shapes.clone(), 1.0);
    let size = ctx.content_rect().size();
    let [width, height] = [size.x as u32, size.y as u32];
    let screen = egui_wgpu::ScreenDescriptor { size_in_pixels: [width, height], pixels_per_point: 1.0 };
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let more = renderer.write().update_buffers(device, queue, &mut encoder, &jobs, &screen);
    let mut pixels =
        offscreen::pixels((device, queue), *target_format, [width, height], encoder, more, |pass| {
            renderer.read().render(pass, &jobs, &screen);
        });
    // The source's name is another one in every run.
    let [rows, cols] = [0..34, 72..206];
    for y in rows {
        pixels[3 * (y * width as usize + cols.start)..][..3 * cols.len()].fill(0);
    }
    (width as usize, height as usize, pixels)
}

/// The interface, driven through its accessibility tree.
struct Interface {
    harness: Harness<'static, Viewer>,
    folder: tempfile::TempDir,
    /// What draws it, if anything does.
    state: Option<RenderState>,
}

impl Interface {
    fn new(size: [f32; 2], frames: usize) -> Self {
        Self::with(size, frames, settings(), None, None)
    }

    /// An interface that a device draws; where it is `shared`, the settings' executor may compute there.
    fn with(
        size: [f32; 2],
        frames: usize,
        settings: Settings,
        state: Option<RenderState>,
        shared: Option<Gpu>,
    ) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let truth = folder.path().join("truth.npy");
        video::write(&truth, &scene(frames), Writing::default()).unwrap();
        let start = Start {
            source: SourceName::Path(truth),
            opening: opening(),
            settings,
            out: folder.path().join("out"),
            preferences: Some(folder.path().join("view.json")),
            rate: Some(1.0),
            seconds: None,
            device: WindowDevice::Auto,
        };
        let mut viewer = Viewer::new(start, Instant::now(), shared);
        if let Some(state) = &state {
            viewer.drawn_by(state);
        }
        let harness = Harness::builder()
            .with_size(egui::Vec2::from(size))
            .renderer(Textures(state.clone()))
            .build_ui_state(|ui, viewer: &mut Viewer| viewer.show(ui), viewer);
        let mut interface = Self { harness, folder, state };
        interface.until("a picture", |viewer| viewer.shown().is_some());
        interface
    }

    /// Passes of the interface until something is so.
    fn until(&mut self, what: &str, is: impl Fn(&Viewer) -> bool) {
        let begun = Instant::now();
        while !is(self.harness.state()) {
            self.harness.step();
            assert!(
                begun.elapsed() < PATIENCE,
                "{what} does not come: {:?}",
                self.harness.state().status().phase
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn press(&mut self, modifiers: Modifiers, key: Key) {
        self.harness.key_press_modifiers(modifiers, key);
        self.harness.run_steps(2);
    }

    fn click(&mut self, label: &str) {
        self.harness.get_by_label(label).click();
        self.harness.run_steps(3);
    }

    fn preferences(&self) -> &Preferences {
        &self.harness.state().state.preferences
    }
}

#[test]
fn buttons_and_keys_change_the_state() {
    let mut interface = Interface::new([1400.0, 800.0], 40);
    interface.click("pause");
    assert!(!interface.harness.state().state.clock.playing);
    interface.harness.get_by_label("play");
    interface.press(Modifiers::NONE, Key::Home);
    interface.press(Modifiers::NONE, Key::ArrowRight);
    interface.press(Modifiers::SHIFT, Key::ArrowRight);
    interface.until("frame 11", |viewer| viewer.shown().is_some_and(|frame| frame.number == 11));
    interface.press(Modifiers::NONE, Key::ArrowLeft);
    interface.until("frame 10", |viewer| viewer.shown().is_some_and(|frame| frame.number == 10));
    interface.click("A|B");
    assert_eq!(interface.preferences().arrangement, Arrangement::Divider);
    interface.press(Modifiers::NONE, Key::CloseBracket);
    assert!((interface.preferences().divider - 0.52).abs() < 1e-5);
    interface.press(Modifiers::NONE, Key::Num6);
    assert_eq!(interface.preferences().pair[0], Picture::Difference);
    interface.press(Modifiers::NONE, Key::E);
    interface.press(Modifiers::NONE, Key::T);
    assert_eq!(
        (interface.preferences().display.exposure, interface.preferences().display.curve),
        (0.5, Curve::Reinhard)
    );
    interface.click("clipping");
    assert!(interface.preferences().display.clipping);
    interface.press(Modifiers::NONE, Key::X);
    assert_eq!(interface.harness.state().state.picks.len(), 1);
    interface.press(Modifiers::NONE, Key::H);
    interface.harness.get_by_label("play or pause");
    // What is typed into a field is no shortcut.
    interface.press(Modifiers::NONE, Key::H);
    interface.press(Modifiers::NONE, Key::Space);
    assert!(interface.harness.state().state.clock.playing);
}

/// Every arrangement, picture and curve at every size, from tiny to 4K: no panic, and the pictures are drawn.
#[test]
fn every_view_draws_at_every_size() {
    let mut interface = Interface::new([1280.0, 800.0], 20);
    interface.press(Modifiers::NONE, Key::X);
    for size in [[200.0, 150.0], [60.0, 40.0], [640.0, 900.0], [3840.0, 2160.0]] {
        interface.harness.set_size(egui::Vec2::from(size));
        for arrangement in Arrangement::ALL {
            for (i, picture) in Picture::ALL.into_iter().enumerate() {
                let viewer = interface.harness.state_mut();
                let reach = Reach { span: None, frames: None, burst: 1 };
                viewer.state.apply(Action::Arrange(arrangement), reach);
                viewer.state.apply(Action::Show(i % arrangement.panes(), picture), reach);
                viewer.state.apply(Action::NextCurve, reach);
                interface.harness.step();
            }
        }
        for action in
            [Action::Zoom(40.0, None), Action::Pan([-1e5, 1e5]), Action::Fit, Action::Zoom(1e-6, None)]
        {
            let viewer = interface.harness.state_mut();
            let reach = Reach { span: None, frames: None, burst: 1 };
            viewer.state.apply(action, reach);
            interface.harness.step();
        }
    }
}

#[test]
fn frames_and_ranges_are_written_and_settings_remembered() {
    let mut interface = Interface::new([1400.0, 800.0], 24);
    interface.until("all frames", |viewer| viewer.status().phase == Phase::Finished);
    interface.click("pause");
    interface.press(Modifiers::NONE, Key::Home);
    interface.click("EXR");
    interface.click("PNG");
    interface.press(Modifiers::NONE, Key::R);
    let out = interface.folder.path().join("out");
    let files = ["frame-00000.exr", "frame-00000.png", "range-00000-00023"].map(|name| out.join(name));
    interface.until("files", |_| files.iter().all(|file| file.exists()));
    assert_eq!(video::read(&files[2]).unwrap().frames, 24);
    interface.press(Modifiers::NONE, Key::V);
    let (preferences, path) = (interface.preferences().clone(), interface.folder.path().join("view.json"));
    drop(interface.harness);
    assert_eq!(Preferences::read(&path), preferences);
}

const ALL: Reach = Reach { span: Some([0, 23]), frames: Some(24), burst: 8 };

/// Stops at frame 12, and shows what `actions` want of it.
fn look(interface: &mut Interface, actions: &[Action]) {
    for action in [Action::GoTo(12)].iter().chain(actions) {
        interface.harness.state_mut().state.apply(action.clone(), ALL);
    }
    interface.harness.state_mut().state.clock.playing = false;
    interface.until("frame 12", |viewer| viewer.shown().is_some_and(|frame| frame.number == 12));
    interface.harness.run_steps(3);
}

/// A window on the device that synthesises shows what one on a device of its own does, without results in main memory.
#[test]
fn a_window_on_the_device_that_synthesises_shows_the_same() {
    let on_gpu = Settings { weights: "tiny".into(), executor: Executor::Gpu, ..settings() };
    let shared = gpu().shared();
    let state = Some(render_state(&shared));
    let mut interface = Interface::with([700.0, 500.0], 24, on_gpu.clone(), state, Some(shared.clone()));
    let mut other = Interface::with([700.0, 500.0], 24, on_gpu, Some(render_state(&gpu())), None);
    for actions in [
        &[Action::Dials][..],
        &[Action::Show(0, Picture::Difference), Action::Curve(Curve::FalseColour)],
        &[Action::Arrange(Arrangement::Divider), Action::Zoom(7.0, None), Action::Clipping],
    ] {
        look(&mut interface, actions);
        look(&mut other, actions);
        assert!(interface.harness.state().is_drawn_from_gpu() && !other.harness.state().is_drawn_from_gpu());
        let (a, b) = (image(&interface), image(&other));
        let most = a.2.iter().zip(&b.2).map(|(a, b)| a.abs_diff(*b)).max();
        assert_eq!((a.0, a.1, a.2.len()), (700, 500, b.2.len()));
        assert!(most <= Some(1) && a.2.iter().any(|v| *v > 100), "{most:?} for {actions:?}");
    }
    shared.check().unwrap();
    // What is put together in main memory is drawn from there.
    interface.harness.key_press(Key::Z);
    interface.harness.run_steps(2);
    assert_ne!(interface.harness.state().state.settings.skip, Skip::Off);
    interface.until("a frame from main memory", |viewer| {
        viewer.shown().is_some_and(|frame| frame.number >= 12 && frame.on_gpu.is_none())
    });
}

/// The device that draws and synthesises goes: the window is closed, and the next one shows results again.
#[test]
fn a_window_whose_device_is_lost_is_opened_anew() {
    let on_gpu = Settings { weights: "tiny".into(), executor: Executor::Gpu, ..settings() };
    let lost = gpu().shared();
    let mut interface =
        Interface::with([700.0, 500.0], 24, on_gpu, Some(render_state(&lost)), Some(lost.clone()));
    interface.until("a result", Viewer::is_drawn_from_gpu);
    assert!(interface.harness.state().lost().is_none());
    lost.destroy();
    interface.until("the loss", |viewer| viewer.lost().is_some());
    interface.harness.step();
    let closes = |interface: &Interface| {
        let output = interface.harness.output().viewport_output.values();
        output.flat_map(|viewport| &viewport.commands).any(|c| *c == egui::ViewportCommand::Close)
    };
    assert!(closes(&interface));
    let next = gpu().shared();
    let viewer = interface.harness.state_mut();
    let problem = viewer.lost().unwrap();
    viewer.reopen(Some(next.clone()), &problem);
    viewer.drawn_by(&render_state(&next));
    assert!(viewer.lost().is_none());
    // A message is measured before it is shown.
    interface.harness.run_steps(3);
    interface.harness.get_by_label_contains("the window was opened anew");
    interface.until("a result", Viewer::is_drawn_from_gpu);
    assert!(!closes(&interface));
}

/// Steps of 256 by which a value of an image may differ from its snapshot, and the part of them that may differ by
/// more: text and edges are not drawn alike by every driver.
const STEPS: u8 = 12;
const PART: f64 = 0.01;

/// Compares an image with a snapshot; `UPDATE_SNAPSHOTS=1` writes it anew.
fn check_image(interface: &Interface, name: &str) {
    let path = Path::new("tests/snapshots").join(format!("{name}.png"));
    let (width, height, found) = image(interface);
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        video::png::write_rgb(&path, found.as_chunks::<3>().0, width).unwrap();
    }
    let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut expected = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut expected).unwrap();
    assert_eq!(expected.len(), 3 * width * height, "{name}");
    let differ = expected.iter().zip(&found).filter(|(a, b)| a.abs_diff(**b) > STEPS).count();
    let part = differ as f64 / found.len() as f64;
    if part > PART {
        let beside = std::env::temp_dir().join(format!("{name}.png"));
        video::png::write_rgb(&beside, found.as_chunks::<3>().0, width).unwrap();
        panic!("{name}: {:.1}% of the image differ; it is in {}", 100.0 * part, beside.display());
    }
}

/// Panes, divider, time series and keys as they look.
#[test]
fn the_main_views_look_as_they_did() {
    let state = Some(render_state(&gpu()));
    let mut interface = Interface::with([860.0, 560.0], 24, settings(), state, None);
    interface.until("all frames", |viewer| viewer.status().phase == Phase::Finished);
    look(&mut interface, &[Action::Dials]);
    check_image(&interface, "four-panes");
    let difference = Action::Show(1, Picture::Difference);
    look(&mut interface, &[Action::Arrange(Arrangement::Divider), difference, Action::Clipping]);
    check_image(&interface, "divider");
    let [pair, sub_frames] = [Action::Arrange(Arrangement::Pair), Action::Show(0, Picture::SubFrames)];
    let picks = [Action::Pick([12, 9]), Action::Pick([5, 20])];
    let curve = Action::Curve(Curve::FalseColour);
    look(&mut interface, &[vec![pair, sub_frames, curve], picks.to_vec()].concat());
    check_image(&interface, "series");
}

/// Points by which what a panel holds may lie elsewhere than in its snapshot.
const TOLERANCE: f64 = 3.0;

/// A line for each thing that can be read or used: role, name, and where it is. Numbers in names, which differ from run to
/// run, are `#`, and so is where such a text begins: it may stand at the right.
fn layout(interface: &Interface) -> Vec<(String, [f64; 2])> {
    let mut things = Vec::new();
    for node in interface.harness.root().children_recursive() {
        let node = node.accesskit_node();
        let name = node.label().or_else(|| node.value()).unwrap_or_default();
        // Runs of text repeat the labels that they are in.
        let counts = !name.is_empty() && node.role() != egui::Role::TextRun;
        let Some(rect) = node.bounding_box().filter(|_| counts) else { continue };
        let folder = interface.folder.path().display().to_string();
        let mut masked = String::new();
        for c in name.replace(&folder, "").chars() {
            match c {
                '0'..='9' | '.' if masked.ends_with('#') => {}
                '0'..='9' => masked.push('#'),
                c => masked.push(c),
            }
        }
        let x = if masked.contains('#') { 0.0 } else { rect.x0 };
        things.push((format!("{:?} {masked}", node.role()), [x, rect.y0]));
    }
    things
}

/// Compares the layout with a snapshot; `UPDATE_SNAPSHOTS=1` writes it anew.
fn check_layout(interface: &Interface, name: &str) {
    let path = Path::new("tests/snapshots").join(format!("{name}.txt"));
    let found = layout(interface);
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        let lines: Vec<String> = found.iter().map(|(t, [x, y])| format!("{x:.0}\t{y:.0}\t{t}\n")).collect();
        std::fs::write(&path, lines.concat()).unwrap();
    }
    let snapshot = std::fs::read_to_string(&path).unwrap();
    let expected: Vec<Vec<&str>> = snapshot.lines().map(|line| line.splitn(3, '\t').collect()).collect();
    for (line, (thing, at)) in expected.iter().zip(&found) {
        assert_eq!(line[2], thing, "{name}");
        for (expected, found) in line.iter().zip(at) {
            let expected: f64 = expected.parse().unwrap();
            assert!((expected - found).abs() <= TOLERANCE, "{name}: {thing} is at {at:?}, not {line:?}");
        }
    }
    assert_eq!(expected.len(), found.len(), "{name}: {found:?}");
}

/// What the main panels hold, and where.
#[test]
fn the_main_panels_are_laid_out_as_they_were() {
    let mut interface = Interface::new([1280.0, 800.0], 24);
    interface.until("all frames", |viewer| viewer.status().phase == Phase::Finished);
    let reach = Reach { span: Some([0, 23]), frames: Some(24), burst: 8 };
    let mut check = |name: &str, actions: &[Action]| {
        for action in actions {
            interface.harness.state_mut().state.apply(action.clone(), reach);
        }
        interface.until("frame 12", |viewer| viewer.shown().is_some_and(|frame| frame.number == 12));
        interface.harness.run_steps(3);
        check_layout(&interface, name);
    };
    check("panes-and-dials", &[Action::Play, Action::GoTo(12)]);
    let difference = Action::Show(1, Picture::Difference);
    let skip = Action::Tune(Settings { skip: Skip::Bounded(0.002), ..settings() });
    check("divider", &[Action::Arrange(Arrangement::Divider), difference, skip]);
    check("keys", &[Action::Help, Action::Dials]);
}

/// Without a display, or with one that cannot be reached, a line says what works without.
#[test]
#[cfg(target_os = "linux")]
fn without_a_display_a_line_names_what_works() {
    for display in [None, Some(":4094")] {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_pix2hdr-viewer"));
        for name in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
            command.env_remove(name);
        }
        command.envs(display.map(|display| ("DISPLAY", display)));
        let output = command.output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && output.stdout.is_empty(), "{said}");
        assert_eq!(said.trim_end().lines().count(), 1, "{said}");
        assert!(said.contains("synth") && said.contains("demo") && !said.contains(".rs"), "{said}");
    }
}

/// While synthesis runs as fast as it can, a pass of the interface does not wait for it.
#[test]
fn the_interface_goes_on_while_the_engine_is_stuck() {
    let mut interface = Interface::new([800.0, 600.0], 400);
    // The store is emptied and the engine is at work on something else; the last picture stays, and keys work.
    let viewer = interface.harness.state_mut();
    let reach = Reach { span: None, frames: Some(400), burst: 1 };
    viewer.state.apply(Action::GoTo(390), reach);
    interface.press(Modifiers::NONE, Key::End);
    assert!(interface.harness.state().shown().is_some());
    interface.press(Modifiers::NONE, Key::C);
    assert!(interface.preferences().display.clipping);
    interface.until("the end", |viewer| viewer.shown().is_some_and(|frame| frame.number == 399));
}

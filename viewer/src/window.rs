//! The window: opened on a device, and anew on another one when that is lost.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Instant;

use eframe::{egui, egui_wgpu};

use crate::app::Viewer;
use crate::pace::Pace;
use crate::start::Start;
use pix2hdr::{Error, Result};

/// How often a window is opened again after its GPU was lost.
const REOPENINGS: usize = 3;

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
    let shared = start.shared_gpu(&start.settings)?;
    let mut viewer = Viewer::new(start, begun, shared);
    for _ in 0..=REOPENINGS {
        viewer = open_window(viewer)?;
        let Some(problem) = viewer.lost() else { return Ok(viewer.pace()) };
        tracing::warn!("{problem}; the window is opened anew");
        let shared = viewer.start.shared_gpu(&viewer.state.settings).unwrap_or_else(|error| {
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
        .with_title(format!("pix2hdr: {}", viewer.start.source))
        .with_app_id("pix2hdr")
        .with_inner_size(viewer.state.preferences.window)
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
    outcome.map_err(|error| no_window(&cause(&error)))?;
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

/// Why a window was not opened, in words that help.
fn cause(error: &eframe::Error) -> String {
    use egui_wgpu::WgpuError::{CreateSurfaceError, RequestAdapterError};

    match error {
        // Without any driver there is no surface either, and no reason why.
        eframe::Error::Wgpu(CreateSurfaceError(_) | RequestAdapterError(_)) if cfg!(target_os = "linux") => {
            "no Vulkan driver can draw it: install that of the GPU or, without one, software Vulkan \
             (mesa-vulkan-drivers on Debian, Ubuntu and Fedora, vulkan-swrast on Arch)"
                .into()
        }
        // What the window's library says begins with where in its source it says it.
        error => {
            let text = error.to_string();
            text.lines().next().unwrap_or_default().rsplit(": ").next().unwrap_or_default().to_owned()
        }
    }
}

fn no_window(problem: &str) -> Error {
    Error::Usage(format!(
        "cannot open a window: {problem}; without one, `pix2hdr synth` and `pix2hdr demo` write files"
    ))
}

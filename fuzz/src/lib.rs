//! What is fuzzed: every reader of files, and whatever is done with a file that loads.

pub mod mutate;
pub mod seeds;

use std::path::{Path, PathBuf};

use pix2hdr::cpu::CpuExecutor;
use pix2hdr::network::{Executor, Graph, Model, Plan};
use pix2hdr::sensor::{Calibration, CameraModel, CaptureFile, Defects, Form, Pattern, Response};
use pix2hdr::video;
use serde_json::Map;

/// A target of cargo-fuzz for one [`Reader`].
#[cfg(feature = "libfuzzer")]
#[macro_export]
macro_rules! target {
    ($reader:ident) => {
        $crate::libfuzzer_sys::fuzz_target!(|data: &[u8]| $crate::read($crate::Reader::$reader, data));
    };
}
#[cfg(feature = "libfuzzer")]
#[doc(hidden)]
pub use libfuzzer_sys;

/// Reads `data` as a file for `reader` on a desk that is kept: what every target of cargo-fuzz does.
pub fn read(reader: Reader, data: &[u8]) {
    thread_local!(static DESK: Desk = Desk::new().expect("a folder for files"));
    DESK.with(|desk| desk.read(reader, data));
}

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reader {
    /// `capture.json` beside a sound array.
    CaptureJson,
    /// `capture.npy` beside a sound description.
    CaptureArray,
    /// A video as `.npy`.
    Npy,
    /// A picture as `.exr`.
    Exr,
    /// A picture as `.hdr`.
    Radiance,
    /// A weights file.
    Weights,
    /// A layer graph.
    Graph,
    /// A pattern file.
    Pattern,
    /// A response table.
    Response,
    /// A list of dead pixels.
    DeadPixels,
    /// A camera to simulate.
    Camera,
}

impl Reader {
    /// All of them.
    pub const ALL: [Self; 11] = [
        Self::CaptureJson,
        Self::CaptureArray,
        Self::Npy,
        Self::Exr,
        Self::Radiance,
        Self::Weights,
        Self::Graph,
        Self::Pattern,
        Self::Response,
        Self::DeadPixels,
        Self::Camera,
    ];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::CaptureJson => "capture-json",
            Self::CaptureArray => "capture-array",
            Self::Npy => "npy",
            Self::Exr => "exr",
            Self::Radiance => "radiance",
            Self::Weights => "weights",
            Self::Graph => "graph",
            Self::Pattern => "pattern",
            Self::Response => "response",
            Self::DeadPixels => "dead-pixels",
            Self::Camera => "camera",
        }
    }

    /// Whether its files are text.
    pub fn is_text(self) -> bool {
        !matches!(self, Self::CaptureArray | Self::Npy | Self::Exr | Self::Radiance | Self::Weights)
    }
}

/// Operations of a net that loads up to which it is run.
const MOST_FLOP: f64 = 2e7;
/// Values of buffers up to which it is run.
const MOST_VALUES: usize = 1 << 22;

/// A folder in which files are put before they are read.
pub struct Desk {
    folder: tempfile::TempDir,
}

impl Desk {
    /// A desk with a sound capture on it.
    pub fn new() -> std::io::Result<Self> {
        let folder = tempfile::tempdir()?;
        for reader in [Reader::CaptureJson, Reader::CaptureArray] {
            let desk = Self::path_in(folder.path(), reader);
            std::fs::create_dir_all(desk.parent().unwrap_or(folder.path()))?;
            seeds::capture().write(desk.parent().unwrap_or(folder.path())).map_err(std::io::Error::other)?;
        }
        Ok(Self { folder })
    }

    fn path_in(folder: &Path, reader: Reader) -> PathBuf {
        folder.join(match reader {
            Reader::CaptureJson => "a/capture.json",
            Reader::CaptureArray => "b/capture.npy",
            Reader::Npy => "video.npy",
            Reader::Exr => "picture.exr",
            Reader::Radiance => "picture.hdr",
            Reader::Weights => "weights.safetensors",
            Reader::Graph => "graph.json",
            Reader::Pattern => "pattern.json",
            Reader::Response => "response.csv",
            Reader::DeadPixels => "dead.txt",
            Reader::Camera => "camera.json",
        })
    }

    /// The folder. It stays, with the last file in it, if the process is killed.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Where the file for `reader` lies.
    pub fn path(&self, reader: Reader) -> PathBuf {
        Self::path_in(self.folder.path(), reader)
    }

    /// Reads `data` as a file for `reader`, and uses it if it loads; whether it did. Panics where a promise is broken.
    pub fn read(&self, reader: Reader, data: &[u8]) -> bool {
        let path = self.path(reader);
        std::fs::write(&path, data).expect("the desk can be written");
        match reader {
            Reader::CaptureJson => use_capture(&path.with_file_name("capture.npy")),
            Reader::CaptureArray => use_capture(&path),
            Reader::Npy | Reader::Exr | Reader::Radiance => match video::read(&path) {
                Ok(video) => {
                    assert_eq!(video.data.len(), video.frames * video.height * video.width);
                    assert!(video.data.iter().all(|v| v.is_finite() && *v >= 0.0));
                    true
                }
                Err(error) => told(&error),
            },
            Reader::Weights => match Model::read(&path) {
                Ok(model) => use_model(&model),
                Err(error) => told(&error),
            },
            Reader::Graph => match Graph::from_json(&String::from_utf8_lossy(data)) {
                Ok(graph) => use_graph(graph),
                Err(error) => told(&error),
            },
            Reader::Pattern => match Pattern::load(&path.display().to_string()) {
                Ok(pattern) => {
                    let saturation = pattern.shortest_exposure() as f64;
                    let response = Response::new(Form::Linear, saturation).expect("a linear response");
                    use_calibration(&Calibration::new(&pattern, &response));
                    for t in [-1_000_000_007, -1, 0, 5, 1 << 40] {
                        let readout = pattern.schedule(1, 2).covering(t);
                        assert!(readout.start <= t && t < readout.end(), "{pattern:?}");
                    }
                    assert!(pattern.longest_readout() <= pattern.period());
                    true
                }
                Err(error) => told(&error),
            },
            Reader::Response => match Response::read_form(&path) {
                Ok(form) => match Response::new(form, 2.0) {
                    Ok(response) => {
                        use_response(&response);
                        true
                    }
                    Err(error) => told(&error),
                },
                Err(error) => told(&error),
            },
            Reader::DeadPixels => match Defects::read_pixels(&path) {
                Ok(pixels) => {
                    let pattern = Pattern::built_in("mpve-1-4").expect("a built-in pattern");
                    match Defects::new(&pattern, [6, 8], &pixels, None) {
                        Ok(_) => true,
                        Err(error) => told(&error),
                    }
                }
                Err(error) => told(&error),
            },
            Reader::Camera => match CameraModel::load(&path.display().to_string()) {
                Ok(camera) => {
                    let pattern = Pattern::built_in("mpve-1-4").expect("a built-in pattern");
                    match camera
                        .sampler(pattern)
                        .map_err(Into::into)
                        .and_then(|camera| camera.sample(&seeds::ramp(9, 6, 8)))
                    {
                        Ok(capture) => {
                            let values = capture.measurement();
                            assert!(values.data.iter().all(|y| (0.0..=1.0).contains(y)), "{camera:?}");
                            true
                        }
                        Err(error) => told(&error),
                    }
                }
                Err(error) => told(&error),
            },
        }
    }
}

/// An error is one line that says something. Returns `false`.
fn told(error: &dyn std::error::Error) -> bool {
    let text = error.to_string();
    assert!(!text.trim().is_empty(), "an error without words");
    assert!(text.len() < 10_000, "an error of {} bytes", text.len());
    false
}

fn use_capture(array: &Path) -> bool {
    let mut file = match CaptureFile::open(array, &Map::new()) {
        Ok(file) => file,
        Err(error) => return told(&error),
    };
    use_calibration(&file.recording.calibration());
    use_response(&file.recording.response);
    match file.first_look() {
        Ok(inspection) => inspection.findings().iter().for_each(|finding| drop(finding.to_string())),
        Err(error) => return told(&error),
    }
    let values = match file.pixel_values(file.frames - 1) {
        Ok(values) => values,
        Err(error) => return told(&error),
    };
    assert!(values.iter().all(|y| (0.0..=1.0).contains(y)), "pixel values outside of [0, 1]");
    let frames = file.frames;
    let mut source = file.into_frames();
    let mut read = 0;
    loop {
        let frame = match source.next() {
            Ok(Some(frame)) => frame,
            Ok(None) => break,
            Err(error) => return told(&error),
        };
        read += 1;
        assert!(frame.values().iter().all(|y| (0.0..=1.0).contains(y)), "pixel values outside of [0, 1]");
    }
    assert_eq!(read, frames);
    true
}

fn use_response(response: &Response) {
    let (mut x_before, mut y_before) = (0.0, 0.0);
    for i in 0..=64 {
        let part = f64::from(i) / 64.0;
        let (x, y) = (response.exposure(part), response.value(part * response.saturation()));
        assert!((x_before..=response.saturation()).contains(&x), "x = {x} after {x_before}");
        assert!((y_before..=1.0).contains(&y), "y = {y} after {y_before}");
        (x_before, y_before) = (x, y);
    }
}

fn use_calibration(calibration: &Calibration) {
    assert!(calibration.exposures().iter().all(|e| e.is_finite() && *e > 0.0));
    assert!(calibration.inverse_response().iter().all(|x| x.is_finite() && *x >= 0.0));
    for t in [-(1i64 << 41), -1, 0, 1 << 41] {
        let _ = calibration.exposure(t, 12_345, 54_321);
    }
}

fn use_graph(graph: Graph) -> bool {
    // Random weights are made only for nets that are small.
    let weights = |graph: &Graph| -> Option<usize> {
        let [_, y, x] = graph.granularity().ok()?;
        let shapes = graph.shapes(y, x).ok()?;
        let of = |node: &pix2hdr::network::Node| {
            let conv = node.convolution()?;
            shapes[node.inputs[0].as_str()].c.checked_mul(conv.out_channels)?.checked_mul(conv.taps())
        };
        graph.nodes.iter().filter(|node| node.convolution().is_some()).map(of).sum()
    };
    if weights(&graph).is_none_or(|n| n > 1 << 18) {
        return true;
    }
    match Model::random(graph, 1) {
        Ok(model) => use_model(&model),
        Err(error) => told(&error),
    }
}

fn use_model(model: &Model) -> bool {
    let renders = model.graph.check_renders_video().is_ok();
    let [_, y, x] = model.graph.granularity().expect("it was checked");
    let _ = (model.graph.reach().expect("it was checked"), model.digest());
    let plan = match Plan::lower(model, y, x) {
        Ok(plan) => plan,
        Err(error) => return told(&error),
    };
    if plan.flop() > MOST_FLOP || plan.slots.iter().sum::<usize>() > MOST_VALUES {
        return true;
    }
    let pattern = Pattern::built_in("mpve-1-4").expect("a built-in pattern");
    let response = Response::new(Form::Linear, 2.0).expect("a linear response");
    let mut executor = CpuExecutor::<f32>::new(plan.clone(), Calibration::new(&pattern, &response));
    let measurement: Vec<f32> = (0..plan.measurement.shape.len()).map(|i| (i % 89) as f32 / 88.0).collect();
    let mut result = vec![0.0; plan.result.shape.len()];
    executor.run(&measurement, 3, &mut result).expect("a plan of the right size runs");
    assert!(!renders || result.iter().all(|p| p.is_finite()), "a result that is not finite");
    true
}

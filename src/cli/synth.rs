//! `pix2hdr synth`: the main job.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use pix2hdr::baseline::box_filter;
use pix2hdr::quality::{Comparison, ContactSheet, Panel};
use pix2hdr::sensor::{Capture, Timing, check_exposure_ratio, hold_to_covering};
use pix2hdr::synth::{Report, check_fits};
use pix2hdr::video::{self, PreviewWriter, Video, VideoWriter, Writing};
use pix2hdr::{Error, Result};
use serde_json::{Value, json};

use super::options::{CaptureOptions, Engine, show};
use super::terminal;

/// Frames on the contact sheet.
const SHOWN: usize = 6;

/// Synthesises HDR video: capture in, 1000 fps HDR video out
///
/// A folder as --out gets hdr/frame-00000.exr …, contact-sheet.png (mosaic, box filter, result) and report.json; a
/// name ending in .npy gets the cube [t, y, x] alone.
#[derive(Args)]
pub struct Synth {
    /// Capture: capture.npy with its capture.json beside it, or their folder
    capture: PathBuf,
    /// Folder, or .npy file
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    #[command(flatten)]
    engine: Engine,
    #[command(flatten)]
    options: CaptureOptions,
    /// Ground truth to compare with
    #[arg(long, value_name = "PATH")]
    truth: Option<PathBuf>,
    /// Also write a preview video (through ffmpeg)
    #[arg(long, value_name = "FILE")]
    preview: Option<PathBuf>,
    /// Frames per second of the preview
    #[arg(long, default_value_t = 30, value_name = "FPS")]
    preview_rate: u32,
    /// Write 16-bit instead of 32-bit floating-point numbers
    #[arg(long)]
    half: bool,
    /// Replace what is there
    #[arg(long)]
    overwrite: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Synth {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        let begun = Instant::now();
        let recording = Capture::read(&self.capture, &self.options.keys()?)?;
        let capture = hold_to_covering(&recording);
        if recording.info.timing == Timing::Hold {
            let latency = capture.pattern.longest_readout() as f64 * capture.info.frame_period_ms;
            tracing::info!("sample and hold: a live source of this pattern lags by {latency} ms");
        }
        if let Some(warning) = check_exposure_ratio(&capture).and_then(|check| check.warning()) {
            terminal::warn(&warning);
        }
        let truth = self.truth.as_ref().map(|path| truth(path, &capture)).transpose()?;
        let model = self.engine.model()?;
        if let Some(warning) = check_fits(&model, &capture)? {
            terminal::warn(&warning);
        }
        let backend = self.engine.backend()?;
        let extent = [capture.height, capture.width];
        let mut synthesizer = self.engine.synthesizer(&model, capture.calibration(), extent, &backend)?;

        let folder = (!has_extension(&self.out, "npy")).then_some(&self.out);
        let target = folder.map_or_else(|| self.out.clone(), |folder| folder.join("hdr"));
        let how = Writing {
            half: self.half,
            overwrite: self.overwrite,
            frame_period_ms: Some(capture.info.frame_period_ms),
            anchor: capture.info.anchor.map(|anchor| anchor as f32),
        };
        let mut writer = VideoWriter::begin(&target, [capture.frames, extent[0], extent[1]], how)?;
        let mut preview = self
            .preview
            .as_ref()
            .map(|path| PreviewWriter::begin(path, extent, self.preview_rate))
            .transpose()?;
        let shown = shown_frames(capture.frames);
        let mut panels = Vec::new();
        let mut comparison = Comparison::default();
        let bar = terminal::progress(capture.frames, "synthesis");
        let report = synthesizer.run(&capture, |t, frame| {
            writer.push(frame)?;
            if let Some(preview) = &mut preview {
                preview.push(frame)?;
            }
            if shown.contains(&t) {
                panels.push(Panel::toned(frame, extent[1]));
            }
            if let Some(truth) = &truth {
                comparison.add(truth.frame(t), frame, extent[1]);
            }
            bar.inc(1);
            Ok(())
        })?;
        bar.finish_and_clear();
        writer.finish()?;
        let mut files = vec![target];
        if let Some(preview) = preview {
            files.extend(Some(preview.finish()?));
        }
        if let Some(folder) = folder {
            let sheet = folder.join("contact-sheet.png");
            contact_sheet(&capture, &shown, panels).write(&sheet)?;
            files.push(sheet);
        }
        let measures = truth.is_some().then(|| comparison.measures());
        let mut json = run_json(&self.engine.describe(&backend), &report, begun.elapsed().as_secs_f64());
        json["measures"] = json!(measures);
        if let Some(folder) = folder {
            let path = folder.join("report.json");
            files.push(path.clone());
            json["files"] = files.iter().map(|path| show(path)).collect();
            let text = serde_json::to_vec_pretty(&json).map_err(|e| Error::Usage(e.to_string()))?;
            video::atomic::write_bytes(path, &text)?;
        } else {
            json["files"] = files.iter().map(|path| show(path)).collect();
        }
        terminal::result(self.json, &json, || {
            let mut text = run_text(&report);
            if let Some(measures) = measures {
                text += &format!("\n{measures}");
            }
            text + &format!(
                "\nwritten: {}",
                files.iter().map(|path| show(path)).collect::<Vec<_>>().join(", ")
            )
        })
    }
}

/// The ground truth of a capture.
fn truth(path: &Path, capture: &Capture) -> Result<Video> {
    let truth = video::read(path)?;
    if [truth.frames, truth.height, truth.width] != [capture.frames, capture.height, capture.width] {
        return Err(Error::Usage(format!(
            "{}: {}×{}×{} is not the size of the capture, {}×{}×{}",
            show(path),
            truth.frames,
            truth.height,
            truth.width,
            capture.frames,
            capture.height,
            capture.width
        )));
    }
    Ok(truth)
}

/// Whether `path` ends in `.extension`.
fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension))
}

/// A few frames spread evenly over `frames`.
pub fn shown_frames(frames: usize) -> Vec<usize> {
    let shown = SHOWN.min(frames);
    (0..shown).map(|i| (2 * i + 1) * frames / (2 * shown)).collect()
}

/// Rows of mosaic, box filter and result.
pub fn contact_sheet(capture: &Capture, shown: &[usize], result: Vec<Panel>) -> ContactSheet {
    let width = capture.width;
    let measurement: Vec<Video> = shown
        .iter()
        .map(|&t| {
            let mut frame = Video::black(1, capture.height, width);
            capture.pixel_values(t, frame.frame_mut(0));
            frame
        })
        .collect();
    let calibration = capture.calibration();
    let mosaic = measurement.iter().map(|frame| Panel::linear(frame.frame(0), width));
    let filtered = measurement.iter().zip(shown).map(|(frame, &t)| {
        let filtered = box_filter(frame, &calibration, capture.info.schedule_start + t as i64);
        Panel::toned(filtered.frame(0), width)
    });
    let heading = |t: &usize| format!("{:.0} ms", *t as f64 * capture.info.frame_period_ms);
    ContactSheet::new((320 / width.max(1)).clamp(1, 4))
        .columns(shown.iter().map(heading))
        .row("mosaic", mosaic)
        .row("box filter", filtered)
        .row("pix2hdr", result)
}

/// A run as JSON.
pub fn run_json(engine: &serde_json::Map<String, Value>, report: &Report, seconds: f64) -> Value {
    let mut json = json!({
        "frames": report.frames,
        "windows": report.windows,
        "tiles": report.tiles,
        "ms_per_frame_median": report.ms_per_frame(),
        "gflop_per_frame": report.flop_per_frame / 1e9,
        "ran_on": report.executor,
        "seconds": seconds,
    });
    if let Value::Object(map) = &mut json {
        map.extend(engine.clone());
    }
    json
}

/// A run in words.
pub fn run_text(report: &Report) -> String {
    let ms = report.ms_per_frame();
    format!(
        "{} frames on {}\n{ms:.3} ms per frame (median of {} windows), {:.0} frames/s, {:.2} GFLOP per frame",
        report.frames,
        report.executor,
        report.windows,
        1e3 / ms.max(1e-9),
        report.flop_per_frame / 1e9
    )
}

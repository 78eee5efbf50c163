//! `pix2hdr synth`: the main job.

use std::path::{Path, PathBuf};
use std::time::{Instant, UNIX_EPOCH};

use crate::baseline::box_filter;
use crate::network::Model;
use crate::quality::{Comparison, ContactSheet, Panel};
use crate::sensor::{CaptureFile, Recording, Timing, check_exposure_ratio, check_levels};
use crate::synth::{Backend, Report, ResultFrame, Skipped, check_fits};
use crate::video::{self, PreviewWriter, Video, Writing};
use crate::{Error, Result};
use clap::Args;
use serde_json::{Value, json};

use super::interrupt::{Resumable, stop_on_signal};
use super::options::{CaptureOptions, Engine, show};
use super::terminal;

/// Frames on the contact sheet.
const SHOWN: usize = 6;
/// Frames in which values are held against their exposures.
const LOOKS: usize = 16;

/// Synthesises HDR video: capture in, 1000 fps HDR video out
///
/// A folder as --out gets hdr/frame-00000.exr …, contact-sheet.png (mosaic, box filter, result), report.json and, with
/// --skip, skipped.png (what was computed); a name ending in .npy gets the cube [t, y, x] alone. Memory does not grow
/// with the length of the capture. Ctrl-C leaves the frames that are done as hdr.partial (NAME.partial.npy); the same
/// command with --resume goes on from there. --truth and --preview look at a whole run.
#[derive(Args)]
#[allow(clippy::struct_excessive_bools)] // Flags of a command line.
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
    /// Go on where an interrupted run stopped; the result is the same to the bit
    #[arg(long, conflicts_with_all = ["truth", "preview"])]
    resume: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Synth {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        let begun = Instant::now();
        let mut file = CaptureFile::open(&self.capture, &self.options.keys()?)?;
        let (frames, recording) = (file.frames, file.recording.clone());
        let extent = [recording.height, recording.width];
        if recording.info.timing == Timing::Hold {
            let latency = recording.pattern.longest_readout() as f64 * recording.info.frame_period_ms;
            tracing::info!("sample and hold: a live source of this pattern lags by {latency} ms");
        }
        // Static parts stay static: a few frames are enough to look at.
        let looks: Vec<usize> = (0..frames.min(LOOKS)).map(|i| i * frames / frames.min(LOOKS)).collect();
        let excerpt = file.excerpt(&looks)?;
        let ratio = check_exposure_ratio(&excerpt).and_then(|check| check.warning());
        for warning in [check_levels(&excerpt), ratio].into_iter().flatten() {
            terminal::warn(&warning);
        }
        let truth =
            self.truth.as_ref().map(|path| truth(path, [frames, extent[0], extent[1]])).transpose()?;
        let model = self.engine.model(&recording.pattern)?;
        if let Some(warning) = check_fits(&model, &recording)? {
            terminal::warn(&warning);
        }
        let backend = self.engine.backend()?;
        let mut synthesizer = self.engine.synthesizer(&model, recording.calibration(), extent, &backend)?;

        let folder = (!video::is_cube(&self.out)).then_some(&self.out);
        let target = folder.map_or_else(|| self.out.clone(), |folder| folder.join("hdr"));
        let how = Writing {
            half: self.half,
            overwrite: self.overwrite,
            frame_period_ms: Some(recording.info.frame_period_ms),
            anchor: recording.info.anchor.map(|anchor| anchor as f32),
        };
        let extents = [frames, extent[0], extent[1]];
        file.check_not_itself(&target)?;
        let made = self.made(&file, &model, &backend)?;
        // What can fail comes before the result begins, so that it leaves nothing to go on with.
        let mut preview = self
            .preview
            .as_ref()
            .map(|path| PreviewWriter::begin(path, extent, self.preview_rate))
            .transpose()?;
        let shown = shown_frames(frames);
        let mosaics = shown.iter().map(|&t| file.pixel_values(t)).collect::<Result<Vec<_>>>()?;
        let mut result = Resumable::begin(&target, extents, how, self.resume, &made)?;
        let from = result.writer.pushed();
        let mut panels = Vec::new();
        for t in shown.iter().filter(|t| **t < from && folder.is_some()) {
            panels.extend(result.writer.written(*t)?.map(|values| Panel::toned(&values, extent[1])));
        }
        let mut overlay = Vec::new();
        let mut comparison = Comparison::default();
        stop_on_signal(&synthesizer.stop())?;
        let bar = terminal::progress(frames, "synthesis");
        bar.set_position(from as u64);
        bar.reset_eta();
        let run = synthesizer.stream(&mut *file.into_frames(), from, |frame| {
            let ResultFrame { number, frame, computed, .. } = frame;
            let values = frame.values();
            result.writer.push(frame.plane())?;
            if let Some(preview) = &mut preview {
                preview.push(values)?;
            }
            if shown.contains(&number) {
                let panel = Panel::toned(values, extent[1]);
                if let Some((active, slab)) = computed {
                    overlay.push((panel.clone(), active.slab(slab).to_vec()));
                }
                panels.push(panel);
            }
            if let Some(truth) = &truth {
                comparison.add(truth.frame(number), values, extent[1]);
            }
            bar.inc(1);
            Ok(())
        });
        bar.finish_and_clear();
        let report = match run {
            Ok(report) if from + report.frames == frames => report,
            // What is there stays, whatever the reason.
            outcome => {
                let left = result.suspend(frames);
                return Err(match outcome {
                    Ok(_) => Error::Usage(left?),
                    Err(error) => {
                        // If even that fails, it is for the same reason.
                        let _ = left.map(|left| terminal::warn(&left));
                        error
                    }
                });
            }
        };
        result.finish()?;
        let mut files = vec![target];
        if let Some(preview) = preview {
            files.extend(Some(preview.finish()?));
        }
        if let Some(folder) = folder {
            let sheet = folder.join("contact-sheet.png");
            contact_sheet(&recording, &shown, &mosaics, panels).write(&sheet)?;
            files.push(sheet);
            if let Some(skipped) = &report.skipping {
                let path = folder.join("skipped.png");
                let (pixels, width) = skip_picture(&overlay, skipped, extent);
                video::png::write_rgb(&path, &pixels, width)?;
                files.push(path);
            }
        }
        let measures = truth.is_some().then(|| comparison.measures());
        let mut json =
            run_json(&self.engine.describe(&model, &backend), &report, begun.elapsed().as_secs_f64());
        json["measures"] = json!(measures);
        if let Some(folder) = folder {
            let path = folder.join("report.json");
            files.push(path.clone());
            json["files"] = files.iter().map(|path| show(path)).collect();
            let text = serde_json::to_vec_pretty(&json)?;
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

    /// All that the result depends on, to the bit.
    fn made(&self, file: &CaptureFile, model: &Model, backend: &Backend) -> Result<Value> {
        let meta = std::fs::metadata(&file.array)?;
        let modified = meta.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let mut made = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "capture": show(&std::fs::canonicalize(&file.array)?),
            "capture_bytes": meta.len(),
            "capture_modified": modified.map(|time| time.as_secs()),
            // What a file held that the description only names.
            "response": serde_json::to_value(file.recording.response.form())
                ?,
            "info": serde_json::to_value(&file.recording.info)?,
            "weights_digest": model.digest(),
            "half": self.half,
            "hop": self.engine.hop,
            "tile": self.engine.tile,
            "allowed_error": self.engine.allowed_error,
        });
        if let Value::Object(map) = &mut made {
            map.extend(self.engine.describe(model, backend));
        }
        Ok(made)
    }
}

/// The ground truth of a capture.
fn truth(path: &Path, [frames, height, width]: [usize; 3]) -> Result<Video> {
    let truth = video::read(path)?;
    if [truth.frames, truth.height, truth.width] != [frames, height, width] {
        return Err(Error::Usage(format!(
            "{}: {}×{}×{} is not the size of the capture, {frames}×{height}×{width}",
            show(path),
            truth.frames,
            truth.height,
            truth.width,
        )));
    }
    Ok(truth)
}

/// A few frames spread evenly over `frames`.
pub fn shown_frames(frames: usize) -> Vec<usize> {
    let shown = SHOWN.min(frames);
    (0..shown).map(|i| (2 * i + 1) * frames / (2 * shown)).collect()
}

/// Rows of mosaic, box filter and result; `mosaics` are the pixel values of the frames `shown`.
pub fn contact_sheet(
    recording: &Recording,
    shown: &[usize],
    mosaics: &[Vec<f32>],
    result: Vec<Panel>,
) -> ContactSheet {
    let (width, calibration) = (recording.width, recording.calibration());
    let filtered = mosaics.iter().zip(shown).map(|(mosaic, &t)| {
        let mut frame = Video::black(1, recording.height, width);
        frame.frame_mut(0).copy_from_slice(mosaic);
        let filtered = box_filter(&frame, &calibration, recording.info.schedule_start + t as i64);
        Panel::toned(filtered.frame(0), width)
    });
    let heading = |t: &usize| format!("{:.0} ms", *t as f64 * recording.info.frame_period_ms);
    ContactSheet::new((320 / width.max(1)).clamp(1, 4))
        .columns(shown.iter().map(heading))
        .row("mosaic", mosaics.iter().map(|mosaic| Panel::linear(mosaic, width)))
        .row("box filter", filtered)
        .row("pix2hdr", result)
}

/// The shown frames with the cells that were computed in red, and how often each cell was computed over the whole
/// run; its width in pixels.
fn skip_picture(
    shown: &[(Panel, Vec<bool>)],
    skipped: &Skipped,
    [height, width]: [usize; 2],
) -> (Vec<[u8; 3]>, usize) {
    const GAP: usize = 4;
    let whole = (width + GAP) * (shown.len() + 1) - GAP;
    let mut picture = vec![[255; 3]; whole * height];
    let cell = |y: usize, x: usize| y / skipped.cell[0] * skipped.grid[1] + x / skipped.cell[1];
    for y in 0..height {
        for x in 0..width {
            for (i, (panel, active)) in shown.iter().enumerate() {
                let grey = panel.pixels[y * width + x];
                let dark = grey / 2;
                let pixel = if active[cell(y, x)] { [128 + dark, dark, dark] } else { [grey; 3] };
                picture[y * whole + i * (width + GAP) + x] = pixel;
            }
            let often = f64::from(skipped.computed[cell(y, x)]) / skipped.slabs.max(1) as f64;
            picture[y * whole + shown.len() * (width + GAP) + x] = [(255.0 * often).round() as u8, 0, 0];
        }
    }
    (picture, whole)
}

/// A run as JSON.
pub fn run_json(engine: &serde_json::Map<String, Value>, report: &Report, seconds: f64) -> Value {
    let mut json = json!({
        "frames": report.frames,
        "windows": report.windows,
        "tiles": report.tiles,
        "ms_per_frame_median": report.ms_per_frame(),
        "ms_per_frame_end_to_end": report.mean_ms(),
        "gflop_per_frame": report.flop_per_frame / 1e9,
        "ran_on": report.executor,
        "seconds": seconds,
        "inference_seconds": report.inference.as_secs_f64(),
        "skipped": report.skipping.as_ref().map(skipped_json),
    });
    if let Value::Object(map) = &mut json {
        map.extend(engine.clone());
    }
    json
}

/// What was skipped, as JSON.
fn skipped_json(skipped: &Skipped) -> Value {
    json!({
        "cells_computed_fraction": skipped.active_fraction(),
        "work_fraction": skipped.work,
        "whole_windows": skipped.whole_windows,
        "allowed_error": skipped.allowed_error,
        "error_rms": skipped.audit.rms(),
        "error_largest": skipped.audit.rms().map(|_| skipped.audit.largest),
        "noise": skipped.noise,
    })
}

/// A run in words.
pub fn run_text(report: &Report) -> String {
    let ms = report.ms_per_frame();
    let mut text = format!(
        "{} frames on {}\n{ms:.3} ms per frame (median of {} windows), {:.0} frames/s, {:.2} GFLOP per frame",
        report.frames,
        report.executor,
        report.windows,
        1e3 / ms.max(1e-9),
        report.flop_per_frame / 1e9
    );
    if let Some(skipped) = &report.skipping {
        text += &format!(
            "\n{:.3} ms per frame from start to end; {:.1}% of all cells computed, with {:.1}% of the operations",
            report.mean_ms(),
            100.0 * skipped.active_fraction(),
            100.0 * skipped.work
        );
        if let Some(rms) = skipped.audit.rms() {
            text += &format!("; kept results were off by {rms:.5} (rms of l per cell)");
        }
    }
    text
}

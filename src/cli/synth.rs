//! `pix2hdr synth`: the main job.

use std::path::{Path, PathBuf};
use std::sync::PoisonError;
use std::time::Instant;

use crate::job::{Begin, Fingerprint, Job, Outcome, Resumable, Sheet, Sink, Truth, Unfinished};
use crate::quality::Measures;
use crate::sensor::{CaptureFile, CaptureInfo, Timing};
use crate::synth::Report;
use crate::video::{self, PreviewWriter, Writing, check_folder_name};
use crate::{Error, Result};
use clap::Args;
use serde_json::{Value, json};

use super::interrupt::Interrupt;
use super::options::{CaptureArgs, SettingsArgs, show};
use super::table::short;
use super::terminal::{self, counted};

/// Synthesises HDR video: capture in, 1000 fps HDR video out
///
/// A folder as --out gets hdr/frame-00000.exr …, contact-sheet.png (mosaic, box filter, result), report.json and, with
/// --skip, skipped.png (what was computed); a name ending in .npy gets the cube [t, y, x], and NAME.report.json beside
/// it. Memory does not grow
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
    settings: SettingsArgs,
    #[command(flatten)]
    options: CaptureArgs,
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

/// What takes the frames: the result, a preview, a contact sheet, a comparison.
type Sinks = (Resumable, Option<PreviewWriter>, Option<Sheet>, Option<Truth>);

impl Synth {
    /// Runs the command.
    pub fn run(&self, interrupt: &Interrupt) -> Result<()> {
        let begun = Instant::now();
        let mut file = CaptureFile::open(&self.capture, &self.options.keys()?)?;
        let (frames, info) = (file.frames, &file.recording.info);
        if info.timing == Timing::Hold {
            let latency = file.recording.pattern.longest_readout() as f64 * info.frame_period_ms;
            tracing::info!("sample and hold: a live source of this pattern lags by {latency} ms");
        }
        self.check_outputs(&file)?;
        let said = file.first_look()?.findings();
        said.iter().for_each(terminal::warn);
        let sheet = self.folder().map(|folder| {
            let recording = file.recording.clone();
            Sheet::new(folder.to_owned(), recording, frames, |t| file.pixel_values(t))
        });
        let (sheet, made) = (sheet.transpose()?, Fingerprint::of(&file)?);
        let capture = described(&show(&file.array), &file.recording.info, frames);
        let (source, inspection) = file.into_inspected_frames();
        let preparing = terminal::spinner("preparing the net");
        let job = Job::new(source, self.settings.settings());
        preparing.finish_and_clear();
        let job = job?;
        job.warnings().iter().for_each(terminal::warn);
        let sinks = self.sinks(&job, frames, sheet, made)?;
        interrupt.stops(&job.stop())?;
        let bar = terminal::progress(frames, "synthesis");
        bar.set_position(sinks.begun() as u64);
        bar.reset_eta();
        let run = job.run(sinks, |done| bar.set_position(done as u64));
        bar.finish_and_clear();
        let Outcome { output: (result, preview, sheet, measures), report, summary } = run.map_err(told)?;
        let inspection = inspection.lock().unwrap_or_else(PoisonError::into_inner);
        let found = inspection.findings();
        let new = found.iter().filter(|finding| !said.iter().any(|said| said.is_like(finding)));
        new.for_each(terminal::warn);
        let files = [result].into_iter().chain(preview).chain(sheet.into_iter().flatten());
        let mut json = serde_json::to_value(&summary)?;
        json["capture"] = capture;
        json["exposure_exponent"] = inspection.exposure().map(|check| check.exponent).into();
        json["half"] = self.half.into();
        json["seconds"] = begun.elapsed().as_secs_f64().into();
        self.tell(files.collect(), measures.as_ref(), &report, json)
    }

    /// The folder of everything that is written; none where it is one file.
    fn folder(&self) -> Option<&Path> {
        (!video::is_cube(&self.out)).then_some(&self.out)
    }

    /// Refuses what cannot be written, and what may not be, before work begins.
    fn check_outputs(&self, file: &CaptureFile) -> Result<()> {
        let sources = self.settings.sources().into_iter().chain(self.options.sources());
        let outputs = file.outputs(self.overwrite).reading(sources.chain(self.truth.clone()));
        self.folder().map_or(Ok(()), check_folder_name)?;
        outputs.check_video(self.target())?;
        outputs.check(self.report_file())?;
        if let Some(folder) = self.folder() {
            let pictures = Sheet::files(folder, self.settings.settings().skip);
            pictures.iter().try_for_each(|picture| outputs.check(picture))?;
        }
        if let Some(preview) = &self.preview {
            outputs.check(preview)?;
            PreviewWriter::check(preview, file.recording.extent().into(), self.preview_rate)?;
        }
        Ok(())
    }

    /// How the result was made is said beside it.
    fn report_file(&self) -> PathBuf {
        self.folder()
            .map_or_else(|| self.out.with_extension("report.json"), |folder| folder.join("report.json"))
    }

    /// Where the video goes.
    fn target(&self) -> PathBuf {
        self.folder().map_or_else(|| self.out.clone(), |folder| folder.join("hdr"))
    }

    /// Begins all that takes frames. The result comes last: what can fail before it leaves nothing to go on with.
    fn sinks(
        &self,
        job: &Job<'_>,
        frames: usize,
        mut sheet: Option<Sheet>,
        mut made: Fingerprint,
    ) -> Result<Sinks> {
        let recording = job.recording();
        let extents = [frames, recording.height, recording.width];
        let truth = self.truth.as_ref().map(|path| Truth::open(path, extents)).transpose()?;
        let how = Writing {
            half: self.half,
            overwrite: self.overwrite,
            frame_period_ms: Some(recording.info.frame_period_ms),
            anchor: recording.info.anchor.map(|anchor| anchor as f32),
        };
        made.add(job)?;
        made.add(&how)?;
        let begin = if self.resume { Begin::WhereItStopped } else { Begin::Anew };
        let extent = [recording.height, recording.width];
        let preview = |path| PreviewWriter::begin(path, extent, self.preview_rate);
        let preview = self.preview.as_ref().map(preview).transpose()?;
        let (result, warning) = Resumable::begin(&self.target(), extents, how, begin, &made)?;
        warning.iter().for_each(terminal::warn);
        if let Some(sheet) = &mut sheet {
            sheet.look_back(&result)?;
        }
        Ok((result, preview, sheet, truth))
    }

    /// Says what was done, in `report.json` too where there is a folder for it.
    fn tell(
        &self,
        mut files: Vec<PathBuf>,
        measures: Option<&Measures>,
        report: &Report,
        mut json: Value,
    ) -> Result<()> {
        let report_file = self.report_file();
        files.push(report_file.clone());
        json["measures"] = serde_json::to_value(measures)?;
        json["files"] = files.iter().map(|path| show(path)).collect();
        video::atomic::write_bytes(
            report_file,
            &serde_json::to_vec_pretty(&terminal::with_warnings(&json)?)?,
        )?;
        terminal::result(self.json, &json, || {
            let measures = measures.map_or_else(String::new, |measures| format!("\n{measures}"));
            let files: Vec<_> = files.iter().map(|path| show(path)).collect();
            format!("{}{measures}\nwritten: {}", run_text(report), files.join(", "))
        })
    }
}

/// A capture in a report: its name, its length, and all that is known of it.
pub fn described(name: &str, info: &CaptureInfo, frames: usize) -> Value {
    json!({ "name": name, "frames": frames, "description": info })
}

/// What to tell of a job that ended early: what is left, if somebody stopped it, else what went wrong.
fn told(unfinished: Unfinished) -> Error {
    match unfinished {
        Unfinished { error: Error::Stopped, left } => match left {
            Ok(Some(left)) => left.into(),
            Ok(None) => Error::Stopped,
            Err(error) => error,
        },
        // If even keeping what there is fails, it is for the same reason.
        Unfinished { error, left } => {
            left.ok().flatten().iter().for_each(terminal::warn);
            error
        }
    }
}

/// A run in words.
pub fn run_text(report: &Report) -> String {
    if report.frames == 0 {
        return format!("no frame was left to compute on {}", report.executor);
    }
    let ms = report.ms_per_frame();
    let mut text = format!(
        "{} on {}\n{ms:.3} ms per frame (median of {}), {} frames/s, {:.2} GFLOP per frame",
        counted(report.frames, "frame"),
        report.executor,
        counted(report.windows, "window"),
        short(1e3 / ms.max(1e-9)),
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

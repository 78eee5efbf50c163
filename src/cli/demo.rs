//! `pix2hdr demo`: the main job on a built-in scene, from ground truth to measures.

use std::path::PathBuf;
use std::time::Instant;

use crate::baseline::box_filter;
use crate::job::{InMemory, Job, Outcome, contact_sheet, shown_frames};
use crate::quality::{Plot, compare};
use crate::scene::procedural;
use crate::sensor::{Capture, hold_to_covering};
use crate::video::{self, Outputs, Video, Writing, check_folder_name};
use crate::{Error, Result};
use clap::Args;
use serde_json::json;

use super::options::{CameraArgs, SettingsArgs, show};
use super::scene::{ClipArgs, render};
use super::synth::{described, run_text};
use super::terminal;

/// Shows the main job on a built-in scene: ground truth, capture, synthesis, measures, pictures
///
/// Writes truth.npy, capture/, hdr/frame-00000.exr …, contact-sheet.png (mosaic, box filter, pix2hdr, truth),
/// time-series.png (one pixel over time) and report.json.
#[derive(Args)]
pub struct Demo {
    /// Built-in scene: fan, leds, falling, pouring, edge, wedge or still
    #[arg(default_value = "fan")]
    scene: String,
    /// Folder for everything that is written
    #[arg(long, default_value = "out/demo", value_name = "FOLDER")]
    out: PathBuf,
    #[command(flatten)]
    clip: ClipArgs,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    settings: SettingsArgs,
    /// Replace what is there
    #[arg(long)]
    overwrite: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Pictures that are written.
const PICTURES: [&str; 2] = ["contact-sheet.png", "time-series.png"];

impl Demo {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        let begun = Instant::now();
        let rendering = self.clip.rendering(self.camera.seed);
        // What cannot work is said before anything is rendered.
        let at = |name: &str| self.out.join(name);
        self.check_outputs()?;
        let sampler = self.camera.sampler()?;
        let settings = self.settings.settings();
        let (model, backend) = (settings.model(sampler.pattern())?, settings.backend()?);
        let scene = procedural::by_name(&self.scene, rendering.height, rendering.width, self.camera.seed)
            .ok_or_else(|| {
                Error::Usage(format!("no scene '{}'; there are {}", self.scene, procedural::NAMES.join(", ")))
            })?;
        let (truth, anchor) = render(&*scene, rendering)?;
        let mut capture = sampler.sample(&truth)?;
        capture.info.anchor = Some(f64::from(anchor));
        let job = Job::with(capture.frames(), settings, model, backend)?;
        job.warnings().iter().for_each(terminal::warn);
        let sink = InMemory::new(truth.frames, truth.extent());
        let Outcome { output: result, report, summary } = job.run(sink, |_| ())?;
        let calibration = capture.calibration();
        let covering = hold_to_covering(&capture);
        let measurement = covering.measurement();
        let filtered = box_filter(&measurement, &calibration, covering.info.schedule_start);
        let measures = json!({ "pix2hdr": compare(&truth, &result)?, "box": compare(&truth, &filtered)? });

        let mut files = Vec::new();
        let mut add = |name: &str| {
            let path = at(name);
            files.push(path.clone());
            path
        };
        let how = Writing {
            half: true,
            overwrite: self.overwrite,
            frame_period_ms: Some(1.0),
            anchor: Some(anchor),
        };
        video::write(add("truth.npy"), &truth, how)?;
        video::write(add("hdr"), &result, how)?;
        capture.write(add("capture"))?;
        let shown = shown_frames(truth.frames);
        let frames =
            |video: &Video| -> Vec<Vec<f32>> { shown.iter().map(|&t| video.frame(t).to_vec()).collect() };
        let rows: [(&str, &[Vec<f32>]); 2] = [("pix2hdr", &frames(&result)), ("truth", &frames(&truth))];
        contact_sheet(&capture.recording(), &shown, &frames(&measurement), &rows).write(add(PICTURES[0]))?;
        let pixel = liveliest(&truth);
        Self::time_series(pixel, [&measurement, &filtered, &result, &truth], &covering).write(
            add(PICTURES[1]),
            960,
            480,
        )?;
        let seconds = begun.elapsed().as_secs_f64();
        let mut json = serde_json::to_value(&summary)?;
        let report_path = add("report.json");
        json["seconds"] = seconds.into();
        json["scene"] = json!(self.scene);
        json["capture"] = described(&show(&at("capture")), &capture.info, capture.frames);
        json["measures"] = measures;
        json["files"] = files.iter().map(|path| show(path)).collect();
        let text = serde_json::to_vec_pretty(&terminal::with_warnings(&json)?)?;
        video::atomic::write_bytes(report_path, &text)?;
        terminal::result(self.json, &json, || {
            let psnr = |method: &str| json["measures"][method]["psnr_mu"].as_f64().unwrap_or(f64::NAN);
            format!(
                "{}\nPSNR-µ: box filter {:.2} dB, pix2hdr {:.2} dB\n{seconds:.1} s in all; look at {} and {}",
                run_text(&report),
                psnr("box"),
                psnr("pix2hdr"),
                show(&at(PICTURES[0])),
                show(&at(PICTURES[1])),
            )
        })
    }

    /// Refuses what cannot be written, and what may not be.
    fn check_outputs(&self) -> Result<()> {
        let at = |name: &str| self.out.join(name);
        let outputs =
            Outputs::new(self.overwrite).reading(self.camera.sources()).reading(self.settings.sources());
        check_folder_name(&self.out)?;
        ["truth.npy", "hdr"].iter().try_for_each(|name| outputs.check_video(at(name)))?;
        Capture::files(at("capture")).iter().try_for_each(|file| outputs.check(file))?;
        PICTURES.iter().chain(&["report.json"]).try_for_each(|name| outputs.check(at(name)))
    }

    /// Irradiance of one pixel over time; `measurement` is that of `covering`.
    fn time_series(
        pixel: usize,
        [measurement, filtered, result, truth]: [&Video; 4],
        covering: &Capture,
    ) -> Plot {
        let (y, x) = (pixel / truth.width, pixel % truth.width);
        let series = |video: &Video| -> Vec<(f64, f64)> {
            (0..video.frames).map(|t| (t as f64, f64::from(video.frame(t)[pixel]))).collect()
        };
        let own = |(t, value): (f64, f64)| {
            let read_out = covering.pattern.schedule(y, x).covering(covering.info.schedule_start + t as i64);
            (t, covering.response.exposure(value) / read_out.shutter.exposure() as f64)
        };
        Plot::new(format!("irradiance of the pixel in row {y}, column {x}"), "time / ms", "p")
            .series("raw / exposure", series(measurement).into_iter().map(own))
            .series("box filter", series(filtered))
            .series("pix2hdr", series(result))
            .series("truth", series(truth))
    }
}

/// The pixel whose tone-mapped irradiance changes most from frame to frame.
fn liveliest(video: &Video) -> usize {
    let change = |pixel: usize| -> f64 {
        let tone = |t: usize| crate::video::tone(f64::from(video.frame(t)[pixel]));
        (1..video.frames).map(|t| (tone(t) - tone(t - 1)).powi(2)).sum()
    };
    (0..video.frame_len()).max_by(|&a, &b| change(a).total_cmp(&change(b))).unwrap_or(0)
}

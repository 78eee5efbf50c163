//! `pix2hdr bench --stability`: how exact, how sensitive, and for how long.

use std::path::Path;

use crate::bench::stability::{self, Input, NamedCalibration, Trial, TrialOutcome, WeightStress};
use crate::bench::{CheckFailed, DetectionRate, Sensitivity, Soak, detection, sensitivity, soak};
use crate::network::Model;
use crate::scene::{Rendering, procedural};
use crate::sensor::{Form, Pattern};
use crate::synth::{Backend, Skip};
use crate::video::{Outputs, atomic};
use crate::{Error, Result};
use serde_json::json;

use super::options::show;
use super::scene::render;
use super::table::{Table, figure};
use super::terminal;

/// Rows and columns of the nets under stress, rounded up to what a net needs.
const EXTENT: usize = 16;
/// Scenes for sensitivity.
const SCENE: &str = "fan";

/// What is put under stress.
pub struct Stability<'a> {
    /// Nets, whole.
    pub nets: &'a [&'a Model],
    /// The net for sensitivity and long recordings, which need a result that means something.
    pub trained: Option<&'a Model>,
    /// Where, and at which precision.
    pub backends: &'a [Backend],
    /// Fewer frames, and the default camera alone.
    pub quick: bool,
    /// Seed of the scene.
    pub seed: u64,
}

/// Figures of whole recordings, as they come.
#[derive(Default)]
struct Figures {
    sensitivity: Vec<Sensitivity>,
    soak: Vec<Soak>,
    detection: Vec<DetectionRate>,
}

impl Stability<'_> {
    /// Runs everything, writes `path`, and prints what came out.
    pub fn run(&self, path: &Path, outputs: &Outputs, markdown: bool, json: bool) -> Result<()> {
        outputs.check(path)?;
        let outcomes = self.outcomes()?;
        let mut figures = Figures::default();
        let report = |figures: &Figures| {
            json!({
                "outcomes": outcomes, "net": self.trained.map(|net| &net.graph.name), "detection": figures.detection,
                "sensitivity": figures.sensitivity, "soak": figures.soak, "files": [show(path)],
            })
        };
        // What is known is written as it comes, and told whether or not that can be done.
        let write = |figures: &Figures| {
            let report = terminal::with_warnings(&report(figures))?;
            atomic::write_bytes(path, &serde_json::to_vec_pretty(&report)?)
        };
        write(&figures).unwrap_or_else(terminal::warn);
        // What is wrong with a capture does not depend on where it is computed.
        if let (Some(net), Some(backend)) = (self.trained, self.backends.first()) {
            let name = if net.graph.pattern == "any" { "mpve-1-4" } else { &net.graph.pattern };
            let pattern = Pattern::built_in(name)?;
            let scene = procedural::by_name(SCENE, 64, 64, self.seed)
                .ok_or_else(|| Error::Usage(format!("no scene '{SCENE}'")))?;
            let seed = self.seed;
            let how = Rendering { frames: 64, height: 64, width: 64, instants: 8, positions: 1, seed };
            let (truth, _) = render(&*scene, how)?;
            figures.sensitivity = sensitivity(net, &pattern, &truth, backend)?;
            write(&figures).unwrap_or_else(terminal::warn);
            let frames = if self.quick { 4000 } else { 100_000 };
            for skip in [Skip::Off, Skip::Exact, Skip::Bounded(Skip::ALLOWED_ERROR)] {
                figures.soak.push(soak(net, pattern.clone(), backend, frames, skip)?);
                write(&figures).unwrap_or_else(terminal::warn);
            }
        }
        figures.detection = detection()?;
        let written = write(&figures);
        terminal::result(json, &report(&figures), || {
            let tables = [
                kernel_table(&outcomes),
                net_table(&outcomes),
                sensitivity_table(&figures.sensitivity),
                detection_table(&figures.detection),
                soak_table(&figures.soak),
            ];
            let tables = tables.map(|table| table.text(markdown)).join("\n\n");
            if written.is_ok() { format!("{tables}\n\nwritten: {}", show(path)) } else { tables }
        })?;
        written?;
        // A figure above 1 is a failure of this program, whoever asks.
        match outcomes.iter().find(|outcome| outcome.fraction() > 1.0) {
            Some(outcome) => Err(CheckFailed(format!("{}: a step leaves its bound", outcome.what())).into()),
            None => Ok(()),
        }
    }

    /// All kernels with all weights and cameras, and the nets as they are.
    fn outcomes(&self) -> Result<Vec<TrialOutcome>> {
        let every_kernel = stability::every_kernel()?;
        let default = NamedCalibration::new("mpve-1-4", "linear", Form::Linear)?;
        let cameras = if self.quick { Vec::new() } else { NamedCalibration::all()? };
        let mut trials = Vec::new();
        for weights in WeightStress::ALL {
            trials.push((
                Trial { model: &every_kernel, weights, camera: &default, extent: [6, 10] },
                &Input::ALL[..],
            ));
        }
        for camera in &cameras {
            let trial = Trial { model: &every_kernel, weights: WeightStress::Plain, camera, extent: [6, 10] };
            trials.push((trial, &Input::ALL));
        }
        for model in self.nets {
            let [_, y, x] = model.graph.granularity()?;
            let extent = [EXTENT.next_multiple_of(y), EXTENT.next_multiple_of(x)];
            trials
                .push((Trial { model, weights: WeightStress::Plain, camera: &default, extent }, &Input::ALL));
        }
        let bar = terminal::progress(trials.len() * self.backends.len(), "under stress");
        let mut outcomes = Vec::new();
        for backend in self.backends {
            for (trial, inputs) in &trials {
                outcomes.extend(trial.run(backend, inputs)?);
                bar.inc(1);
            }
        }
        bar.finish_and_clear();
        Ok(outcomes)
    }
}

/// Where and how something ran.
fn place(outcome: &TrialOutcome) -> String {
    format!("{} {}", outcome.executor, outcome.precision)
}

/// What occurs among the outcomes, in order.
fn distinct<'a>(outcomes: &'a [TrialOutcome], of: impl Fn(&'a TrialOutcome) -> Vec<String>) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for name in outcomes.iter().flat_map(of) {
        if !all.contains(&name) {
            all.push(name);
        }
    }
    all
}

/// The largest error of each kernel as a fraction of its bound, and where that was.
fn kernel_table(outcomes: &[TrialOutcome]) -> Table {
    let places = distinct(outcomes, |outcome| vec![place(outcome)]);
    let kernels =
        distinct(outcomes, |outcome| outcome.steps.iter().map(|step| step.kernel.to_owned()).collect());
    let headings: Vec<&str> = places.iter().map(String::as_str).collect();
    let mut table = Table::new(&[&["error/bound"], &headings[..], &["largest with"]].concat());
    for kernel in kernels {
        let largest = |wanted: Option<&String>| {
            let here = outcomes.iter().filter(|outcome| wanted.is_none_or(|name| place(outcome) == *name));
            let steps = here.flat_map(|outcome| outcome.steps.iter().map(move |step| (outcome, step)));
            steps
                .filter(|(_, step)| step.kernel == kernel)
                .max_by(|(_, a), (_, b)| a.fraction.total_cmp(&b.fraction))
        };
        let mut row = vec![kernel.clone()];
        row.extend(places.iter().map(|p| figure(largest(Some(p)).map(|(_, step)| step.fraction), 3)));
        row.push(largest(None).map_or_else(String::new, |(outcome, _)| {
            format!("{}: {:?}, {:?}, {}", outcome.net, outcome.weights, outcome.input, outcome.camera)
        }));
        table.row(row);
    }
    table
}

/// Each net with its least PSNR and its largest activation.
fn net_table(outcomes: &[TrialOutcome]) -> Table {
    let mut table =
        Table::new(&["net", "executor", "least PSNR to the oracle, dB", "with", "largest value", "rescaled"]);
    let plain = |outcome: &TrialOutcome| {
        outcome.weights == WeightStress::Plain && outcome.camera == "mpve-1-4 linear"
    };
    let outcomes: Vec<TrialOutcome> = outcomes.iter().filter(|outcome| plain(outcome)).cloned().collect();
    for net in distinct(&outcomes, |outcome| vec![outcome.net.clone()]) {
        for wanted in distinct(&outcomes, |outcome| vec![place(outcome)]) {
            let of: Vec<_> =
                outcomes.iter().filter(|outcome| outcome.net == net && place(outcome) == wanted).collect();
            let worst = of.iter().filter(|outcome| outcome.psnr_db.is_some());
            let worst =
                worst.min_by(|a, b| a.psnr_db.unwrap_or_default().total_cmp(&b.psnr_db.unwrap_or_default()));
            let steps = of.iter().flat_map(|outcome| &outcome.steps);
            let loudest = steps.max_by(|a, b| a.magnitude.total_cmp(&b.magnitude));
            table.row(vec![
                net.clone(),
                wanted,
                figure(worst.and_then(|outcome| outcome.psnr_db), 1),
                worst.map_or_else(String::new, |outcome| format!("{:?}", outcome.input)),
                loudest.map_or_else(String::new, |step| format!("{:.1} in {}", step.magnitude, step.step)),
                of.iter().map(|outcome| outcome.rescaled.len()).max().unwrap_or_default().to_string(),
            ]);
        }
    }
    table
}

fn sensitivity_table(rows: &[Sensitivity]) -> Table {
    let mut table = Table::new(&["what is wrong", "PSNR-µ, dB", "without, dB", "change, dB"]);
    for row in rows {
        let [with, without] = [row.psnr_mu_db, row.undisturbed_db];
        let change = format!("{:+.2}", with - without);
        table.row(vec![row.disturbance.clone(), figure(Some(with), 2), figure(Some(without), 2), change]);
    }
    table
}

fn detection_table(rows: &[DetectionRate]) -> Table {
    let mut table =
        Table::new(&["recordings", "counts", "number", "schedule found, %", "timing found, %", "wrong"]);
    for row in rows {
        table.row(vec![
            row.scene.to_owned(),
            row.counts.to_owned(),
            row.recordings.to_string(),
            figure(Some(row.schedule_percent), 1),
            figure(Some(row.timing_percent), 1),
            row.wrong.to_string(),
        ]);
    }
    table
}

fn soak_table(rows: &[Soak]) -> Table {
    let mut table =
        Table::new(&["skip", "frames", "that differ", "MiB after a tenth", "MiB at most later", "s"]);
    let mib = |bytes: Option<u64>| figure(bytes.map(|bytes| bytes as f64 / f64::from(1 << 20)), 1);
    for soak in rows {
        table.row(vec![
            soak.skip.to_owned(),
            soak.frames.to_string(),
            soak.differing.to_string(),
            mib(soak.early_memory_bytes),
            mib(soak.late_memory_bytes),
            figure(Some(soak.seconds), 0),
        ]);
    }
    table
}

//! `pix2hdr bench`: run time against error.

use std::path::PathBuf;
use std::time::Duration;

use crate::bench::{Case, Clip, Effort, Machine, Oracle, Peak, ProcessorPeak, Row, frontier};
use crate::gpu::Variant;
use crate::network::{self, Model, presets};
use crate::scene::{Rendering, procedural};
use crate::sensor::Pattern;
use crate::synth::{self, Backend, ExecutorChoice, Settings, fitted};
use crate::video::{Outputs, atomic, check_folder_name};
use crate::{Error, Result};
use clap::Args;
use serde_json::json;

use super::options::{FrameSize, Precision, Skip, allowed_error, at_least_one, show};
use super::scene::render;
use super::stability::Stability;
use super::table::{Table, figure, short};
use super::terminal::{self, counted};

/// Measures run time against error: every net on every executor, with its time per frame, what the hardware could do,
/// and the error
///
/// Built-in scenes only, so nothing is needed but this program. Times are of inference alone (measurement and result
/// stay where it is computed) and end to end (capture in memory to video in memory). The peak of each executor is
/// measured by a loop of multiply-adds and by a copy. Writes frontier.svg, frontier.png and bench.json.
#[derive(Args)]
#[allow(clippy::struct_excessive_bools)] // Flags of a command line.
pub struct Bench {
    /// Presets or weights files [default: all presets; with --quick, the trained ones]; a preset without trained
    /// weights gets random ones, which are as fast
    #[arg(long, alias = "presets", value_delimiter = ',', value_name = "FILE|PRESET,…")]
    weights: Vec<String>,
    /// Width and height of a frame in pixels, or one number for both
    #[arg(long, value_delimiter = ',', default_value = "128x128", value_name = "WxH,…")]
    size: Vec<FrameSize>,
    /// Frames of a clip [default: 80; with --quick, 40]
    #[arg(long, value_delimiter = ',', value_parser = at_least_one, value_name = "FRAMES,…")]
    frames: Vec<usize>,
    /// Where the nets run
    #[arg(long, value_enum, value_delimiter = ',', default_value = "auto", value_name = "EXECUTOR,…")]
    executor: Vec<ExecutorChoice>,
    /// Part of the name of the GPU adapter to use
    #[arg(long, value_name = "SUBSTRING")]
    adapter: Option<String>,
    /// How numbers are stored; the CPU has f32 only
    #[arg(long, value_enum, value_delimiter = ',', default_value = "f32", value_name = "PRECISION,…")]
    precision: Vec<Precision>,
    /// What may be left out
    #[arg(long, value_enum, value_delimiter = ',', default_value = "off", value_name = "SKIP,…")]
    skip: Vec<Skip>,
    /// With --skip bounded: as in `synth`
    #[arg(long, default_value_t = synth::Skip::ALLOWED_ERROR, value_parser = allowed_error, value_name = "L")]
    allowed_error: f64,
    /// Views of which the mean is taken, as in `synth`
    #[arg(long, value_delimiter = ',', default_value = "1", value_parser = at_least_one, value_name = "VIEWS,…")]
    ensemble: Vec<usize>,
    /// Built-in scenes
    #[arg(long, value_delimiter = ',', default_value = "fan", value_name = "SCENE,…")]
    scene: Vec<String>,
    /// Also show where the time goes: each step beside the roofline of its arithmetic and bytes
    #[arg(long)]
    per_layer: bool,
    /// Force how GPU convolutions are divided: pixels and vectors of four channels that one invocation computes, and
    /// invocations that share weights; measures inference only
    #[arg(long, value_parser = parse_variant, value_name = "PIXELSxVECTORS[xLANES]")]
    variant: Option<Variant>,
    /// Measure numerical stability in place of run time: every kernel and whole nets under stress, and for the first
    /// trained net sensitivity to what is wrong with a capture and 100,000 frames in a row; writes stability.json
    /// (docs/numerics.md)
    #[arg(long, conflicts_with_all = ["per_layer", "variant", "size", "frames", "skip", "ensemble", "scene"])]
    stability: bool,
    /// Take a fifth of the time, or less
    #[arg(long)]
    quick: bool,
    /// Seed of scenes and noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder for frontier.svg, frontier.png and bench.json
    #[arg(long, default_value = "out/bench", value_name = "FOLDER")]
    out: PathBuf,
    /// Replace what is there
    #[arg(long)]
    overwrite: bool,
    /// Print tables in Markdown
    #[arg(long, conflicts_with = "json")]
    markdown: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Parses how a convolution is divided.
fn parse_variant(text: &str) -> std::result::Result<Variant, String> {
    let numbers = text.split('x').map(at_least_one).collect::<std::result::Result<Vec<_>, _>>()?;
    match numbers[..] {
        [pixels, vectors] => Ok(Variant { pixels, vectors, lanes: 1, wide: false }),
        [pixels, vectors, lanes] => Ok(Variant { pixels, vectors, lanes, wide: false }),
        _ => Err("two or three numbers such as 8x2 or 8x2x32".into()),
    }
}

/// A net to measure.
struct Net {
    name: String,
    model: Model,
    trained: bool,
}

impl Net {
    /// A preset, with random weights if it has none, or a weights file.
    fn load(name: &str) -> Result<Self> {
        let untrained = presets::by_name(name).ok().filter(|preset| !preset.trained);
        let model = match &untrained {
            Some(preset) => Model::random(preset.graph()?, 1)?,
            None => Model::load(name)?,
        };
        Ok(Self { name: name.to_owned(), model, trained: untrained.is_none() })
    }

    fn pattern(&self) -> Result<Pattern> {
        let name = if self.model.graph.pattern == "any" { "mpve-1-4" } else { &self.model.graph.pattern };
        Ok(Pattern::built_in(name)?)
    }
}

impl Bench {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        // What cannot work is said before anything is measured.
        check_folder_name(&self.out)?;
        let outputs = Outputs::new(self.overwrite).reading(&self.weights);
        let nets = self.names().iter().map(|name| Net::load(name)).collect::<Result<Vec<_>>>()?;
        for name in &self.scene {
            if procedural::describe(name).is_none() {
                let known = procedural::NAMES.join(", ");
                return Err(Error::Usage(format!("no scene '{name}'; there are {known}")));
            }
        }
        let backends = self.backends()?;
        if backends.iter().all(|backend| self.at_precisions(backend).is_empty()) {
            return Err(Error::Usage(
                "the CPU has f32 only; --executor gpu takes software Vulkan too".into(),
            ));
        }
        if self.stability {
            let backends: Vec<_> = backends.iter().flat_map(|backend| self.at_precisions(backend)).collect();
            let stability = Stability {
                nets: &nets.iter().map(|net| &net.model).collect::<Vec<_>>(),
                trained: nets.iter().find(|net| net.trained).map(|net| &net.model),
                backends: &backends,
                quick: self.quick,
                seed: self.seed,
            };
            return stability.run(&self.out.join("stability.json"), &outputs, self.markdown, self.json);
        }
        let files = ["frontier.svg", "frontier.png", "bench.json"].map(|name| self.out.join(name));
        files.iter().try_for_each(|file| outputs.check(file))?;
        if self.variant.is_some() && backends.iter().any(|backend| matches!(backend, Backend::Cpu)) {
            return Err(Error::Usage("--variant is for GPUs; name one with --executor gpu".into()));
        }
        let mut machine = Machine::here();
        let mut measured = Vec::new();
        for backend in backends {
            let peak = Peak::measure(&backend)?;
            machine.peaks.push(ProcessorPeak {
                executor: backend.name(),
                adapter: backend.adapter(),
                gflop_per_s: 1e-9 * peak.flop_rate,
                copy_gbyte_per_s: 1e-9 * peak.copy_rate,
            });
            measured.push((backend, peak));
        }
        let report = |rows: &[Row]| json!({ "machine": machine, "rows": rows, "files": files.each_ref().map(|path| show(path)) });
        // Rows are written as they come, and told whether or not that can be done.
        let mut written = Ok(());
        let rows = self.rows(&nets, &measured, |rows| {
            let text = terminal::with_warnings(&report(rows))
                .and_then(|report| Ok(serde_json::to_vec_pretty(&report)?));
            written = text.and_then(|text| atomic::write_bytes(&files[2], &text));
        })?;
        let plot = frontier(&rows);
        let written = written
            .and_then(|()| plot.write(&files[0], 960, 600))
            .and_then(|()| plot.write(&files[1], 960, 600));
        terminal::result(self.json, &report(&rows), || {
            let names = files.each_ref().map(|path| show(path)).join(", ");
            let text = self.text(&machine, &rows);
            if written.is_ok() { format!("{text}\n\nwritten: {names}") } else { text }
        })?;
        written
    }

    /// Names of the nets.
    fn names(&self) -> Vec<String> {
        if !self.weights.is_empty() {
            return self.weights.clone();
        }
        let wanted = presets::all().into_iter().filter(|preset| preset.trained || !self.quick);
        wanted.map(|preset| preset.name.to_owned()).collect()
    }

    /// Where the nets run, each place once.
    fn backends(&self) -> Result<Vec<Backend>> {
        let mut backends: Vec<Backend> = Vec::new();
        for &executor in &self.executor {
            // A name of an adapter says nothing about the CPU.
            let adapter = self.adapter.as_deref().filter(|_| executor != ExecutorChoice::Cpu);
            let backend = Backend::choose(executor, adapter, network::Precision::F32)?;
            let same =
                |other: &Backend| (other.name(), other.adapter()) == (backend.name(), backend.adapter());
            if !backends.iter().any(same) {
                backends.push(backend);
            }
        }
        Ok(backends)
    }

    /// A place at each precision that it has.
    fn at_precisions(&self, backend: &Backend) -> Vec<Backend> {
        self.precision.iter().filter_map(|precision| backend.at(precision.storage())).collect()
    }

    /// Measures every combination; `so_far` hears of all rows after each one.
    fn rows(
        &self,
        nets: &[Net],
        backends: &[(Backend, Peak)],
        mut so_far: impl FnMut(&[Row]),
    ) -> Result<Vec<Row>> {
        let effort = if self.quick {
            Effort { patience: Duration::from_millis(300), check_flop: 4e9 }
        } else {
            Effort { patience: Duration::from_millis(1500), check_flop: 60e9 }
        };
        let lengths = match &self.frames[..] {
            [] if self.quick => &[40],
            [] => &[80],
            given => given,
        };
        let places: usize = backends.iter().map(|(backend, _)| self.at_precisions(backend).len()).sum();
        let skips = self.skip.iter().map(|skip| skip.within(self.allowed_error));
        let ways: Vec<_> =
            skips.flat_map(|skip| self.ensemble.iter().map(move |&ensemble| (skip, ensemble))).collect();
        let count = nets.len() * self.size.len() * lengths.len() * self.scene.len() * places * ways.len();
        let bar = terminal::progress(count, "measuring");
        let mut rows = Vec::with_capacity(count);
        let clips = self.size.iter().flat_map(|size| lengths.iter().map(move |frames| (size, *frames)));
        for (&FrameSize { width, height }, frames) in clips {
            for name in &self.scene {
                let scene = procedural::by_name(name, height, width, self.seed)
                    .ok_or_else(|| Error::Usage(format!("no scene '{name}'")))?;
                let seed = self.seed;
                let how = Rendering { frames, height, width, instants: 8, positions: 1, seed };
                let (truth, _) = render(&*scene, how)?;
                for net in nets {
                    let Net { name: preset, model, trained } = net;
                    let clip = Clip::new(name, truth.clone(), net.pattern()?, self.seed)?;
                    // Every place computes the same windows, the longest that fit everywhere.
                    let mut model = model.clone();
                    for (backend, _) in backends {
                        model = fitted(&model, &clip.capture.calibration(), [height, width], backend)?;
                    }
                    let model = &model;
                    let oracle = Oracle::new(model, &clip, effort.check_flop)?;
                    for &(ref backend, peak) in backends {
                        for backend in &self.at_precisions(backend) {
                            for &(skip, ensemble) in &ways {
                                let weights = preset.clone();
                                let settings = Settings { weights, skip, ensemble, ..Settings::default() };
                                let case = Case {
                                    settings: &settings,
                                    model,
                                    trained: *trained,
                                    backend,
                                    peak,
                                    variant: self.variant,
                                    effort,
                                    per_layer: self.per_layer,
                                };
                                rows.push(case.measure(&clip, &oracle)?);
                                so_far(&rows);
                                bar.inc(1);
                            }
                        }
                    }
                }
            }
        }
        bar.finish_and_clear();
        Ok(rows)
    }

    /// All that was measured, for people.
    fn text(&self, machine: &Machine, rows: &[Row]) -> String {
        let mut text = String::new();
        let cpu = machine.cpu.as_deref().unwrap_or("processor of unknown name");
        text += &format!("{cpu}, {} threads, {} {}\n", machine.cpu_threads, machine.os, machine.arch);
        for peak in &machine.peaks {
            text += &format!(
                "{}: {} GFLOP/s of multiply-adds, {} GB/s of copying, measured\n",
                peak.adapter.as_deref().unwrap_or(peak.executor),
                short(peak.gflop_per_s),
                short(peak.copy_gbyte_per_s)
            );
        }
        text += "\n";
        text += &speed_table(rows).text(self.markdown);
        text += "\n\n";
        text += &error_table(rows).text(self.markdown);
        text += "\n\n";
        text += &floor_table(rows).text(self.markdown);
        for row in rows {
            if let Some(table) = layer_table(row) {
                text += &format!("\n\n{}\n\n{}", title(row), table.text(self.markdown));
            }
        }
        if rows.iter().any(|row| row.weights == "random") {
            text += "\n\n* random weights: as fast as trained ones, but what comes out is no picture";
        }
        text
    }
}

/// Name of a net and in how many views, marked where its weights are random.
fn preset(row: &Row) -> String {
    row.net() + if row.weights == "random" { "*" } else { "" }
}

/// What a row is about.
fn subject(row: &Row) -> Vec<String> {
    let size = format!("{}×{}", row.width, row.height);
    let frames = counted(row.frames, "frame");
    vec![
        preset(row),
        row.executor.into(),
        row.precision.into(),
        row.skip.into(),
        row.scene.clone(),
        size,
        frames,
    ]
}

fn title(row: &Row) -> String {
    subject(row).join(", ")
}

const SUBJECT: [&str; 7] = ["net", "executor", "numbers", "skip", "scene", "pixels", "clip"];

fn speed_table(rows: &[Row]) -> Table {
    let mut table = Table::new(
        &[
            &SUBJECT[..],
            &["ms/frame", "p95", "device ms", "processor ms", "end to end ms", "end to end ms/Mpixel"],
            &["frames/s", "Mpixel/s"],
            &["GFLOP/frame", "% of peak", "MiB"],
        ]
        .concat(),
    );
    for row in rows {
        let mut cells = subject(row);
        let mpixel = 1e-6 * (row.width * row.height) as f64;
        cells.extend([
            short(row.ms_per_frame_median),
            short(row.ms_per_frame_p95),
            row.device_ms_per_frame_median.map_or_else(|| figure(None, 0), short),
            row.processor_ms_per_frame.map_or_else(|| figure(None, 0), short),
            row.end_to_end_ms_per_frame.map_or_else(|| figure(None, 0), short),
            row.end_to_end_ms_per_frame.map_or_else(|| figure(None, 0), |ms| short(ms / mpixel)),
            short(row.frames_per_s),
            short(row.mpixel_per_s),
            short(row.floors.gflop_per_frame),
            figure(Some(100.0 * row.peak_fraction), 1),
            figure(row.peak_memory_bytes.map(|bytes| bytes as f64 / f64::from(1 << 20)), 0),
        ]);
        table.row(cells);
    }
    table
}

fn error_table(rows: &[Row]) -> Table {
    let headings = ["PSNR-µ dB", "box filter dB", "against f64 dB", "% of bound", "% of tiles computed"];
    let mut table = Table::new(&[&SUBJECT[..], &headings].concat());
    for row in rows {
        let mut cells = subject(row);
        cells.extend([
            figure(row.psnr_mu_db, 2),
            figure(Some(row.box_psnr_mu_db), 2),
            figure(row.psnr_vs_oracle_db, 1),
            figure(row.max_error_bound_fraction.map(|fraction| 100.0 * fraction), 1),
            figure(row.tiles_computed_fraction.map(|fraction| 100.0 * fraction), 1),
        ]);
        table.row(cells);
    }
    table
}

/// How fast each net can be at best. Scenes and skipping change nothing here.
fn floor_table(rows: &[Row]) -> Table {
    let mut table = Table::new(&[
        "net",
        "executor",
        "numbers",
        "pixels",
        "GFLOP/frame",
        "MB/frame, step by step",
        "MB/frame, in and out only",
        "FLOP/byte",
        "arithmetic floor ms/frame",
        "bytes floor ms/frame",
        "measured / higher floor",
    ]);
    let mut seen = Vec::new();
    for row in rows {
        let key = (row.net(), row.executor, row.precision, row.width, row.height);
        if seen.contains(&key) {
            continue;
        }
        seen.push(key);
        let floors = row.floors;
        let highest = floors.arithmetic_floor_ms_per_frame.max(floors.bytes_floor_ms_per_frame);
        table.row(vec![
            preset(row),
            row.executor.into(),
            row.precision.into(),
            format!("{}×{}", row.width, row.height),
            short(floors.gflop_per_frame),
            short(floors.mbyte_per_frame),
            short(floors.least_mbyte_per_frame),
            short(1e3 * floors.gflop_per_frame / floors.mbyte_per_frame),
            short(floors.arithmetic_floor_ms_per_frame),
            short(floors.bytes_floor_ms_per_frame),
            short(row.ms_per_frame_median / highest),
        ]);
    }
    table
}

/// Where the time of a row goes.
fn layer_table(row: &Row) -> Option<Table> {
    let layers = row.layers.as_ref()?;
    let mut table = Table::new(&[
        "step",
        "kernel",
        "output t×y×x×c",
        "ms/frame",
        "% of time",
        "GFLOP/s",
        "FLOP/byte",
        "roofline ms/frame",
        "measured / roofline",
    ]);
    let whole: f64 = layers.iter().map(|layer| layer.ms_per_frame).sum();
    for layer in layers {
        table.row(vec![
            layer.step.clone(),
            layer.kernel.into(),
            layer.output.clone(),
            short(layer.ms_per_frame),
            figure(Some(100.0 * layer.ms_per_frame / whole), 1),
            figure(Some(layer.gflop_per_s).filter(|rate| *rate > 0.0), 1),
            figure(Some(layer.flop_per_byte).filter(|intensity| *intensity > 0.0), 1),
            short(layer.roofline_ms_per_frame),
            short(layer.times_roofline),
        ]);
    }
    Some(table)
}

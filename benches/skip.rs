//! What skipping saves and what it costs: a table of made-up scenes, each with skipping off, exact and bounded.
//!
//! `cargo bench --bench skip -- [--weights FILE|PRESET] [--size HEIGHTxWIDTH] [--frames N] [--scene NAME] [--mover R]
//! [--speed P] [--rounds N] [--executor cpu|gpu] [--hop N] [--allowed-error L]`. The modes run in turn, so that a busy
//! machine slows all of them down; times are the medians of the rounds.

use pix2hdr::network::Model;
use pix2hdr::quality::compare;
use pix2hdr::sensor::{Capture, Form, Pattern, Sampler};
use pix2hdr::synth::{Backend, Options, Report, Request, Skip, Synthesizer};
use pix2hdr::video::Video;

struct Arguments {
    weights: String,
    extent: [usize; 2],
    frames: usize,
    scenes: Vec<String>,
    mover: f32,
    speed: f32,
    rounds: usize,
    executor: Request,
    hop: Option<usize>,
    allowed: f64,
}

fn arguments() -> Arguments {
    let mut found = Arguments {
        weights: "fast".into(),
        extent: [128, 128],
        frames: 1024,
        scenes: ["still", "mover", "brightening", "moving"].map(str::to_owned).to_vec(),
        mover: 8.0,
        speed: 0.5,
        rounds: 3,
        executor: Request::Cpu,
        hop: None,
        allowed: Skip::ALLOWED_ERROR,
    };
    // Cargo adds `--bench`.
    let mut given = std::env::args().skip(1).filter(|argument| argument != "--bench");
    while let Some(argument) = given.next() {
        let value = given.next().unwrap_or_else(|| panic!("{argument} wants a value"));
        let number = || value.parse().unwrap_or_else(|_| panic!("{argument} wants a number"));
        match argument.as_str() {
            "--weights" => found.weights = value,
            "--size" => {
                let (h, w) = value.split_once('x').expect("a size such as 128x128");
                found.extent = [h.parse().expect("a height"), w.parse().expect("a width")];
            }
            "--frames" => found.frames = number() as usize,
            "--scene" => found.scenes = vec![value],
            "--mover" => found.mover = number() as f32,
            "--speed" => found.speed = number() as f32,
            "--rounds" => found.rounds = number() as usize,
            "--hop" => found.hop = Some(number() as usize),
            "--allowed-error" => found.allowed = number(),
            "--executor" => found.executor = if value == "gpu" { Request::Gpu } else { Request::Cpu },
            _ => panic!("unknown argument {argument}"),
        }
    }
    found
}

/// A texture of several scales, from dark to bright.
fn texture(y: f32, x: f32) -> f32 {
    let wave = |scale: f32, phase: f32| ((x / scale + phase).sin() + (y / scale * 1.3 - phase).cos()) / 2.0;
    let octaves = wave(37.0, 0.3) + 0.6 * wave(13.0, 1.1) + 0.4 * wave(5.0, 2.3) + 0.3 * wave(2.1, 0.7);
    (0.12 * (1.1 * octaves).exp()).min(1.2)
}

/// A scene by its name: a texture, with a disk that goes back and forth, that brightens, or that moves as a whole.
fn scene(arguments: &Arguments, name: &str) -> Video {
    let [height, width] = arguments.extent;
    let mut video = Video::black(arguments.frames, height, width);
    let (radius, speed) = (arguments.mover, arguments.speed);
    for t in 0..arguments.frames {
        let time = t as f32;
        let span = (width as f32 - 4.0 * radius).max(1.0);
        let way = (time * speed) % (2.0 * span);
        let center_x = 2.0 * radius + if way < span { way } else { 2.0 * span - way };
        let center_y = height as f32 * 0.5 + height as f32 * 0.2 * (time * speed * 0.01).sin();
        let pan = if name == "moving" { time * speed } else { 0.0 };
        // 0.1% per window of 40 frames.
        let gain = if name == "brightening" { 1.001f32.powf(time / 40.0) } else { 1.0 };
        for (i, p) in video.frame_mut(t).iter_mut().enumerate() {
            let (y, x) = ((i / width) as f32, (i % width) as f32);
            *p = gain * texture(y, x + pan);
            if name == "mover" {
                let (dy, dx) = (y - center_y, x - center_x);
                let inside = (radius - dy.hypot(dx) + 0.5).clamp(0.0, 1.0);
                let own = 0.4 + 0.35 * ((dx * 0.9).sin() * (dy * 0.7).cos());
                *p = *p * (1.0 - inside) + own * inside;
            }
        }
    }
    video
}

fn main() {
    let arguments = arguments();
    let model = Model::load(&arguments.weights).expect("weights");
    let backend = Backend::choose(arguments.executor, None).expect("an executor");
    println!(
        "{} at {}×{}, {} frames, disk of radius {} at {} px/frame, {}",
        model.graph.name,
        arguments.extent[0],
        arguments.extent[1],
        arguments.frames,
        arguments.mover,
        arguments.speed,
        backend.adapter().unwrap_or_else(|| format!("cpu, {} threads", rayon::current_num_threads())),
    );
    println!(
        "{:12} {:8} {:>9} {:>9} {:>9} {:>7} {:>7} {:>7} {:>9} {:>8} {:>9} {:>9}",
        "scene",
        "skip",
        "cpu ms",
        "ms/frame",
        "frames/s",
        "ratio",
        "cells",
        "work",
        "PSNR-µ",
        "loss",
        "of off",
        "gate"
    );
    for name in &arguments.scenes {
        let truth = scene(&arguments, name);
        let pattern =
            Pattern::built_in(if model.graph.pattern == "any" { "mpve-1-4" } else { &model.graph.pattern });
        let sampler = Sampler::new(pattern.expect("a pattern"), Form::Linear).expect("a camera");
        let capture = sampler.sample(&truth).expect("a capture");
        measure(&arguments, &model, &backend, name, &truth, &capture);
    }
}

/// Time that all threads of this program have computed so far, in seconds; 0 where the system does not say.
fn processor_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|field| field.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

fn measure(
    arguments: &Arguments,
    model: &Model,
    backend: &Backend,
    name: &str,
    truth: &Video,
    capture: &Capture,
) {
    let modes = [("off", Skip::Off), ("exact", Skip::Exact), ("bounded", Skip::Bounded(arguments.allowed))];
    let mut synthesizers = modes.map(|(_, skip)| {
        let options = Options { skip, hop: arguments.hop, side: None };
        Synthesizer::with(model, capture.calibration(), arguments.extent, backend, options)
            .expect("a synthesizer")
    });
    let mut processor = [0.0; 3];
    let mut runs: Vec<Vec<(Video, Report)>> = modes.iter().map(|_| Vec::new()).collect();
    for _ in 0..arguments.rounds {
        for ((runs, synthesizer), processor) in runs.iter_mut().zip(&mut synthesizers).zip(&mut processor) {
            let begun = processor_seconds();
            let run = synthesizer.video(capture).expect("a video");
            *processor += processor_seconds() - begun;
            // Only the last video is looked at.
            if let Some((video, _)) = runs.last_mut() {
                video.data = Vec::new();
            }
            runs.push(run);
        }
    }
    let time = |runs: &[(Video, Report)]| {
        let mut times: Vec<f64> = runs.iter().map(|(_, report)| report.mean_ms()).collect();
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    };
    let time_off = time(&runs[0]);
    let off = runs[0].last().expect("a round").0.clone();
    let psnr_off = compare(truth, &off).expect("one size").psnr_mu;
    for ((mode, _), (runs, processor)) in modes.iter().zip(runs.iter().zip(processor)) {
        let processor = 1e3 * processor / (arguments.rounds * arguments.frames) as f64;
        let (video, report) = runs.last().expect("a round");
        let psnr = compare(truth, video).expect("one size").psnr_mu;
        let against_off = compare(&off, video).expect("one size").psnr_mu;
        let skipped = report.skipping.as_ref();
        println!(
            "{name:12} {mode:8} {processor:9.3} {:9.3} {:9.0} {:7.2} {:6.1}% {:6.1}% {psnr:9.3} {:8.3} {against_off:9.2} {:8.2}%  {}",
            time(runs),
            1e3 / time(runs),
            time_off / time(runs),
            100.0 * skipped.map_or(1.0, pix2hdr::synth::Skipped::active_fraction),
            100.0 * skipped.map_or(1.0, |skipped| skipped.work),
            psnr_off - psnr,
            100.0 * report.gating.as_secs_f64() / report.wall.as_secs_f64(),
            skipped.and_then(|s| s.audit.rms()).map_or(String::new(), |rms| format!("audit {rms:.5}")),
        );
    }
}

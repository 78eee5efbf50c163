//! Where the time of a net goes on the CPU: a table of its steps.
//!
//! `cargo bench --bench cpu -- [PRESET|FILE …] [--size HEIGHTxWIDTH] [--threads N] [--simd NAME]`, by default
//! all presets, 128×128 pixels, all threads, the widest vectors. A preset has random weights, a file its own.
//! Each time is the shortest of several windows, as other programs only ever make a step slower. The last
//! column is the part of what as many threads do at most, if they do nothing but fused multiply-add. It counts
//! products with padding, which are not computed in time, so short windows can have more than all.

use std::time::{Duration, Instant};

use pix2hdr::cpu::{self, CpuExecutor, Simd};
use pix2hdr::network::{Model, Plan, presets};
use pix2hdr::sensor::{Calibration, Form, Pattern, Response};

/// How long to repeat windows of one preset.
const PATIENCE: Duration = Duration::from_secs(3);

fn main() {
    // Cargo adds `--bench`.
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let (mut names, mut height, mut width, mut threads) = (Vec::new(), 128, 128, 0);
    let mut simd = Simd::widest();
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_else(|| panic!("{argument} wants a value"));
        match argument.as_str() {
            "--size" => {
                let size = value();
                let (h, w) = size.split_once('x').expect("a size such as 128x128");
                (height, width) = (h.parse().expect("a height"), w.parse().expect("a width"));
            }
            "--simd" => {
                let name = value();
                let found = Simd::available().into_iter().find(|simd| simd.name() == name);
                simd = found.unwrap_or_else(|| panic!("this processor has no {name}"));
            }
            "--threads" => threads = value().parse().expect("a number of threads"),
            _ => names.push(argument),
        }
    }
    if names.is_empty() {
        names = presets::all().map(|preset| preset.name.to_owned()).to_vec();
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    for name in names {
        let model = if name.ends_with(".safetensors") {
            Model::read(&name).expect("a weights file")
        } else {
            let graph = presets::by_name(&name).and_then(|preset| preset.graph()).expect("a preset");
            Model::random(graph, 1).expect("a valid graph")
        };
        let plan = Plan::lower(&model, height, width).expect("a size that the preset accepts");
        pool.install(|| print_table(&plan, simd));
    }
}

fn print_table(plan: &Plan, simd: Simd) {
    let pattern = Pattern::built_in("mpve-1-4").expect("built in");
    let response = Response::new(Form::Linear, pattern.shortest_exposure() as f64).expect("valid");
    let len = plan.measurement.shape.len();
    let measurement: Vec<f32> = (0..len).map(|i| (i * 7919 % 1024) as f32 / 1023.0).collect();
    let mut executor =
        CpuExecutor::<f32>::with_simd(plan.clone(), Calibration::new(&pattern, &response), simd);
    let peak = cpu::peak(simd) * rayon::current_num_threads() as f64;
    let mut shortest = vec![Duration::MAX; plan.steps.len()];
    let (begin, mut windows) = (Instant::now(), Vec::new());
    while windows.len() < 3 || begin.elapsed() < PATIENCE {
        let times = executor.time_steps(&measurement, 0).expect("a measurement of the right size");
        windows.push(times.iter().map(|(_, time)| *time).sum::<Duration>());
        for (shortest, (_, time)) in shortest.iter_mut().zip(times) {
            *shortest = (*shortest).min(time);
        }
    }
    windows.sort_unstable();
    let (whole, median) = (windows[0], windows[windows.len() / 2]);
    println!(
        "\n{:16} {:>20} {:>10} {:>10} {:>10} {:>8}",
        plan.name, "output", "ms", "GFLOP", "GFLOP/s", "of peak"
    );
    let row = |name: &str, shape: &str, flop: f64, time: Duration| {
        let (ms, gflop) = (time.as_secs_f64() * 1e3, flop * 1e-9);
        let rate = flop / time.as_secs_f64();
        let speed = if flop > 0.0 {
            format!("{:10.1} {:7.0}%", rate * 1e-9, 100.0 * rate / peak)
        } else {
            String::new()
        };
        println!("{name:16} {shape:>20} {ms:10.3} {gflop:10.3} {speed}");
    };
    for (step, time) in plan.steps.iter().zip(&shortest) {
        row(&step.name, &step.output.shape.to_string(), step.flop(), *time);
    }
    row("sum of shortest", "", plan.flop(), shortest.iter().sum());
    row("shortest window", "", plan.flop(), whole);
    let frames = plan.window.hop as f64;
    let frame = |window: Duration| window.as_secs_f64() * 1e3 / frames;
    println!(
        "per result frame: {:.3} ms, median {:.3} ms, {:.3} GFLOP ({} windows, {} threads, {})",
        frame(whole),
        frame(median),
        plan.flop() * 1e-9 / frames,
        windows.len(),
        rayon::current_num_threads(),
        simd.name()
    );
}

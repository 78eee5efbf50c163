//! What both programs have to do: every command that writes files, every built-in net, every way to compute.

use std::path::{Path, PathBuf};

/// A run of the program.
pub struct Case {
    /// What it is, in words that are a folder's name too.
    pub name: String,
    /// Arguments, without `--json`.
    pub arguments: Vec<String>,
    /// Threads, where they are given.
    pub threads: Option<usize>,
    /// Whether a GPU computes, whose bits are promised for one driver and one program only.
    pub gpu: bool,
}

/// What cases read. The old program makes all of it, so that both read the same.
pub struct Inputs {
    /// Folder of all of it.
    pub folder: PathBuf,
    /// Names of recordings; `NAME` is the recording, `NAME-small` its beginning.
    pub recordings: Vec<String>,
}

/// Rows and columns of simulated captures and of small recordings, and their frames: several short windows, and more
/// than two of the longest periods.
pub const SMALL: [usize; 3] = [72, 32, 32];

const NETS: [&str; 5] = ["tiny", "fast", "robust", "large", "paper-narrow"];
const PATTERNS: [&str; 9] = [
    "mpve-1-4",
    "mpve-1-8",
    "mpve-1-16",
    "mpve-2x2-1-4",
    "global",
    "multi-phase",
    "sve",
    "interleaved",
    "coded",
];
const SCENES: [&str; 8] = ["fan", "leds", "falling", "pouring", "edge", "wedge", "still", "still-moving"];

impl Inputs {
    /// The commands that make what is read, beside recordings that are given.
    pub fn commands(simulate_recording: bool) -> Vec<Vec<String>> {
        let [frames, height, width] = SMALL;
        let size = format!("--frames {frames} --height {height} --width {width} --samples 2");
        let noise_free = "--full-well 0 --read-noise 0";
        let mut commands = vec![
            format!("scene fan --out fan.npy {size}"),
            format!("scene edge --out edge.npy {size}"),
            format!("scene still --out still.npy --frames {frames} --height 64 --width 64 --samples 2"),
            // Large enough that a moving part is not within reach of all others, so that something is skipped.
            format!(
                "scene still-moving --out still-moving.npy --frames {frames} --height 96 --width 128 --samples 2"
            ),
            format!("sample fan.npy --out noisy --full-well 1000"),
            format!("sample still.npy --out static {noise_free}"),
            format!("sample still-moving.npy --out noise-free {noise_free}"),
            format!("sample still-moving.npy --out partly-still"),
            format!("sample fan.npy --out held --hold --schedule-start 3"),
            format!("sample fan.npy --out mpve-1-8 --pattern mpve-1-8"),
            format!("sample fan.npy --out mpve-1-16 --pattern mpve-1-16"),
            format!("sample still.npy --out gamma --response gamma:2.2 --bit-depth 8"),
            format!("scene still --out panoramas --frames 1 --height 32 --width 64"),
        ];
        if simulate_recording {
            commands.push("sample fan.npy --out simulated".into());
        }
        commands.iter().map(|line| words(line)).collect()
    }

    /// The case of a line of arguments, in which `{NAME}` stands for an input.
    fn case(&self, line: &str, threads: Option<usize>) -> Case {
        let input = |word: &str| {
            let name = word.strip_prefix('{').and_then(|word| word.strip_suffix('}'));
            name.map(|name| self.folder.join(name).display().to_string())
        };
        let arguments = words(line).into_iter().map(|word| input(&word).unwrap_or(word)).collect();
        let with_threads = threads.map_or_else(String::new, |n| format!(" on {n} threads"));
        let name = line.replace(['{', '}'], "").replace('/', "-") + &with_threads;
        Case { name, arguments, threads, gpu: line.contains("--executor gpu") }
    }
}

/// A line of arguments as words; paths with blanks are put in afterwards.
fn words(line: &str) -> Vec<String> {
    line.split_whitespace().map(str::to_owned).collect()
}

/// The CPU, and the folder of results.
const CPU: &str = "--executor cpu --out result";

/// All cases; those of the `quick` form are a part of each kind but that on a GPU.
pub fn all(inputs: &Inputs, quick: bool) -> Vec<Case> {
    let mut lines = Vec::new();
    for recording in &inputs.recordings {
        let whole = if quick { format!("{recording}-small") } else { recording.clone() };
        lines.extend(NETS.map(|net| format!("synth {{{whole}}} --weights {net} {CPU}")));
        if !quick {
            lines.push(format!("synth {{{recording}}} --skip bounded {CPU}"));
            lines.push(format!("synth {{{recording}}} --tile 64 --ensemble 2 --skip bounded {CPU}"));
        }
    }
    let varied = if quick { &inputs.recordings[..1] } else { &inputs.recordings[..] };
    for recording in varied {
        lines.extend(ways(&format!("{{{recording}-small}}")));
    }
    lines.extend(simulated());
    lines.extend(other_commands(quick));
    let mut cases: Vec<Case> = lines.iter().map(|line| inputs.case(line, None)).collect();
    for threads in [1, 2] {
        let small = format!("{{{}-small}}", inputs.recordings[0]);
        for how in ["", " --weights tiny --hop 8 --skip bounded", " --tile 24 --ensemble 2"] {
            cases.push(inputs.case(&format!("synth {small} {CPU}{how}"), Some(threads)));
        }
    }
    if !quick {
        let small = format!("{{{}-small}}", inputs.recordings[0]);
        cases.extend(on_gpu(&small).iter().map(|line| inputs.case(line, None)));
    }
    cases
}

/// Every way to compute a small recording.
fn ways(small: &str) -> Vec<String> {
    let synth = format!("synth {small} {CPU}");
    let ways = [
        "--half",
        "--hop 8",
        "--ensemble 2",
        "--skip exact",
        "--skip bounded",
        "--skip bounded --allowed-error 0.02 --hop 16",
        "--timing hold",
        "--schedule-start -5",
        "--weights tiny --ensemble 8 --skip bounded --tile 24",
    ];
    let mut lines: Vec<String> = ways.iter().map(|how| format!("{synth} {how}")).collect();
    lines.extend(["tiny", "fast"].map(|net| format!("{synth} --weights {net} --tile 24 --hop 16")));
    lines.extend(["large", "paper-narrow"].map(|net| format!("{synth} --weights {net} --tile 24")));
    lines.push(format!("{synth}.npy --weights tiny"));
    lines.push(format!("{synth}.npy --weights tiny --half"));
    let array = small.replace('}', "/capture.npy}");
    lines.push(format!("import {array} --out imported"));
    lines.push(format!("import {array} --out imported --timing hold"));
    lines
}

/// What recordings do not have: repetition to the bit, other patterns, responses and defects, and a ground truth.
fn simulated() -> Vec<String> {
    let mut lines = Vec::new();
    for net in ["tiny", "fast"] {
        for what in [
            "{static} --skip exact --hop 8",
            "{noise-free} --skip exact --hop 8",
            "{partly-still} --skip bounded --hop 8",
            "{noisy} --truth {fan.npy}",
            "{held} --hop 8",
        ] {
            lines.push(format!("synth {what} --weights {net} {CPU}"));
        }
    }
    for pattern in ["{mpve-1-8}", "{mpve-1-16}"] {
        lines.push(format!("synth {pattern} {CPU}"));
        lines.push(format!("synth {pattern} --ensemble 2 --tile 24 --skip bounded --hop 16 {CPU}"));
    }
    lines.push(format!("synth {{gamma}} --weights tiny {CPU}"));
    lines.push(format!("synth {{noisy}} --weights tiny --dead-pixels {{dead.txt}} --missing-count 0 {CPU}"));
    lines.push("import {gamma/capture.npy} --out imported --response linear --fit-response".into());
    lines.push("import {held/capture.npy} --out imported".into());
    lines
}

/// Commands other than `synth` and `import`.
fn other_commands(quick: bool) -> Vec<String> {
    let [frames, height, width] = if quick { SMALL } else { [64, 128, 128] };
    let size = format!("--frames {frames} --height {height} --width {width}");
    let mut lines = vec![
        format!("demo fan {size} {CPU}"),
        format!("demo fan --hold {size} {CPU}"),
        format!("demo leds --pattern mpve-1-8 --skip bounded {size} {CPU}"),
    ];
    let size = "--frames 6 --height 24 --width 40";
    lines.extend(SCENES.map(|scene| format!("scene {scene} --out truth.npy --seed 5 {size}")));
    lines.push(format!("scene fan --out truth --half {size}"));
    let panorama = "{panoramas/frame-00000.exr}";
    lines.extend(
        ["pan", "object", "both"]
            .map(|moves| format!("scene fast --panorama {panorama} --moves {moves} --out truth.npy {size}")),
    );
    lines.extend(
        PATTERNS.map(|pattern| {
            format!("sample {{fan.npy}} --out capture --pattern {pattern} --seed 3 --normalise")
        }),
    );
    for line in [
        "sample {fan.npy} --out capture --response soft-knee:0.6 --bit-depth 12 --hold",
        "dataset --panoramas {panoramas} --out cubes --cubes 3 --frames 12 --size 16",
        "eval {fan.npy} {edge.npy}",
        "suite --panoramas {panoramas} --weights tiny --executor cpu --frames 9 --size 16",
    ] {
        lines.push(line.into());
    }
    lines.extend(NETS.iter().chain(&["fast-1-8", "fast-1-16"]).map(|net| format!("weights {net}")));
    lines
}

fn on_gpu(small: &str) -> Vec<String> {
    let mut lines = Vec::new();
    for precision in ["f32", "f16"] {
        let gpu = format!("--executor gpu --precision {precision} --out result");
        lines.extend(NETS.map(|net| format!("synth {small} --weights {net} {gpu}")));
        lines.push(format!("synth {small} --weights tiny --hop 16 {gpu}"));
        lines.push(format!("synth {small} --weights tiny --tile 24 --ensemble 2 {gpu}"));
        lines.push(format!("synth {{partly-still}} --weights tiny --skip bounded --hop 8 {gpu}"));
        lines.push(format!("synth {{mpve-1-16}} {gpu}"));
    }
    lines
}

/// A list of dead pixels for [`SMALL`] frames.
pub fn write_dead_pixels(folder: &Path) -> std::io::Result<()> {
    std::fs::write(folder.join("dead.txt"), "3 4\n3 5\n17 30\n31 0\n")
}

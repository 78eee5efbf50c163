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

    fn path(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }
}

/// A line of arguments as words; paths with blanks are put in afterwards.
fn words(line: &str) -> Vec<String> {
    line.split_whitespace().map(str::to_owned).collect()
}

/// All cases; those of the `quick` form are a part of each kind but that on a GPU.
pub fn all(inputs: &Inputs, quick: bool) -> Vec<Case> {
    let mut cases = Vec::new();
    // `{NAME}` stands for an input.
    let mut add = |line: &str, threads: Option<usize>| {
        let arguments: Vec<String> = words(line)
            .into_iter()
            .map(|word| match word.strip_prefix('{').and_then(|word| word.strip_suffix('}')) {
                Some(input) => inputs.path(input),
                None => word,
            })
            .collect();
        let threads_name = threads.map_or_else(String::new, |n| format!(" on {n} threads"));
        let name = line.replace(['{', '}'], "").replace('/', "-") + &threads_name;
        cases.push(Case { name, arguments, threads, gpu: line.contains("--executor gpu") });
    };
    let cpu = "--executor cpu --out result";
    for recording in &inputs.recordings {
        let whole = if quick { format!("{recording}-small") } else { recording.clone() };
        for net in NETS {
            add(&format!("synth {{{whole}}} --weights {net} {cpu}"), None);
        }
    }
    if !quick {
        for recording in &inputs.recordings {
            add(&format!("synth {{{recording}}} --tile 64 --ensemble 2 --skip bounded {cpu}"), None);
            add(&format!("synth {{{recording}}} --skip bounded {cpu}"), None);
        }
    }
    let varied = if quick { &inputs.recordings[..1] } else { &inputs.recordings[..] };
    for recording in varied {
        let (small, tile) = (format!("{recording}-small"), 24);
        let synth = format!("synth {{{small}}} {cpu}");
        for how in [
            "--half",
            "--hop 8",
            "--ensemble 2",
            "--skip exact",
            "--skip bounded",
            "--skip bounded --allowed-error 0.02 --hop 16",
            "--timing hold",
            "--schedule-start -5",
        ] {
            add(&format!("{synth} {how}"), None);
        }
        for net in NETS {
            add(&format!("{synth} --weights {net} --tile {tile} --hop 16"), None);
        }
        add(&format!("{synth} --weights tiny --ensemble 8 --skip bounded --tile {tile}"), None);
        add(&format!("{synth}.npy --weights tiny"), None);
        add(&format!("{synth}.npy --weights tiny --half"), None);
        for threads in [1, 2] {
            add(&synth, Some(threads));
            add(&format!("{synth} --weights tiny --hop 8 --skip bounded"), Some(threads));
        }
        add(&format!("import {{{small}/capture.npy}} --out imported"), None);
        add(&format!("import {{{small}/capture.npy}} --out imported --timing hold"), None);
    }
    for net in ["tiny", "fast"] {
        add(&format!("synth {{static}} --weights {net} --skip exact --hop 8 {cpu}"), None);
        add(&format!("synth {{noise-free}} --weights {net} --skip exact --hop 8 {cpu}"), None);
        add(&format!("synth {{partly-still}} --weights {net} --skip bounded --hop 8 {cpu}"), None);
        add(&format!("synth {{noisy}} --weights {net} --truth {{fan.npy}} {cpu}"), None);
        add(&format!("synth {{held}} --weights {net} --hop 8 {cpu}"), None);
    }
    for pattern in ["mpve-1-8", "mpve-1-16"] {
        add(&format!("synth {{{pattern}}} {cpu}"), None);
        add(&format!("synth {{{pattern}}} --ensemble 2 --tile 24 --skip bounded --hop 16 {cpu}"), None);
    }
    add(&format!("synth {{gamma}} --weights tiny {cpu}"), None);
    add(&format!("synth {{noisy}} --weights tiny --dead-pixels {{dead.txt}} --missing-count 0 {cpu}"), None);
    add("import {gamma/capture.npy} --out imported --response linear --fit-response", None);
    add("import {held/capture.npy} --out imported", None);

    let [frames, height, width] = if quick { SMALL } else { [64, 128, 128] };
    let size = format!("--frames {frames} --height {height} --width {width}");
    add(&format!("demo fan {size} {cpu}"), None);
    add(&format!("demo fan --hold {size} {cpu}"), None);
    add(&format!("demo leds --pattern mpve-1-8 --skip bounded {size} {cpu}"), None);
    let size = "--frames 6 --height 24 --width 40";
    for scene in SCENES {
        add(&format!("scene {scene} --out truth.npy --seed 5 {size}"), None);
    }
    add(&format!("scene fan --out truth --half {size}"), None);
    for moves in ["pan", "object", "both"] {
        let panorama = "{panoramas/frame-00000.exr}";
        add(&format!("scene fast --panorama {panorama} --moves {moves} --out truth.npy {size}"), None);
    }
    for pattern in PATTERNS {
        add(&format!("sample {{fan.npy}} --out capture --pattern {pattern} --seed 3 --normalise"), None);
    }
    add("sample {fan.npy} --out capture --response soft-knee:0.6 --bit-depth 12 --hold", None);
    add("dataset --panoramas {panoramas} --out cubes --cubes 3 --frames 12 --size 16", None);
    add("eval {fan.npy} {edge.npy}", None);
    add("suite tiny --panoramas {panoramas} --weights tiny --executor cpu --frames 9 --size 16", None);
    for net in NETS.iter().chain(&["fast-1-8", "fast-1-16"]) {
        add(&format!("weights {net}"), None);
    }
    if !quick {
        for precision in ["f32", "f16"] {
            let gpu = format!("--executor gpu --precision {precision} --out result");
            let small = format!("{{{}-small}}", inputs.recordings[0]);
            for net in NETS {
                add(&format!("synth {small} --weights {net} --hop 16 {gpu}"), None);
            }
            add(&format!("synth {small} --tile 24 --ensemble 2 {gpu}"), None);
            add(&format!("synth {{partly-still}} --skip bounded --hop 8 {gpu}"), None);
            add(&format!("synth {{mpve-1-16}} {gpu}"), None);
        }
    }
    cases
}

/// A list of dead pixels for [`SMALL`] frames.
pub fn write_dead_pixels(folder: &Path) -> std::io::Result<()> {
    std::fs::write(folder.join("dead.txt"), "3 4\n3 5\n17 30\n31 0\n")
}

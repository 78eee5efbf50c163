//! What is written by any command and any option: nothing that is there without `--overwrite`, and never a source.
#![cfg(unix)]

#[path = "support/program.rs"]
mod program;

use std::any::TypeId;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use pix2hdr::video::{self, Video, Writing};
use program::succeeds;

/// An option that has something written: `OUT` stands for what it names.
struct Writer {
    command: &'static str,
    option: &'static str,
    out: &'static str,
    arguments: &'static str,
    /// Files that it writes, where finding out would take long.
    known: &'static [&'static str],
}

const fn writer(
    command: &'static str,
    option: &'static str,
    out: &'static str,
    arguments: &'static str,
) -> Writer {
    Writer { command, option, out, arguments, known: &[] }
}

/// Every option that writes, with each kind of what it can name.
const WRITERS: [Writer; 13] = [
    writer("demo", "out", "made", "--out OUT --frames 9 --size 16 --samples 1 --executor cpu --weights tiny"),
    writer("scene", "out", "made", "fan --out OUT --frames 3 --size 16 --samples 1"),
    writer("scene", "out", "made.npy", "fan --out OUT --frames 3 --size 16 --samples 1"),
    writer("scene", "out", "made.exr", "fan --out OUT --frames 1 --size 16 --samples 1"),
    writer("sample", "out", "made", "truth.npy --out OUT"),
    writer("import", "out", "made", "camera --out OUT"),
    writer("synth", "out", "made", "camera --out OUT --executor cpu --weights tiny"),
    writer("synth", "out", "made", "camera --out OUT --executor cpu --weights tiny --skip bounded"),
    writer("synth", "out", "made.npy", "camera --out OUT --executor cpu --weights tiny"),
    writer(
        "synth",
        "preview",
        "made.mp4",
        "camera --out elsewhere.npy --preview OUT --executor cpu --weights tiny",
    ),
    writer("bench", "out", "made", "--out OUT --quick --executor cpu --weights tiny --size 16 --frames 9"),
    Writer {
        command: "bench",
        option: "out",
        out: "made",
        arguments: "--out OUT --stability --quick --executor cpu --weights tiny",
        known: &["made/stability.json"],
    },
    writer("dataset", "out", "made", "--videos videos --out OUT --cubes 1 --frames 3 --size 16"),
];

/// Options and arguments whose files are read.
const READ: [&str; 11] = [
    "truth",
    "dead_pixels",
    "frame_numbers",
    "time_stamps",
    "panorama",
    "panoramas",
    "videos",
    "capture",
    "file",
    "video",
    "result",
];

/// A folder with a truth, a capture of it, a folder of videos, and an `ffmpeg` that writes all but `.xyz`.
struct Desk(tempfile::TempDir);

impl Desk {
    fn new() -> Self {
        let desk = Self(tempfile::tempdir().unwrap());
        let video = Video::new(9, 16, 16, (0..9 * 256).map(|i| (i % 97) as f32 / 97.0).collect()).unwrap();
        video::write(desk.path("truth.npy"), &video, Writing::default()).unwrap();
        video::write(desk.path("videos/one"), &video, Writing::default()).unwrap();
        desk.run(&["sample", "truth.npy", "--out", "camera"]);
        fs::create_dir(desk.path("bin")).unwrap();
        let script = "#!/bin/sh\nfor last; do :; done\ncase \"$last\" in\n-version) exit 0;;\n*.xyz) echo \"[NULL \
                      @ 0x1] Unable to choose an output format for '$last'\" >&2; exit 1;;\nesac\ncat > \"$last\"\n";
        fs::write(desk.path("bin/ffmpeg"), script).unwrap();
        fs::set_permissions(desk.path("bin/ffmpeg"), fs::Permissions::from_mode(0o755)).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let mut places = vec![self.path("bin")];
        places.extend(std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default()));
        let path: OsString = std::env::join_paths(places).unwrap();
        Command::new(env!("CARGO_BIN_EXE_pix2hdr"))
            .args(arguments)
            .current_dir(self.0.path())
            .env("PATH", path)
            .env_remove("RUST_LOG")
            .output()
            .unwrap()
    }

    /// Runs a writer.
    fn write(&self, Writer { command, out, arguments, .. }: &Writer, more: &[&str]) -> Output {
        let arguments = arguments.split(' ').map(|word| if word == "OUT" { out } else { word });
        self.run(&[*command].into_iter().chain(arguments).chain(more.iter().copied()).collect::<Vec<_>>())
    }

    /// All files, by their names from here.
    fn files(&self) -> BTreeSet<String> {
        let (mut files, mut folders) = (BTreeSet::new(), vec![self.0.path().to_owned()]);
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    files.insert(path.strip_prefix(self.0.path()).unwrap().display().to_string());
                }
            }
        }
        files
    }

    /// Removes what a writer makes.
    fn tidy(&self) {
        for name in [
            "made",
            "made.npy",
            "made.exr",
            "made.mp4",
            "made.report.json",
            "elsewhere.npy",
            "elsewhere.report.json",
        ] {
            let path = self.path(name);
            let _ = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
        }
    }
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// An option with a path is among those that write or those that read.
#[test]
fn every_path_is_written_or_read() {
    let mut writes = BTreeSet::new();
    for command in pix2hdr::cli::command().get_subcommands() {
        for argument in command.get_arguments() {
            let id = argument.get_id().as_str();
            if argument.get_value_parser().type_id() != TypeId::of::<PathBuf>() || READ.contains(&id) {
                continue;
            }
            let known =
                WRITERS.iter().any(|writer| (writer.command, writer.option) == (command.get_name(), id));
            assert!(known, "`{} --{id}` is neither among WRITERS nor among READ", command.get_name());
            assert!(
                command.get_arguments().any(|argument| argument.get_id() == "overwrite"),
                "`{}` has no --overwrite",
                command.get_name()
            );
            writes.insert((command.get_name().to_owned(), id.to_owned()));
        }
    }
    assert!(writes.len() >= 8, "{writes:?}");
}

/// Each file that a command writes is kept, if it is there before, until `--overwrite` is said.
#[test]
fn nothing_that_is_there_is_replaced() {
    let desk = Desk::new();
    let before = desk.files();
    for writer in &WRITERS {
        let Writer { command, option, out, known, .. } = writer;
        let what = format!("{command} --{option} {out}");
        let mut written: BTreeSet<String> = known.iter().map(|name| (*name).to_owned()).collect();
        if written.is_empty() {
            let output = desk.write(writer, &[]);
            assert!(output.status.success(), "{what}: {}", told(&output));
            written = desk.files().difference(&before).cloned().collect();
            assert!(!written.is_empty(), "{what}");
            // Twice is once too often, unless it is asked for.
            assert!(told(&desk.write(writer, &[])).contains("--overwrite"), "{what}");
            let output = desk.write(writer, &["--overwrite"]);
            assert!(output.status.success(), "{what}: {}", told(&output));
        }
        for name in &written {
            desk.tidy();
            let path = desk.path(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, "mine").unwrap();
            let output = desk.write(writer, &[]);
            assert_eq!(output.status.code(), Some(1), "{what} with {name}: {}", told(&output));
            assert!(told(&output).contains("--overwrite"), "{what} with {name}: {}", told(&output));
            assert_eq!(fs::read(&path).unwrap(), b"mine", "{what} replaced {name}");
            let left: Vec<_> = desk.files().difference(&before).cloned().collect();
            assert_eq!(left, [name.as_str()], "{what} with {name}");
        }
        desk.tidy();
    }
}

/// By whatever name, and whatever may be replaced, no command writes what it reads.
#[test]
fn no_source_is_a_target() {
    let desk = Desk::new();
    std::os::unix::fs::symlink(desk.path("truth.npy"), desk.path("link.npy")).unwrap();
    for (folder, name) in [("hard", "truth.npy"), ("again", "camera/capture.npy")] {
        fs::create_dir(desk.path(folder)).unwrap();
        fs::hard_link(desk.path(name), desk.path(folder).join("capture.npy")).unwrap();
    }
    fs::write(desk.path("dead.csv"), "3,4\n").unwrap();
    let before = desk.files();
    let contents =
        |desk: &Desk| before.iter().map(|name| fs::read(desk.path(name)).unwrap()).collect::<Vec<_>>();
    let sources = contents(&desk);
    for arguments in [
        "import camera --out camera",
        "import camera --out again",
        "import camera/capture.npy --out made --dead-pixels made/capture.json",
        "sample truth.npy --out hard",
        "synth camera --out camera/capture.npy",
        "synth camera --out link.npy --truth truth.npy",
        "synth camera --out made.npy --preview truth.npy --truth link.npy",
        "synth camera --out made.npy --preview dead.csv --dead-pixels dead.csv",
        "synth camera --out made.npy --preview camera/capture.json",
        "synth camera --out videos/one --truth videos/one/hdr",
    ] {
        let made = arguments.contains("made/").then(|| {
            fs::create_dir(desk.path("made")).unwrap();
            fs::write(desk.path("made/capture.json"), "3,4\n").unwrap();
        });
        if arguments.contains("one/hdr") {
            fs::rename(desk.path("videos/one"), desk.path("videos/hdr")).unwrap();
            fs::create_dir(desk.path("videos/one")).unwrap();
            fs::rename(desk.path("videos/hdr"), desk.path("videos/one/hdr")).unwrap();
        }
        let words: Vec<&str> = arguments.split(' ').chain(["--overwrite"]).collect();
        let output = desk.run(&words);
        assert_eq!(output.status.code(), Some(1), "{arguments}: {}", told(&output));
        assert!(told(&output).contains("the source itself"), "{arguments}: {}", told(&output));
        if made.is_some() {
            assert_eq!(fs::read(desk.path("made/capture.json")).unwrap(), b"3,4\n");
            desk.tidy();
        }
        if arguments.contains("one/hdr") {
            fs::rename(desk.path("videos/one/hdr"), desk.path("videos/hdr")).unwrap();
            fs::remove_dir(desk.path("videos/one")).unwrap();
            fs::rename(desk.path("videos/hdr"), desk.path("videos/one")).unwrap();
        }
        assert!(contents(&desk) == sources && desk.files() == before, "{arguments} changed something");
    }
}

/// What can never be written is said before any work is done, and nothing is made.
#[test]
fn what_cannot_be_written_is_refused_at_once() {
    let desk = Desk::new();
    fs::write(desk.path("file"), "mine").unwrap();
    let before = desk.files();
    for (arguments, words) in [
        ("synth camera --out x.mp4", &["x.mp4", "ending"][..]),
        ("synth camera --out x.exr", &["x.exr", "ending"]),
        ("synth camera --out x.tif", &["x.tif", "ending"]),
        ("synth camera --out x.npz", &["x.npz", "ending"]),
        ("synth camera --out file/deeper", &["file"]),
        ("synth camera --out file", &["file"]),
        ("synth camera --out made.npy --preview b.xyz", &["b.xyz", "output format"]),
        ("synth camera --out made.npy --preview file/b.mp4", &["file"]),
        ("demo --out x.npy", &["x.npy", "ending"]),
        ("demo --out file", &["file"]),
        ("scene fan --out x.mp4", &["x.mp4"]),
        ("sample truth.npy --out x.npy", &["x.npy", "ending"]),
        ("import camera --out x.npz", &["x.npz", "ending"]),
        ("bench --out file/deeper", &["file"]),
        ("bench --stability --out file", &["file"]),
        ("dataset --videos videos --out file", &["file"]),
        ("dataset --videos videos --out x.npy", &["x.npy", "ending"]),
    ] {
        let output = desk.run(&arguments.split(' ').collect::<Vec<_>>());
        assert_eq!(output.status.code(), Some(1), "{arguments}: {}", told(&output));
        let told = told(&output);
        assert!(words.iter().all(|word| told.contains(word)), "{arguments}: {told}");
        assert!(!told.contains(".pix2hdr-") && told.lines().count() == 1, "{arguments}: {told}");
        assert_eq!(desk.files(), before, "{arguments}");
        assert!(!Path::new(&desk.path("made")).exists(), "{arguments}");
    }
}

/// What was measured is told where it cannot be written any more, and what was written stays.
#[test]
fn a_benchmark_that_cannot_be_written_is_told() {
    let desk = Desk::new();
    // Two thousand bytes at most in a file: less than the record of one row.
    let arguments = "bench --out made --quick --executor cpu --weights tiny --size 16 --frames 9";
    let script = format!("trap '' XFSZ; ulimit -f 2; exec '{}' {arguments}", env!("CARGO_BIN_EXE_pix2hdr"));
    let output = Command::new("sh").args(["-c", &script]).current_dir(desk.0.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    assert!(
        told(&output).contains("bench.json") && !told(&output).contains(".pix2hdr-"),
        "{}",
        told(&output)
    );
    assert!(String::from_utf8_lossy(&output.stdout).contains("tiny"));
}

/// Completions and manual pages know every command and option.
#[test]
fn shells_and_man_know_every_option() {
    for shell in ["bash", "zsh", "fish"] {
        let text = succeeds(&["completions", shell]);
        assert!(text.contains("tile-origin") && text.contains("preview-rate"), "{shell}");
    }
    assert!(succeeds(&["man"]).contains("synth"));
    let page = succeeds(&["man", "synth"]);
    assert!(page.starts_with(".ie") || page.contains(".TH"), "{page}");
    assert!(page.contains("preview\\-rate") && page.contains("overwrite"));
    program::fails(&["man", "nonesuch"], &["nonesuch"], Path::new("/nonexistent"));
    let version = succeeds(&["--version"]);
    let (_, commit) = version.trim().split_once(" (").unwrap_or(("", ")"));
    assert!(version.starts_with("pix2hdr 0.") && commit.ends_with(')'), "{version}");
}

/// A report says how a result was made, beside an array too, and holds every warning.
#[test]
fn reports_say_how_a_result_was_made() {
    let desk = Desk::new();
    for (out, report) in [("made", "made/report.json"), ("made.npy", "made.report.json")] {
        let synth =
            ["synth", "camera", "--out", out, "--executor", "cpu", "--weights", "tiny", "--ensemble", "2"];
        // Counts of ten bits in a description of sixteen.
        let output =
            desk.run(&[&synth[..], &["--white-level", "65535", "--bit-depth", "16", "--json"]].concat());
        assert!(output.status.success(), "{}", told(&output));
        let printed: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let written: serde_json::Value =
            serde_json::from_slice(&fs::read(desk.path(report)).unwrap()).unwrap();
        assert_eq!(printed, written, "{out}");
        assert_eq!(written["settings"]["ensemble"], 2);
        assert_eq!(written["capture"]["description"]["white_level"], 65535.0);
        assert_eq!(written["weights_digest"].as_str().unwrap().len(), 16);
        assert!(written["version"].as_str().unwrap().starts_with(env!("CARGO_PKG_VERSION")));
        let warnings = written["warnings"].as_array().unwrap();
        let said: Vec<_> = told(&output)
            .lines()
            .filter_map(|line| line.strip_prefix("pix2hdr: warning: ").map(str::to_owned))
            .collect();
        assert!(!said.is_empty() && said == *warnings, "{said:?} against {warnings:?}");
    }
}

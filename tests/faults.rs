//! What goes wrong while the program runs: full disks, lost devices, vanished folders, killed processes. Each ends in a
//! clear error, what was done so far stays valid and marked as unfinished, and `--resume` completes it to the same bytes.
#![cfg(unix)]

#[path = "support/program.rs"]
mod program;

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use pix2hdr::Result;
use pix2hdr::frame::Frame;
use pix2hdr::gpu::{AdapterChoice, Gpu, GpuError};
use pix2hdr::network::{Model, Precision, presets};
use pix2hdr::sensor::{Capture, CaptureFile, Form, Noise, Pattern, Recording, Sampler, Source};
use pix2hdr::synth::{Backend, Settings, Synthesizer};
use pix2hdr::video::{self, Video};
use program::{pix2hdr, weights, within_limits};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Map;

const FRAMES: usize = 1200;

fn capture(frames: usize) -> Capture {
    let pixel = |i: usize| (i * 7919 / 13 % 1000) as f32 / 1000.0;
    let video = Video::new(frames, 16, 24, (0..frames * 384).map(pixel).collect()).unwrap();
    let pattern = Pattern::built_in("mpve-1-4").unwrap();
    Sampler::new(pattern, Form::Linear).unwrap().sample(&video).unwrap()
}

/// A folder with a capture in it.
struct Desk {
    folder: tempfile::TempDir,
    /// Settings of `synth`.
    options: Vec<String>,
}

impl Desk {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        capture(FRAMES).write(folder.path().join("capture")).unwrap();
        Self { folder, options: Vec::new() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn arguments(&self, out: &str, more: &[&str]) -> Vec<String> {
        let [capture, out] = ["capture", out].map(|name| self.path(name).display().to_string());
        let synth = ["synth", "--executor", "cpu", &capture, "--out", &out];
        let options = self.options.iter().map(String::as_str);
        synth.into_iter().chain(options).chain(more.iter().copied()).map(str::to_owned).collect()
    }

    fn run(&self, out: &str, more: &[&str]) -> Output {
        let arguments = self.arguments(out, more);
        pix2hdr(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn start(&self, out: &str, more: &[&str]) -> Child {
        Command::new(env!("CARGO_BIN_EXE_pix2hdr"))
            .args(self.arguments(out, more))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// Waits until `frames` pictures of the result folder `out` are there.
    fn wait_for(&self, out: &str, frames: usize, child: &mut Child) {
        let begun = Instant::now();
        let picture = self.path(out).join(format!("hdr.partial/frame-{frames:05}.exr"));
        while !picture.exists() {
            assert!(begun.elapsed() < Duration::from_mins(2), "no frame is written");
            assert!(child.try_wait().unwrap().is_none(), "it ended too soon");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Completes the result and compares it with one that was never interrupted.
    fn resumes(&self, out: &str) {
        let resumed = self.run(out, &["--resume"]);
        assert!(resumed.status.success(), "{}", text(&resumed));
        let whole = if is_array(out) { "whole.npy" } else { "whole" };
        if !self.path(whole).exists() {
            assert!(self.run(whole, &[]).status.success());
        }
        let files = |out: &str| -> Vec<(String, Vec<u8>)> {
            let path = self.path(out);
            if path.is_file() {
                return vec![(String::new(), fs::read(path).unwrap())];
            }
            let entries = fs::read_dir(path.join("hdr")).unwrap().flatten();
            let mut files: Vec<_> = entries
                .map(|e| (e.file_name().into_string().unwrap(), fs::read(e.path()).unwrap()))
                .collect();
            files.sort();
            files
        };
        assert!(files(out) == files(whole), "{out} is not what an uninterrupted run gives");
        let name = self.path(out).file_stem().unwrap().to_string_lossy().into_owned();
        for folder in [self.folder.path().to_owned(), self.path(&name)] {
            let left = fs::read_dir(folder).into_iter().flatten().flatten();
            let mut names = left.map(|entry| entry.file_name().into_string().unwrap());
            assert!(names.all(|left| !left.contains("partial")), "a partial result stays");
        }
    }
}

/// Whether a result is one file.
fn is_array(out: &str) -> bool {
    Path::new(out).extension().is_some_and(|extension| extension == "npy")
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A failure that is told: exit code 1 and one line of ours.
fn assert_told(output: &Output, words: &[&str]) {
    let text = text(output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    let line = text.lines().rev().find(|line| line.starts_with("pix2hdr:")).unwrap_or_default();
    assert!(words.iter().all(|word| line.contains(word)) && !text.contains("panicked"), "{text}");
}

/// A file may not grow beyond a limit, as on a disk that is full: what fits is a valid video, and is gone on with when
/// there is room.
#[test]
fn a_full_disk() {
    let desk = Desk::new();
    // Blocks of 512 or 1024 bytes, whichever the shell counts in; without a signal, writing fails as on a full disk.
    let limits = "trap '' XFSZ; ulimit -f 1000";
    let arguments = desk.arguments("result.npy", &[]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let full = within_limits(&arguments, limits);
    assert_told(&full, &["result"]);
    assert!(text(&full).contains("--resume"), "{}", text(&full));
    assert!(!desk.path("result.npy").exists());
    let partial = video::read(desk.path("result.partial.npy")).unwrap();
    assert!((300..FRAMES).contains(&partial.frames), "{} frames", partial.frames);
    desk.resumes("result.npy");
}

/// Pictures that do not fit any more: those before are kept, without a hole, and are gone on with when there is room.
/// Files that may not grow beyond a limit test it on every system; a file system that is full tests it too, wherever
/// one may be mounted.
#[test]
fn a_full_file_system() {
    pictures_beyond_a_limit();
    if let Some(output) = on_a_small_file_system() {
        let told = text(&output);
        assert_eq!(output.status.code(), Some(1), "{told}");
        let words = ["No space left", "--resume"];
        assert!(words.iter().all(|word| told.contains(word)) && !told.contains("panicked"), "{told}");
        // All pictures up to the last one are there, and the second run completed them.
        let lines = String::from_utf8(output.stdout).unwrap();
        let lines: Vec<&str> = lines.lines().map(str::trim).collect();
        let count: usize = lines[1].parse().unwrap();
        assert!((1..FRAMES).contains(&count), "{lines:?}: {told}");
        assert_eq!(lines[0], format!("frame-{:05}.exr", count - 1), "{told}");
        assert_eq!(*lines.last().unwrap(), FRAMES.to_string(), "{told}");
    }
}

/// A dark scene that becomes noise: its box estimates are pictures of nothing, which are small, and then large ones.
fn pictures_beyond_a_limit() {
    let mut desk = Desk::new();
    let (frames, dark, pixels) = (400, 200, 96 * 96);
    let pixel = |i: usize| if i < dark * pixels { 0.0 } else { (i * 7919 / 13 % 1000) as f32 / 1000.0 };
    let video = Video::new(frames, 96, 96, (0..frames * pixels).map(pixel).collect()).unwrap();
    let mut sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
    sampler.noise = Noise::NONE;
    sampler.sample(&video).unwrap().write(desk.path("capture")).unwrap();
    let graph = r#"{"version": 1, "name": "box", "pattern": "any", "window": {"frames": 8, "lead": 0, "hop": 8},
        "nodes": [{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}], "output": "estimate"}"#;
    fs::write(desk.path("box.safetensors"), weights(graph)).unwrap();
    desk.options = vec!["--weights".into(), desk.path("box.safetensors").display().to_string()];
    let arguments = desk.arguments("result", &[]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    // 12 or 24 kB, whichever the shell counts in; noise of 96×96 pixels takes more.
    let full = within_limits(&arguments, "trap '' XFSZ; ulimit -f 24");
    assert_told(&full, &["frame-"]);
    assert!(text(&full).contains("--resume"), "{}", text(&full));
    let partial = desk.path("result/hdr.partial");
    let count = fs::read_dir(&partial).unwrap().count();
    println!("{count} of {frames} pictures fit: {}", text(&full));
    assert!((1..frames).contains(&count), "{count} pictures");
    assert!((0..count).all(|t| partial.join(format!("frame-{t:05}.exr")).is_file()), "there is a hole");
    assert!(!desk.path("result/hdr").exists());
    desk.resumes("result");
}

/// A run into a file system of 400 kB, then, with room, a second one that completes it. `None` where the system lets
/// nobody mount one, not even in a name space of one's own.
fn on_a_small_file_system() -> Option<Output> {
    let desk = Desk::new();
    let arguments = desk.arguments("result", &[]).join("' '");
    let (program, out) = (env!("CARGO_BIN_EXE_pix2hdr"), desk.path("result").display().to_string());
    fs::create_dir(&out).unwrap();
    let script = format!(
        "mount -t tmpfs -o size=400k none '{out}' || exit 99; '{program}' '{arguments}'; code=$?; \
         ls '{out}/hdr.partial' | sort | tail -n 1; ls '{out}/hdr.partial' | wc -l; \
         mount -o remount,size=40m '{out}'; '{program}' '{arguments}' --resume >&2 && ls '{out}/hdr' | wc -l; exit $code"
    );
    match Command::new("unshare").args(["-rm", "sh", "-c", &script]).output() {
        Ok(output) if output.status.code() != Some(99) && !text(&output).contains("unshare") => Some(output),
        other => {
            println!("no file system may be mounted here: {other:?}");
            None
        }
    }
}

/// The folder that is written disappears: an error, and never a result with holes.
#[test]
fn the_output_folder_is_removed() {
    let desk = Desk::new();
    for whole in [false, true] {
        let mut child = desk.start("result", &[]);
        desk.wait_for("result", 3, &mut child);
        let gone = if whole { desk.path("result") } else { desk.path("result/hdr.partial") };
        // The program may be writing there at this moment.
        while gone.exists() {
            let _ = fs::remove_dir_all(&gone);
        }
        let output = child.wait_with_output().unwrap();
        assert_told(&output, &["hdr.partial"]);
        assert!(!desk.path("result/hdr").exists());
        assert!(desk.run("result", &["--overwrite"]).status.success());
        fs::remove_dir_all(desk.path("result")).unwrap();
    }
}

/// A picture disappears, as a cleaner of temporary files would do it: the result is not taken for complete.
#[test]
fn a_picture_is_removed() {
    let mut desk = Desk::new();
    // Many windows, so that the program is not done before the picture is gone.
    desk.options = ["--hop", "8"].map(str::to_owned).to_vec();
    let mut child = desk.start("result", &[]);
    // Pictures are written side by side, so a later one says nothing of an earlier one.
    for frame in [2, 5] {
        desk.wait_for("result", frame, &mut child);
    }
    fs::remove_file(desk.path("result/hdr.partial/frame-00002.exr")).unwrap();
    assert_told(&child.wait_with_output().unwrap(), &["frame 2 is gone"]);
    assert!(!desk.path("result/hdr").exists());
    desk.resumes("result");
}

/// Two processes cannot write one result: the second one says so, and the first one is not disturbed.
#[test]
fn two_processes_write_one_result() {
    let desk = Desk::new();
    let mut child = desk.start("result", &[]);
    desk.wait_for("result", 2, &mut child);
    for more in [&["--resume"][..], &["--overwrite"], &[]] {
        assert_told(&desk.run("result", more), &["another process"]);
    }
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", text(&output));
    assert_eq!(fs::read_dir(desk.path("result/hdr")).unwrap().count(), FRAMES);
    // And when it has ended, nothing is locked.
    assert!(desk.run("result", &["--overwrite"]).status.success());
}

/// Whether there is something to resume: the note beside a result is empty until it is.
fn begun_at(target: &Path) -> bool {
    let note = format!("{}.json", video::VideoWriter::partial(target).display());
    fs::metadata(note).is_ok_and(|note| note.len() > 0)
}

/// Whenever the program is ended, however rudely, its result is complete or can be completed.
#[test]
fn an_end_at_any_moment() {
    let desk = Desk::new();
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let begun = Instant::now();
    assert!(desk.run("whole", &[]).status.success());
    assert!(desk.run("whole.npy", &[]).status.success());
    let typical = begun.elapsed() / 2;
    for trial in 0..14 {
        let out = if trial % 2 == 0 { format!("out{trial}") } else { format!("out{trial}.npy") };
        let signal = ["-KILL", "-INT", "-TERM", "-KILL"][trial / 2 % 4];
        // Ended and taken up again, until it is complete.
        for round in 0.. {
            let mut child = desk.start(&out, if round == 0 { &[] } else { &["--resume"] });
            std::thread::sleep(typical.mul_f64(rng.random_range(0.0..1.2)));
            let alive = child.try_wait().unwrap().is_none();
            if alive {
                Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
            }
            let output = child.wait_with_output().unwrap();
            assert!(!text(&output).contains("panicked"), "{}", text(&output));
            let target = if is_array(&out) { desk.path(&out) } else { desk.path(&out).join("hdr") };
            if output.status.success() || round == 2 || target.exists() {
                break;
            }
            assert!(alive, "{signal}, round {round}: {}", text(&output));
            // Before anything was begun, there is nothing to resume.
            if !begun_at(&target) {
                break;
            }
        }
        let target = if is_array(&out) { desk.path(&out) } else { desk.path(&out).join("hdr") };
        if begun_at(&target) {
            desk.resumes(&out);
        } else if !target.exists() {
            let again = desk.run(&out, &[]);
            assert!(again.status.success(), "{signal}: {}", text(&again));
        }
    }
}

fn synthesizer(capture: &Capture, backend: &Backend) -> Synthesizer {
    let model = Model::random(presets::by_name("tiny").unwrap().graph().unwrap(), 5).unwrap();
    let extent = [capture.height, capture.width];
    Synthesizer::new(&model, capture.calibration(), extent, backend, &Settings::default()).unwrap()
}

/// All frames that are delivered from frame `from` on, in order, and how the run ended. `at` is called at each frame.
fn stream(
    synthesizer: &mut Synthesizer,
    source: &mut dyn Source,
    from: usize,
    at: impl Fn(usize) + Send + Sync,
) -> (Vec<Vec<f32>>, Result<()>) {
    let frames = Mutex::new(Vec::new());
    let outcome = synthesizer.stream(source, from, |frame| {
        at(frame.number);
        let mut frames = frames.lock().unwrap();
        assert_eq!(frame.number, from + frames.len(), "frames come in order");
        frames.push(frame.frame.values().to_vec());
        Ok(())
    });
    (frames.into_inner().unwrap(), outcome.map(drop))
}

/// The device is lost in mid-run: the error says so, the frames so far are right, and another device goes on.
#[test]
fn a_device_is_lost() {
    let choice = AdapterChoice { substring: None, allow_software: true };
    let open = || Gpu::open(&choice).unwrap();
    let capture = capture(400);
    let gpu = open();
    let backend = Backend::Gpu(gpu.clone(), Precision::F32);
    let (begun, outcome) = stream(&mut synthesizer(&capture, &backend), &mut *capture.frames(), 0, |frame| {
        if frame == 50 {
            gpu.destroy();
        }
    });
    assert!(matches!(outcome.as_ref().unwrap_err().cause(), Some(GpuError::Lost(_))), "{outcome:?}");
    assert!((51..400).contains(&begun.len()), "{} frames", begun.len());
    let mut fresh = synthesizer(&capture, &Backend::Gpu(open(), Precision::F32));
    let (rest, outcome) = stream(&mut fresh, &mut *capture.frames(), begun.len(), |_| {});
    outcome.unwrap();
    let (whole, outcome) = stream(&mut fresh, &mut *capture.frames(), 0, |_| {});
    outcome.unwrap();
    assert!([begun, rest].concat() == whole, "the frames differ");
}

/// The capture becomes shorter while it is read: the frames so far are right, and the file is named.
#[test]
fn the_input_is_truncated() {
    let folder = tempfile::tempdir().unwrap();
    let capture = capture(2000);
    capture.write(folder.path()).unwrap();
    let array = folder.path().join("capture.npy");
    let mut synthesizer = synthesizer(&capture, &Backend::Cpu);
    let (whole, _) = stream(&mut synthesizer, &mut *capture.frames(), 0, |_| {});
    let file = CaptureFile::open(folder.path(), &Map::new()).unwrap();
    let (begun, outcome) = stream(&mut synthesizer, &mut *file.into_frames(), 0, |frame| {
        if frame == 10 {
            File::options().write(true).open(&array).unwrap().set_len(1_000_000).unwrap();
        }
    });
    let error = outcome.unwrap_err().to_string();
    assert!(error.contains("capture.npy"), "{error}");
    // What was read ahead, up to 1 MiB, is still what was recorded.
    assert!((11..1400).contains(&begun.len()), "{} frames", begun.len());
    assert!(begun == whole[..begun.len()]);
}

/// A source with a fault in it.
struct Faulty<'a>(Box<dyn Source + 'a>, usize);

impl Source for Faulty<'_> {
    fn recording(&self) -> &Recording {
        self.0.recording()
    }

    fn frames(&self) -> Option<usize> {
        self.0.frames()
    }

    fn next(&mut self) -> Result<Option<Frame>> {
        self.1 -= 1;
        assert!(self.1 > 0, "on purpose");
        self.0.next()
    }
}

/// A panic on any of the threads is an error of the run, not its end: no frame is delivered that was computed as if the
/// recording had ended there, and the next run is a whole one.
#[test]
fn a_worker_panics() {
    let capture = capture(600);
    let mut synthesizer = synthesizer(&capture, &Backend::Cpu);
    let (whole, _) = stream(&mut synthesizer, &mut *capture.frames(), 0, |_| {});
    // The thread that reads.
    let (begun, outcome) = stream(&mut synthesizer, &mut Faulty(capture.frames(), 300), 0, |_| {});
    assert!(outcome.unwrap_err().to_string().contains("reads frames panicked"));
    assert!((100..300).contains(&begun.len()) && begun == whole[..begun.len()], "{} frames", begun.len());
    // The one that writes.
    let outcome = synthesizer.stream(&mut *capture.frames(), 0, |frame| {
        assert!(frame.number < 100, "on purpose");
        Ok(())
    });
    assert!(outcome.unwrap_err().to_string().contains("writes frames panicked"));
    let (again, outcome) = stream(&mut synthesizer, &mut *capture.frames(), 0, |_| {});
    outcome.unwrap();
    assert!(again == whole);
}

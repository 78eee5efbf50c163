//! The program as a user meets it: the whole chain, and one helpful line for whatever is wrong.

#[path = "support/program.rs"]
mod program;

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use pix2hdr::video::{self, Counts, Video, Writing, npy};
use program::{fails, pix2hdr, succeeds};

/// A folder with a small capture in it, and its path.
fn capture() -> (tempfile::TempDir, String) {
    capture_of(|i| (i % 97) as f32 / 97.0)
}

/// As [`capture`], of a video whose value `i` is `pixel(i)`.
fn capture_of(pixel: impl Fn(usize) -> f32) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let video = Video::new(9, 18, 22, (0..9 * 18 * 22).map(pixel).collect()).unwrap();
    video::write(folder.path().join("truth.npy"), &video, Writing::default()).unwrap();
    let truth = folder.path().join("truth.npy").display().to_string();
    let out = folder.path().join("capture").display().to_string();
    succeeds(&["sample", &truth, "--out", &out]);
    let array = folder.path().join("capture/capture.npy").display().to_string();
    (folder, array)
}

#[test]
fn the_whole_chain_runs_on_the_cpu() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (truth, camera, result) = (path("truth"), path("camera"), path("result"));
    let size = ["--frames", "12", "--size", "44x30", "--samples", "2"];
    succeeds(&[&["scene", "fan", "--out", &truth][..], &size[..]].concat());
    succeeds(&["sample", &truth, "--out", &camera, "--seed", "3"]);
    let json =
        succeeds(&["synth", &camera, "--out", &result, "--executor", "cpu", "--truth", &truth, "--json"]);
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(report["frames"], 12);
    assert_eq!(report["executor"], "cpu");
    assert!(report["measures"]["psnr_mu"].as_f64().unwrap() > 10.0);
    let video = video::read(folder.path().join("result/hdr")).unwrap();
    assert_eq!([video.frames, video.height, video.width], [12, 30, 44]);
    let measures: serde_json::Value =
        serde_json::from_str(&succeeds(&["eval", &truth, &path("result/hdr"), "--json"])).unwrap();
    let difference = measures["psnr_mu"].as_f64().unwrap() - report["measures"]["psnr_mu"].as_f64().unwrap();
    assert!(difference.abs() < 0.01, "{measures} against {report}");
    for name in ["contact-sheet.png", "report.json"] {
        assert!(folder.path().join("result").join(name).is_file(), "{name}");
    }
}

/// A camera by name, of which single options replace what it says; the capture says all of it.
#[test]
fn cameras_to_simulate_have_names_and_options() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let truth = path("truth.npy");
    video::write(&truth, &Video::black(9, 8, 8), Writing::default()).unwrap();
    let described = |options: &[&str]| -> serde_json::Value {
        let out = path("capture");
        succeeds(&[&["sample", &truth, "--out", &out, "--overwrite"], options].concat());
        serde_json::from_str(&fs::read_to_string(Path::new(&out).join("capture.json")).unwrap()).unwrap()
    };
    let fields = |capture: &serde_json::Value| {
        ["full_well_e", "read_noise_e", "black_level", "white_level", "frame_period_ms"]
            .map(|key| capture[key].as_f64().unwrap_or(f64::NAN))
    };
    assert_eq!(fields(&described(&[])), [9000.0, 2.67, 0.0, 1023.0, 1.0]);
    assert_eq!(fields(&described(&["--camera", "pe-cmos"])), [200.0, 2.67, 48.0, 1023.0, 1.0]);
    let options = [
        "--camera",
        "pe-cmos",
        "--black-level",
        "64",
        "--full-well",
        "300",
        "--bit-depth",
        "12",
        "--frame-period-ms",
        "0.5",
    ];
    assert_eq!(fields(&described(&options)), [300.0, 2.67, 64.0, 4095.0, 0.5]);
    let mine = path("mine.json");
    fs::write(&mine, r#"{"read_noise_e": 1.5, "response": {"gamma": 2.2}}"#).unwrap();
    let capture = described(&["--camera", &mine]);
    assert_eq!(fields(&capture), [9000.0, 1.5, 0.0, 1023.0, 1.0]);
    assert_eq!(capture["response"]["gamma"], 2.2);
    assert!(described(&["--full-well", "0"]).get("full_well_e").is_none());
    // What cannot be is said in a line.
    for (options, words) in [
        (["--camera", "pe"], "pe-cmos"),
        (["--black-level", "1023"], "black level 1023"),
        (["--frame-period-ms", "0"], "frame period"),
        (["--schedule-start", "9223372036854775807"], "schedule start"),
    ] {
        let out = path("other");
        fails(&[&["sample", &truth, "--out", &out], &options[..]].concat(), &[words], Path::new(&out));
    }
}

#[test]
fn the_demo_writes_all_that_it_promises() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("demo").display().to_string();
    let size = ["--frames", "10", "--size", "40x32", "--samples", "2"];
    let demo = |more: &[&str]| -> serde_json::Value {
        let json = succeeds(
            &[&["demo", "--out", &out, "--executor", "cpu", "--json"][..], &size[..], more].concat(),
        );
        serde_json::from_str(&json).unwrap()
    };
    // Held read-outs come later, and the box filter is not to be measured by that. The last ones are missing.
    let report = demo(&[]);
    let [covering, held] = [&report, &demo(&["--timing", "hold", "--overwrite"])]
        .map(|report| report["measures"]["box"]["psnr_mu"].as_f64().unwrap());
    assert!((held - covering).abs() < 1.0, "{held} dB instead of {covering}");
    for file in report["files"].as_array().unwrap() {
        assert!(Path::new(file.as_str().unwrap()).exists(), "{file}");
    }
}

/// A recording cannot be made again, so nothing is written over it, nor over anything else that was not named for that.
#[test]
fn single_files_are_kept_too() {
    let (folder, array) = capture();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let before = fs::read(&array).unwrap();
    let (camera, truth, result) = (path("capture"), path("truth.npy"), path("result.npy"));
    let kept = |arguments: &[&str]| {
        let output = pix2hdr(arguments);
        assert!(!output.status.success(), "{arguments:?}");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(message.contains("already there") || message.contains("source itself"), "{message}");
        assert!(fs::read(&array).unwrap() == before, "{arguments:?} replaced the recording");
    };
    kept(&["import", &array, "--out", &camera]);
    kept(&["sample", &truth, "--out", &camera, "--seed", "9"]);
    kept(&["scene", "fan", "--out", &truth, "--frames", "2"]);
    kept(&["synth", &array, "--out", &array, "--executor", "cpu"]);
    kept(&["synth", &array, "--out", &array, "--executor", "cpu", "--overwrite"]);
    succeeds(&["synth", &array, "--out", &result, "--executor", "cpu"]);
    kept(&["synth", &array, "--out", &result, "--executor", "cpu"]);
    succeeds(&["synth", &array, "--out", &result, "--executor", "cpu", "--overwrite"]);
    succeeds(&["sample", &truth, "--out", &camera, "--seed", "9", "--overwrite"]);
    assert!(fs::read(&array).unwrap() != before);
}

/// By whatever name, a recording is never what is written, not even where files may be replaced.
#[cfg(unix)]
#[test]
fn a_source_is_never_its_own_target() {
    let (folder, array) = capture();
    let path = |name: &str| folder.path().join(name);
    let show = |name: &str| path(name).display().to_string();
    let before = fs::read(&array).unwrap();
    std::os::unix::fs::symlink(path("capture"), path("linked-folder")).unwrap();
    fs::create_dir_all(path("linked-file")).unwrap();
    std::os::unix::fs::symlink(&array, path("linked-file/capture.npy")).unwrap();
    fs::create_dir_all(path("hard")).unwrap();
    fs::hard_link(&array, path("hard/capture.npy")).unwrap();
    fs::create_dir_all(path("described")).unwrap();
    fs::hard_link(path("capture/capture.json"), path("described/capture.json")).unwrap();
    let folders = ["capture", "capture/../capture", "linked-folder", "linked-file", "hard", "described"];
    for out in folders {
        fails(&["import", &array, "--out", &show(out), "--overwrite"], &["the source itself"], &path("none"));
        assert!(fs::read(&array).unwrap() == before, "{out}");
        assert!(fs::symlink_metadata(path("linked-file/capture.npy")).unwrap().is_symlink(), "{out}");
    }
    fails(
        &["import", &show("linked-folder"), "--out", &show("hard"), "--overwrite"],
        &["itself"],
        &path("none"),
    );
    for out in ["linked-folder/capture.npy", "linked-file/capture.npy", "hard/capture.npy"] {
        let synth = ["synth", &array, "--out", &show(out), "--executor", "cpu", "--overwrite"];
        fails(&synth, &["the source itself"], &path("none"));
        assert!(fs::read(&array).unwrap() == before, "{out}");
    }
    // Another folder is not the recording's, even if it holds one.
    succeeds(&["import", &array, "--out", &show("other")]);
    succeeds(&["import", &array, "--out", &show("other"), "--overwrite"]);
    assert!(fs::read(path("other/capture.npy")).unwrap() == before);
}

/// Importing takes some frames of memory, however many there are, and none is lost on the way.
#[cfg(unix)]
#[test]
fn importing_takes_memory_for_some_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (frames, side) = (3000, 256);
    // Nothing but a header is on the disk; what a file lacks is read as zeros.
    npy::write_counts(path("raw.npy"), &[1, side, side], &Counts::U8(vec![0; side * side])).unwrap();
    let mut bytes = fs::read(path("raw.npy")).unwrap();
    bytes.truncate(bytes.len() - side * side);
    let header = String::from_utf8_lossy(&bytes[10..])
        .replace("(1, 256, 256), }   ", &format!("({frames}, 256, 256), }}"));
    let bytes = [&bytes[..10], header.as_bytes()].concat();
    fs::write(path("raw.npy"), &bytes).unwrap();
    let file = fs::File::options().write(true).open(path("raw.npy")).unwrap();
    file.set_len((bytes.len() + frames * side * side) as u64).unwrap();
    for timing in ["covering", "hold"] {
        let (raw, out) = (path("raw.npy"), path(timing));
        let import = ["import", &raw, "--out", &out, "--pattern", "mpve-1-4", "--timing", timing];
        // A quarter of what the recording takes.
        let output = program::within_limits(&import, "ulimit -v 150000");
        assert!(output.status.success(), "{timing}: {}", String::from_utf8_lossy(&output.stderr));
        let written = folder.path().join(timing).join("capture.npy");
        assert_eq!(fs::metadata(&written).unwrap().len(), (128 + frames * side * side) as u64);
        fs::remove_file(written).unwrap();
    }
}

/// What cannot work is said before a result begins, or the next run would find an interrupted one.
#[test]
fn a_start_that_fails_leaves_nothing_to_go_on_with() {
    let (folder, array) = capture();
    let out = folder.path().join("result").display().to_string();
    // Without ffmpeg.
    let preview = folder.path().join("preview.mp4").display().to_string();
    let output = Command::new(env!("CARGO_BIN_EXE_pix2hdr"))
        .args(["synth", &array, "--out", &out, "--executor", "cpu", "--preview", &preview])
        .env("PATH", "")
        .output()
        .unwrap();
    assert!(!output.status.success());
    succeeds(&["synth", &array, "--out", &out, "--executor", "cpu"]);
}

#[test]
fn software_vulkan_and_cpu_give_the_same_video() {
    let (folder, array) = capture();
    let run = |executor: &str| {
        let out = folder.path().join(format!("{executor}.npy"));
        succeeds(&["synth", &array, "--executor", executor, "--out", &out.display().to_string()]);
        video::read(&out).unwrap()
    };
    let (cpu, gpu) = (run("cpu"), run("gpu"));
    let worst = cpu.data.iter().zip(&gpu.data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 1e-4, "they differ by {worst}");
}

/// Hot pixels and missing read-outs that are named, by options or in the capture, disturb little; others do.
#[test]
fn dead_pixels_and_missing_readouts_are_filled() {
    // A slope from left to right.
    let (folder, array) = capture_of(|i| 0.05 + 0.02 * (i % 22) as f32);
    let path = |name: &str| folder.path().join(name).display().to_string();
    let synth = |capture: &str, name: &str, more: &[&str]| {
        let out = path(name);
        succeeds(&[&["synth", capture, "--out", &out, "--executor", "cpu"], more].concat());
        video::read(&out).unwrap()
    };
    let sound = synth(&array, "sound.npy", &[]);
    let (extents, counts) = npy::read_counts(&array).unwrap();
    let Counts::U16(mut counts) = counts else { panic!("the simulator writes 16 bits") };
    let len = 18 * 22;
    for (i, count) in counts.iter_mut().enumerate() {
        if [9 * 22 + 10, 9 * 22 + 14, 17 * 22 + 21].contains(&(i % len)) {
            *count = 1023;
        } else if i % 83 == 0 {
            *count = 65535;
        }
    }
    npy::write_counts(&array, &extents, &Counts::U16(counts)).unwrap();
    fs::write(folder.path().join("dead.csv"), "row,column\n9,10\n9,14\n17,21\n").unwrap();
    let named = ["--dead-pixels", &path("dead.csv"), "--missing-count", "65535"];
    let distance = |other: &Video| -> f32 {
        sound.data.iter().zip(&other.data).map(|(a, b)| (a - b).abs()).sum::<f32>() / sound.data.len() as f32
    };
    let (unknown, filled) = (synth(&array, "unknown.npy", &[]), synth(&array, "filled.npy", &named));
    let (unknown, filled_distance) = (distance(&unknown), distance(&filled));
    assert!(filled_distance > 0.0 && filled_distance < 0.5 * unknown, "{filled_distance} against {unknown}");
    // An imported capture says it itself.
    succeeds(&[&["import", &array, "--out", &path("imported")][..], &named].concat());
    assert_eq!(synth(&path("imported"), "imported.npy", &[]), filled);
}

#[test]
fn broken_captures_are_refused() {
    let (folder, array) = capture();
    let target = folder.path().join("out");
    let out = target.display().to_string();
    let whole = fs::read(&array).unwrap();
    let json_path = folder.path().join("capture/capture.json");
    let json = fs::read_to_string(&json_path).unwrap();
    let synth = ["synth", &array, "--out", &out, "--executor", "cpu"];
    for length in [0, 5, 40, whole.len() - 1] {
        fs::write(&array, &whole[..length]).unwrap();
        fails(&synth, &["capture.npy"], &target);
    }
    npy::write_halves(&array, &[2, 3], &[half::f16::ONE; 6]).unwrap();
    fails(&synth, &["capture.npy", "[2, 3]"], &target);
    fs::write(&array, &whole).unwrap();
    for (from, to, word) in [
        ("mpve-1-4", "mpve-9", "mpve-9"),
        ("\"linear\"", "\"../../etc/passwd.csv\"", "response"),
        ("\"bit_depth\": 10", "\"bit_depth\": 99", "bit depth"),
        ("\"white_level\": 1023.0", "\"white_level\": -1.0", "white level"),
        ("{", "", "capture"),
    ] {
        assert!(json.contains(from), "{from} is not in {json}");
        fs::write(&json_path, json.replacen(from, to, 1)).unwrap();
        fails(&synth, &["capture", word], &target);
    }
    fs::remove_file(&json_path).unwrap();
    fails(&synth, &["capture.json", "--pattern"], &target);
    succeeds(&[
        "synth",
        &array,
        "--out",
        &out,
        "--executor",
        "cpu",
        "--pattern",
        "mpve-1-4",
        "--bit-depth",
        "10",
    ]);
}

#[test]
fn weights_for_another_pattern_are_refused_and_fast_fits_itself() {
    let (folder, _) = capture();
    let truth = folder.path().join("truth.npy").display().to_string();
    let other = folder.path().join("other").display().to_string();
    succeeds(&["sample", &truth, "--out", &other, "--pattern", "mpve-1-8"]);
    let target = folder.path().join("out");
    let out = target.display().to_string();
    let tiny = ["synth", &other, "--out", &out, "--executor", "cpu", "--weights", "tiny"];
    fails(&tiny, &["mpve-1-4", "mpve-1-8"], &target);
    let report = succeeds(&["synth", &other, "--out", &out, "--executor", "cpu", "--json"]);
    assert!(report.contains("\"fast-1-8\""), "{report}");
}

#[test]
fn broken_weights_are_refused() {
    let (folder, array) = capture();
    let target = folder.path().join("out");
    let out = target.display().to_string();
    let weights = folder.path().join("w.safetensors");
    let name = weights.display().to_string();
    let whole = fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/weights/fast.safetensors")).unwrap();
    let synth = ["synth", &array, "--out", &out, "--executor", "cpu", "--weights", &name];
    for length in [0, 4, 100, whole.len() / 2, whole.len() - 1] {
        fs::write(&weights, &whole[..length]).unwrap();
        fails(&synth, &["w.safetensors"], &target);
    }
    let mut not_finite = whole.clone();
    let end = not_finite.len();
    not_finite[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&weights, &not_finite).unwrap();
    fails(&synth, &["w.safetensors", "tensor", "NaN"], &target);
    fails(&["synth", &array, "--out", &out, "--weights", "nonesuch"], &["nonesuch", "fast"], &target);
    fails(&["synth", &array, "--out", &out, "--weights", "paper"], &["paper", "no trained weights"], &target);
}

#[test]
fn broken_videos_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (target, video_path) = (folder.path().join("out"), path("v.npy"));
    let out = target.display().to_string();
    fs::create_dir(folder.path().join("empty")).unwrap();
    fails(&["sample", &path("empty"), "--out", &out], &["empty"], &target);
    fails(&["sample", &path("missing.npy"), "--out", &out], &["missing.npy"], &target);
    let video = Video::new(1, 4, 4, vec![0.5; 16]).unwrap();
    video::write(&video_path, &video, Writing { half: false, ..Writing::default() }).unwrap();
    let mut bytes = fs::read(&video_path).unwrap();
    for value in [f32::NAN, f32::INFINITY] {
        let end = bytes.len();
        bytes[end - 4..].copy_from_slice(&value.to_le_bytes());
        fs::write(&video_path, &bytes).unwrap();
        fails(&["sample", &video_path, "--out", &out], &["v.npy", "row 3, column 3"], &target);
    }
    fs::write(folder.path().join("frame-0.exr"), b"v/1\x01nonsense").unwrap();
    fails(&["sample", &path("frame-0.exr"), "--out", &out], &["frame-0.exr"], &target);
}

#[test]
fn results_are_not_written_over_what_is_there() {
    let (folder, array) = capture();
    // A file stands where the folder should be.
    let blocked = folder.path().join("blocked");
    fs::write(&blocked, "mine").unwrap();
    let out = blocked.join("deeper").display().to_string();
    fails(&["synth", &array, "--out", &out, "--executor", "cpu"], &["blocked"], Path::new("/nonexistent"));
    assert_eq!(fs::read_to_string(&blocked).unwrap(), "mine");
    // A folder with something in it.
    let target = folder.path().join("full");
    fs::create_dir_all(target.join("hdr")).unwrap();
    fs::write(target.join("hdr/notes.txt"), "mine").unwrap();
    let out = target.display().to_string();
    let output = pix2hdr(&["synth", &array, "--out", &out, "--executor", "cpu", "--overwrite"]);
    assert!(!output.status.success());
    assert_eq!(fs::read_to_string(target.join("hdr/notes.txt")).unwrap(), "mine");
    assert_eq!(fs::read_dir(target.join("hdr")).unwrap().count(), 1);
}

/// Ctrl-C leaves the frames that are done; `--resume` completes them to the same bytes, and only as they were begun.
#[cfg(unix)]
#[test]
fn an_interrupted_run_is_taken_up_again() {
    use std::process::Stdio;
    use std::time::{Duration, Instant};

    let (folder, _) = capture();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let frames = 2400;
    let counts = (0..frames * 16 * 24).map(|i| (i * 7919 / 13 % 1000) as u16).collect();
    fs::create_dir(folder.path().join("long")).unwrap();
    npy::write_counts(folder.path().join("long/capture.npy"), &[frames, 16, 24], &Counts::U16(counts))
        .unwrap();
    fs::copy(folder.path().join("capture/capture.json"), folder.path().join("long/capture.json")).unwrap();
    let synth =
        |out: &str| ["synth", "--executor", "cpu", &path("long"), "--out", out].map(str::to_owned).to_vec();
    let run = |out: &str, more: &[&str]| {
        let arguments = synth(out);
        pix2hdr(&[&arguments.iter().map(String::as_str).collect::<Vec<_>>()[..], more].concat())
    };
    let out = path("result.npy");
    let partial = folder.path().join("result.partial.npy");
    let mut child = Command::new(env!("CARGO_BIN_EXE_pix2hdr"))
        .args(synth(&out))
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    // The file's buffer is written when it is full.
    let begun = Instant::now();
    while fs::metadata(&partial).map_or(0, |meta| meta.len()) < 100_000 {
        assert!(begun.elapsed() < Duration::from_mins(2), "no frame is written");
        assert!(child.try_wait().unwrap().is_none(), "it ended before it could be interrupted");
        std::thread::sleep(Duration::from_millis(5));
    }
    Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let done = video::read(&partial).unwrap().frames;
    assert!((1..frames).contains(&done), "{done} frames");
    assert!(!Path::new(&out).exists());

    let error = |output: Output| String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(error(run(&out, &[])).contains("--resume"));
    assert!(error(run(&out, &["--resume", "--half"])).contains("half"));
    assert!(error(run(&path("other.npy"), &["--resume"])).contains("other.partial.npy"));
    let resumed = run(&out, &["--resume", "--json"]);
    assert!(resumed.status.success(), "{}", error(resumed));
    let report: serde_json::Value = serde_json::from_slice(&resumed.stdout).unwrap();
    assert_eq!(report["frames"], frames - done);
    let whole = path("whole.npy");
    assert!(run(&whole, &[]).status.success());
    assert!(fs::read(&out).unwrap() == fs::read(&whole).unwrap(), "the results differ");
    let left = fs::read_dir(folder.path()).unwrap().flatten();
    assert!(left.into_iter().all(|entry| !entry.file_name().to_string_lossy().contains("partial")));
}

/// A copy of the program in a folder where nothing else is, as after an installation.
#[cfg(unix)]
fn alone() -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("pix2hdr");
    fs::copy(env!("CARGO_BIN_EXE_pix2hdr"), &program).unwrap();
    (folder, program)
}

/// The viewer is a program of its own, beside this one or on PATH; it gets all arguments, and its exit code is passed on.
#[test]
#[cfg(unix)]
fn view_starts_the_viewer() {
    use std::os::unix::fs::PermissionsExt;

    let (folder, program) = alone();
    let elsewhere = tempfile::tempdir().unwrap();
    for place in [elsewhere.path(), folder.path()] {
        let viewer = place.join("pix2hdr-viewer");
        fs::write(&viewer, format!("#!/bin/sh\necho {} \"$@\"\nexit 7\n", place.display())).unwrap();
        fs::set_permissions(&viewer, fs::Permissions::from_mode(0o755)).unwrap();
        let started = |arguments: &[&str]| {
            let output =
                Command::new(&program).args(arguments).env("PATH", elsewhere.path()).output().unwrap();
            assert_eq!(
                output.status.code(),
                Some(7),
                "{arguments:?}: {}",
                String::from_utf8_lossy(&output.stderr)
            );
            let said = String::from_utf8(output.stdout).unwrap();
            said.strip_prefix(&format!("{}", place.display())).unwrap().trim().to_owned()
        };
        assert_eq!(started(&["view"]), "");
        assert_eq!(started(&["view", "--help"]), "--help");
        assert_eq!(started(&["view", "-h"]), "-h");
        assert_eq!(started(&["view", "--rate", "30", "fan", "-v", "--", "-x"]), "--rate 30 fan -v -- -x");
        assert_eq!(started(&["-v", "view", "leds"]), "-v leds");
    }
}

#[test]
#[cfg(unix)]
fn without_the_viewer_a_line_says_how_to_get_it() {
    let (folder, program) = alone();
    for arguments in [&["view"][..], &["view", "--help"]] {
        let output = Command::new(&program).args(arguments).env("PATH", folder.path()).output().unwrap();
        let cure = "cargo build --release -p pix2hdr-viewer";
        program::failed(&output, "view", &["pix2hdr-viewer", "PATH", cure], &folder.path().join("out"));
    }
}

/// A recording that contradicts its description says so, with the option that cures it, before the work and without being
/// asked; cured, nothing is said.
#[test]
fn a_recording_is_held_against_its_description() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (truth, sound) = (path("truth.npy"), path("sound"));
    succeeds(&["scene", "fan", "--frames", "72", "--size", "64x64", "--samples", "2", "--out", &truth]);
    succeeds(&["sample", &truth, "--out", &sound, "--schedule-start", "5"]);
    let array = fs::read(Path::new(&sound).join("capture.npy")).unwrap();
    let description = fs::read_to_string(Path::new(&sound).join("capture.json")).unwrap();
    let synth = |name: &str, options: &[&str]| {
        let (capture, out) = (path(name), path("result.npy"));
        let fixed =
            ["synth", &capture, "--out", &out, "--overwrite", "--executor", "cpu", "--weights", "tiny"];
        let output = pix2hdr(&[&fixed[..], options].concat());
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    let write = |name: &str, counts: &Counts| {
        fs::create_dir(path(name)).unwrap();
        npy::write_counts(Path::new(&path(name)).join("capture.npy"), &[72, 64, 64], counts).unwrap();
        fs::write(Path::new(&path(name)).join("capture.json"), &description).unwrap();
    };
    let header = array.len() - 2 * 72 * 64 * 64;
    let counts = array[header..].chunks(2).map(|count| u16::from_le_bytes([count[0], count[1]]));
    assert_eq!(synth("sound", &[]), "");
    write("left", &Counts::U16(counts.clone().map(|count| count << 6).collect()));
    let said = synth("left", &[]);
    assert!(said.lines().count() == 1 && said.contains("--bit-depth 16 --white-level 65472"), "{said}");
    assert_eq!(synth("left", &["--bit-depth", "16", "--white-level", "65472"]), "");
    write("bytes", &Counts::U8(counts.clone().map(|count| (count >> 2) as u8).collect()));
    let said = synth("bytes", &[]);
    assert!(said.lines().count() == 1 && said.contains("--bit-depth 8 --white-level 255"), "{said}");
    assert_eq!(synth("bytes", &["--bit-depth", "8", "--white-level", "255"]), "");
    let said = synth("sound", &["--schedule-start", "0", "--timing", "hold"]);
    assert!(said.contains("--schedule-start 5\n") && said.contains("--timing covering\n"), "{said}");
    // What it shows is written, whatever is said.
    let wrong = ["--schedule-start", "2", "--tile-origin", "0,3", "--timing", "hold", "--detect", "--json"];
    let found = succeeds(&[&["import", &sound, "--out", &path("found")][..], &wrong].concat());
    let found: serde_json::Value = serde_json::from_str(&found).unwrap();
    assert_eq!(found["detected"]["schedule"]["as_described"], false, "{found}");
    assert_eq!(synth("found", &[]), "");
    assert_eq!(fs::read(Path::new(&path("found")).join("capture.npy")).unwrap(), array);
}

//! Files that were made to break the program: it ends with one helpful line, soon, within little memory, and writes
//! nothing. Whatever fuzzing finds (`cargo xtask fuzz`) becomes a file here.

#![cfg(unix)]

#[path = "support/program.rs"]
mod program;

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use pix2hdr::sensor::{Form, Pattern, Sampler};
use pix2hdr::video::{self, Video, Writing};
use program::{failed, weights, within_limits};

/// Kibibytes of address space that the program may use. The largest picture that a header may claim takes 1.25 GiB of
/// it, of which only what is really there becomes memory.
const MOST_MEMORY: usize = 3 << 20;

/// A folder with sound files in it, one of which is replaced at a time.
struct Desk {
    folder: tempfile::TempDir,
}

impl Desk {
    fn new() -> Self {
        let desk = Self { folder: tempfile::tempdir().unwrap() };
        let video = Video::new(9, 6, 8, (0..432).map(|i| (i % 97) as f32 / 97.0).collect()).unwrap();
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let capture = Sampler::new(pattern, Form::Linear).unwrap().sample(&video).unwrap();
        capture.write(desk.path("capture")).unwrap();
        video::write(desk.path("truth.npy"), &video, Writing::default()).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn name(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// Runs the program on a file, which it must refuse with a line that names the file and holds `word`.
    fn refuses(&self, what: &str, arguments: &[&str], words: &[&str]) {
        let out = self.path("out");
        let name = out.display().to_string();
        let arguments = [arguments, &["--out", &name]].concat();
        let output = within_limits(&arguments, &format!("ulimit -v {MOST_MEMORY}"));
        failed(&output, what, words, &out);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(error.len() < 4000, "{what}: {} bytes of words", error.len());
    }

    /// Refuses `content` as the file `name`, which `synth` or `sample` reads, and which the line names.
    fn refuses_file(&self, name: &str, content: &[u8], words: &[&str]) {
        let file = Path::new(name).file_name().unwrap().to_string_lossy().into_owned();
        self.refuses_content(name, content, &[&[&file[..]][..], words].concat());
    }

    /// As [`Desk::refuses_file`], without the name.
    fn refuses_content(&self, name: &str, content: &[u8], words: &[&str]) {
        let what = format!("{name}: {}", String::from_utf8_lossy(&content[..content.len().min(300)]));
        let before = fs::read(self.path(name)).ok();
        fs::write(self.path(name), content).unwrap();
        let (capture, file) = (self.name("capture"), self.name(name));
        let synth = ["synth", &capture, "--executor", "cpu"];
        match Path::new(name).extension().and_then(|extension| extension.to_str()) {
            Some("safetensors") => self.refuses(&what, &[&synth[..], &["--weights", &file]].concat(), words),
            _ if name.starts_with("pattern") => {
                self.refuses(&what, &[&synth[..], &["--pattern", &file]].concat(), words);
            }
            Some("csv") => self.refuses(&what, &[&synth[..], &["--response", &file]].concat(), words),
            _ if name.starts_with("dead") => {
                self.refuses(&what, &[&synth[..], &["--dead-pixels", &file]].concat(), words);
            }
            _ if name.starts_with("capture") => self.refuses(&what, &synth, words),
            _ => self.refuses(&what, &["sample", &file], words),
        }
        match before {
            Some(before) => fs::write(self.path(name), before).unwrap(),
            None => fs::remove_file(self.path(name)).unwrap(),
        }
    }
}

/// An NPY file of a header and what follows.
fn npy(header: &str, data: &[u8]) -> Vec<u8> {
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((header.len() as u16 + 1).to_le_bytes());
    [&file, header.as_bytes(), b"\n", data].concat()
}

fn shape(descr: &str, shape: &str) -> String {
    format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}")
}

#[test]
fn arrays() {
    let desk = Desk::new();
    let video =
        |header: &str, data: &[u8], word: &str| desk.refuses_file("v.npy", &npy(header, data), &[word]);
    video(&shape("<f4", "(9223372036854775808, 9223372036854775808)"), &[], "promises");
    video(&shape("<f4", "(4294967296, 4294967296, 4)"), &[], "promises");
    video(&shape("<f4", "(4611686018427387904, 1, 1)"), &[0; 64], "promises");
    video(&shape("<f4", "(99999999999999999999999, 1, 1)"), &[0; 64], "size");
    video(&shape("<f4", "(-1, 1, 1)"), &[0; 64], "size");
    video(&shape("<f4", "(0, 4, 4)"), &[], "empty");
    video(&shape("<f4", "(1, 0, 4)"), &[], "empty");
    video(&shape("<f4", &format!("({})", "1, ".repeat(100))), &[0; 4], "axes");
    video(&shape("<f4", "(1, 1, 1)"), &[0; 8], "behind them 4 bytes");
    video(&shape("|O", "(1, 1, 1)"), b"cos\nsystem\n(S'true'\ntR.", "|O");
    video(&shape(">f4", "(1, 1, 1)"), &[0; 4], "big-endian");
    video(&shape("<f8", "(1, 1, 1)"), &1e300f64.to_le_bytes(), "inf");
    video(&shape("<f4", "(1, 1, 1)"), &(-1f32).to_le_bytes(), "-1");
    video("{'descr': ('<f4', ('<f4',)), }", &[0; 4], "unreadable");
    video(&"{".repeat(60_000), &[], "");
    desk.refuses_file("v.npy", b"\x93NUMPY", &["NumPy"]);
    desk.refuses_file("v.npy", b"\x93NUMPY\x02\x00\xff\xff\xff\xff{", &[""]);
    desk.refuses_file("v.npy", b"\x93NUMPY\x01\x00\x04\x00\xff\xfe\xfd\n", &[""]);

    let capture = |header: &str, data: &[u8], word: &str| {
        desk.refuses_file("capture/capture.npy", &npy(header, data), &[word]);
    };
    capture(&shape("|u1", "(0, 1099511627776, 1099511627776)"), &[], "");
    let small = npy(&shape("|u1", "(1, 1, 8)"), &[0; 8]);
    desk.refuses_content("capture/capture.npy", &small, &["capture.json", "fewer than"]);
    capture(&shape("<f4", "(1, 2, 4)"), &[0; 32], "floating-point");
    capture(&shape("|u1", "(2, 4)"), &[0; 8], "[2, 4]");
    // A frame of 2³⁰ pixels, all of them there, in a file with a hole.
    let array = desk.path("capture/capture.npy");
    let header = npy(&shape("|u1", "(1, 32768, 32768)"), &[]);
    fs::write(&array, &header).unwrap();
    File::options().write(true).open(&array).unwrap().set_len(header.len() as u64 + (1 << 30)).unwrap();
    let synth = ["synth", &desk.name("capture"), "--executor", "cpu"];
    desk.refuses("a frame of 2³⁰ pixels", &synth, &["capture.npy", "32768×32768"]);
}

#[test]
fn descriptions_of_captures() {
    let desk = Desk::new();
    let sound = fs::read_to_string(desk.path("capture/capture.json")).unwrap();
    let with = |key: &str, value: &str| {
        let mut json: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&sound).unwrap();
        json.insert(key.into(), serde_json::Value::Null);
        let text = serde_json::to_string(&json).unwrap();
        text.replacen(&format!("\"{key}\":null"), &format!("\"{key}\":{value}"), 1)
    };
    for (key, value, word) in [
        // Nothing outside of the capture's folder is read.
        ("response", "\"../response.csv\"", "neither"),
        ("response", "\"/etc/passwd.csv\"", "neither"),
        ("response", "\"a/../b.csv\"", "neither"),
        ("response", "\"/etc/passwd\"", "neither"),
        ("response", "{\"gamma\": 0}", "gamma"),
        ("response", "{\"gamma\": 1e308}", "gamma"),
        ("response", "{\"table\": []}", "table"),
        ("response", "{\"table\": [[0, 0], [0.5, 2], [1, 1]]}", "row 3"),
        ("response", "{\"table\": [[0, 0], [0.5, 0.6], [0.5, 0.7], [1, 1]]}", "row 3"),
        ("black_level", "1023", "black level"),
        ("black_level", "1022.5", "black level"),
        ("black_level", "-1e308", "black level"),
        ("white_level", "1e308", "white level"),
        ("white_level", "5e-324", "white level"),
        ("white_level", "1e999", ""),
        ("bit_depth", "0", "bit depth"),
        ("bit_depth", "-1", "bit_depth\" is"),
        ("frame_period_ms", "0", "period"),
        ("frame_period_ms", "-1", "period"),
        ("schedule_start", "9223372036854775807", "schedule start"),
        ("schedule_start", "-9223372036854775808", "schedule start"),
        ("schedule_start", "1.5", "schedule_start\" is"),
        ("full_well_e", "0", "full_well_e"),
        ("full_well_e", "-9000", "full_well_e"),
        ("read_noise_e", "-1", "read_noise_e"),
        ("anchor", "1e300", "anchor"),
        ("anchor", "0", "anchor"),
        ("timing", "\"tomorrow\"", "tomorrow"),
        ("dead_pixels", "[[6, 0]]", "(6, 0)"),
        ("dead_pixels", "[[0, 18446744073709551615]]", "dead pixel"),
        ("dead_pixels", "[[0, -1]]", "dead_pixels\" is"),
        ("missing_count", "65536", "missing_count\" is"),
        ("pattern", "\"../../etc/passwd\"", "built-in"),
        ("pattern", "{\"tile\": []}", "0×0"),
        ("no such key", "1", "no such key"),
    ] {
        desk.refuses_file("capture/capture.json", with(key, value).as_bytes(), &[word]);
    }
    for text in ["", "[]", "null", "{", "\u{feff}{}", "{\"pattern\": 1}"] {
        desk.refuses_file("capture/capture.json", text.as_bytes(), &[]);
    }
    desk.refuses_file("capture/capture.json", &[0xff; 100], &["UTF-8"]);
    desk.refuses_file("capture/capture.json", b"\xff\xfe{\0}\0", &["UTF-16"]);
    desk.refuses_file("capture/capture.json", b"\xef\xbb\xbf[]", &["an object"]);
    let twice = sound.trim_end().trim_end_matches('}').to_owned() + ", \"black_level\": 64}";
    desk.refuses_file("capture/capture.json", twice.as_bytes(), &["black_level", "twice"]);
    desk.refuses_file("capture/capture.json", "[".repeat(1 << 20).as_bytes(), &[]);
    desk.refuses_file("capture/capture.json", " ".repeat((16 << 20) + 1).as_bytes(), &["16777216"]);
}

#[test]
fn patterns_and_responses_and_lists_of_pixels() {
    let desk = Desk::new();
    let shutters = |shutters: &str| format!(r#"{{"tile": [[{{"period": 8, "shutters": [{shutters}]}}]]}}"#);
    for (json, word) in [
        (r#"{"tile": [[[0, 0]]]}"#.to_owned(), "period"),
        (r#"{"tile": [[[18446744073709551615, 1]]]}"#.to_owned(), "period"),
        (r#"{"tile": [[[255, 1], [256, 1]]]}"#.to_owned(), "repeats"),
        (r#"{"tile": [[]]}"#.to_owned(), "1×0"),
        (format!(r#"{{"tile": [[{}[2, 1]]]}}"#, "[2, 1], ".repeat(5000)), "5001"),
        (shutters(""), "cover"),
        // Sums that overflow to what they should be.
        (shutters(r#"{"start": 18446744073709551615, "frames": 8}"#), "period"),
        (shutters(r#"{"start": 5, "frames": 18446744073709551614}, {"start": 3, "frames": 10}"#), "period"),
        (shutters(r#"{"start": 0, "frames": 8, "open": [0, 18446744073709551615]}"#), "open"),
        (shutters(r#"{"start": 0, "frames": 8, "open": [3, 3]}"#), "open"),
        (shutters(r#"{"start": 0, "frames": 8, "open": []}"#), "open"),
        (shutters(r#"{"start": 4, "frames": 4}, {"start": 0, "frames": 4}"#), "ends"),
    ] {
        let word = if word == "ends" { "does not end" } else { word };
        desk.refuses_file("pattern.json", json.as_bytes(), &[word]);
    }
    for (text, word) in [
        ("x,y\n0,0\n1,5\n2,4\n", "row 4"),
        ("0,0\n", "two rows"),
        ("0,1\n1,1\n", "two rows"),
        ("0,0\n0,1\n", "row 2"),
        ("-1e308,0\n1e308,1\n", "too wide"),
        ("0,0\nnan,1\n", "row 2"),
        ("0,0\n1,inf\n", "row 2"),
        ("\n\n#\n", "no rows"),
    ] {
        desk.refuses_file("response.csv", text.as_bytes(), &[word]);
    }
    desk.refuses_file("response.csv", &[0xff, 0xfe, 0], &[]);
    for (text, word) in [("1\n", "line 1"), ("0 0\nx\n", "line 2"), ("-1 0\n", "line 1")] {
        desk.refuses_file("dead.txt", text.as_bytes(), &[word]);
    }
    // The pixel is named; the file that it is in is found beside it on the command line.
    fs::write(desk.path("dead.txt"), "99 0\n").unwrap();
    let arguments =
        ["synth", &desk.name("capture"), "--executor", "cpu", "--dead-pixels", &desk.name("dead.txt")];
    desk.refuses("a pixel outside", &arguments, &["(99, 0)"]);
}

/// A graph of `nodes` behind an estimate and features `f` of `channels` channels.
fn graph(window: &str, features: &str, nodes: &str, output: &str) -> String {
    format!(
        r#"{{"version": 1, "name": "t", "pattern": "any", "window": {window}, "nodes": [
        {{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}},
        {{"name": "f", "op": "features", "inputs": ["measurement", "estimate"], {features}}}{nodes}], "output": "{output}"}}"#
    )
}

#[test]
fn weights_and_graphs() {
    const WINDOW: &str = r#"{"frames": 2, "lead": 0, "hop": 2}"#;
    const PLAIN: &str = r#""channels": ["measurement"], "block": [1, 1, 1]"#;
    let desk = Desk::new();
    let refuses = |graph: &str, words: &[&str]| desk.refuses_file("w.safetensors", &weights(graph), words);
    let up = |input: &str, name: &str| {
        format!(
            r#", {{"name": "{name}", "op": "conv_transpose3d", "inputs": ["{input}"], "out_channels": 1,
            "kernel": [4, 4, 4], "stride": [4, 4, 4], "activation": "none"}}"#
        )
    };
    // Windows and sizes whose sums and products overflow.
    refuses(
        &graph(r#"{"frames": 2, "lead": 18446744073709551615, "hop": 1}"#, PLAIN, "", "estimate"),
        &["window"],
    );
    refuses(
        &graph(r#"{"frames": 2, "lead": 1, "hop": 18446744073709551615}"#, PLAIN, "", "estimate"),
        &["window"],
    );
    refuses(
        &graph(r#"{"frames": 18446744073709551615, "lead": 0, "hop": 1}"#, PLAIN, "", "estimate"),
        &["window"],
    );
    let chain: String = (0..40)
        .map(|i| up(&if i == 0 { "f".to_owned() } else { format!("u{}", i - 1) }, &format!("u{i}")))
        .collect();
    refuses(&graph(WINDOW, PLAIN, &chain, "estimate"), &["too many values"]);
    let blocks: String = [64, 63, 61, 59, 55, 53, 47, 43, 41, 37, 31, 29]
        .map(|n| {
            format!(
                r#", {{"name": "b{n}", "op": "features", "inputs": ["measurement", "estimate"],
                "channels": ["measurement"], "block": [1, 1, {n}]}}"#
            )
        })
        .concat();
    refuses(&graph(WINDOW, PLAIN, &blocks, "estimate"), &["too coarse"]);
    // Copies whose weights are larger than any file.
    let wide =
        r#""channels": ["measurement", "saturated", "log_exposure", "log_estimate"], "block": [1, 32, 32]"#;
    let list =
        |count: usize, node: &dyn Fn(usize) -> String| (0..count).map(node).collect::<Vec<_>>().concat();
    let concats = list(64, &|i| format!(r#", {{"name": "c{i}", "op": "concat", "inputs": ["f", "f"]}}"#));
    let window = r#"{"frames": 1, "lead": 0, "hop": 1}"#;
    // Only the plan for a size shows it, so the net is named.
    let copies = weights(&graph(window, wide, &concats, "estimate"));
    desk.refuses_content("w.safetensors", &copies, &["'t'", "copy too many"]);
    let many =
        list(2000, &|i| format!(r#", {{"name": "n{i}", "op": "box_estimate", "inputs": ["measurement"]}}"#));
    refuses(&graph(WINDOW, PLAIN, &many, "estimate"), &["2002 nodes"]);
    // Numbers that are none, and operations that cannot be.
    let conv = |more: &str| {
        let given = format!(r#", {{"name": "c", "op": "conv3d", "inputs": ["f"], {more}}}"#);
        graph(WINDOW, PLAIN, &given, "estimate")
    };
    let sound = r#""out_channels": 1, "kernel": [1, 1, 1], "stride": [1, 1, 1]"#;
    refuses(&conv(&format!(r#"{sound}, "activation": {{"leaky_relu": 1e39}}"#)), &["inf"]);
    refuses(&conv(&format!(r#"{sound}, "activation": {{"softplus": -1e39}}"#)), &["inf"]);
    for (kernel, stride, out) in [
        ("[1, 1, 1]", "[0, 1, 1]", "1"),
        ("[2, 2, 2]", "[1, 1, 1]", "1"),
        ("[1, 1, 17]", "[1, 1, 1]", "1"),
        ("[1, 1, 1]", "[1, 1, 18446744073709551615]", "1"),
        ("[1, 1, 1]", "[1, 1, 1]", "0"),
        ("[1, 1, 1]", "[1, 1, 1]", "18446744073709551615"),
    ] {
        let more =
            format!(r#""out_channels": {out}, "kernel": {kernel}, "stride": {stride}, "activation": "none""#);
        refuses(&conv(&more), &[]);
    }
    // A layer without its tensors, an output that is no video, one that is not there, and a loop.
    refuses(&conv(&format!(r#"{sound}, "activation": "none""#)), &["c.weight", "missing"]);
    refuses(&graph(WINDOW, PLAIN, "", "measurement"), &["output"]);
    refuses(&graph(WINDOW, PLAIN, "", "nowhere"), &["nowhere"]);
    refuses(&conv(&format!(r#"{sound}, "activation": "none", "add": "c""#)), &["'c'"]);
    refuses(&"[".repeat(100_000), &["layer graph"]);
    // What is not a weights file at all.
    for bytes in [&[0xff; 8][..], &[0xff; 7], &[0; 8], b"\x02\0\0\0\0\0\0\0{}", b"\x10\x27\0\0\0\0\0\0{"] {
        desk.refuses_file("w.safetensors", bytes, &[]);
    }
    let tensor = |offsets: &str| {
        let header = format!(r#"{{"a": {{"dtype": "F32", "shape": [1], "data_offsets": {offsets}}}}}"#);
        [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 4]].concat()
    };
    for offsets in ["[0, 4]", "[4, 0]", "[0, 18446744073709551615]", "[18446744073709551615, 4]"] {
        desk.refuses_file("w.safetensors", &tensor(offsets), &[]);
    }
    let arguments =
        ["synth", &desk.name("capture"), "--executor", "cpu", "--weights", "/dev/zero/w.safetensors"];
    desk.refuses("a folder that is a file", &arguments, &["w.safetensors"]);
    // A device without end.
    let link = desk.path("endless.safetensors");
    std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
    let arguments =
        ["synth", &desk.name("capture"), "--executor", "cpu", "--weights", &link.display().to_string()];
    desk.refuses("a file without end", &arguments, &["endless.safetensors", "not a file"]);
}

#[test]
fn pictures() {
    let desk = Desk::new();
    let sound = desk.path("sound.exr");
    let frame = Video::new(1, 6, 8, vec![0.5; 48]).unwrap();
    video::write(&sound, &frame, Writing::default()).unwrap();
    let bytes = fs::read(&sound).unwrap();
    // Both windows of the header, at the values that follow their names and types.
    let window = |corners: [i32; 4]| {
        let mut bytes = bytes.clone();
        for name in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
            let at = bytes.windows(name.len()).position(|part| part == name).unwrap() + name.len() + 4;
            for (i, corner) in corners.iter().enumerate() {
                bytes[at + 4 * i..at + 4 * i + 4].copy_from_slice(&corner.to_le_bytes());
            }
        }
        bytes
    };
    for corners in [
        [0, 0, i32::MAX, i32::MAX],
        [i32::MIN, i32::MIN, i32::MAX, i32::MAX],
        [0, 0, 16383, 16383],
        [0, 0, -1, -1],
        [5, 5, 4, 4],
        [0, 0, 7, 6],
        [i32::MAX, i32::MAX, i32::MAX, i32::MAX],
    ] {
        desk.refuses_file("p.exr", &window(corners), &[]);
    }
    // A display window that a small file cannot fill, or in which it has no pixels.
    for (corners, word) in [([0, 0, 16383, 16383], "display window"), ([90, 90, 97, 95], "no pixel")] {
        let name = b"displayWindow\0box2i\0";
        let mut bytes = bytes.clone();
        let at = bytes.windows(name.len()).position(|part| part == name).unwrap() + name.len() + 4;
        for (i, corner) in corners.iter().enumerate() {
            bytes[at + 4 * i..at + 4 * i + 4].copy_from_slice(&i32::to_le_bytes(*corner));
        }
        desk.refuses_file("p.exr", &bytes, &[word]);
    }
    // Room is not made for what the file cannot hold: found by fuzzing.
    desk.refuses_file("p.exr", &window([0, 0, (1 << 26) - 1, 0]), &["promises"]);
    for length in [0, 4, 8, bytes.len() / 2, bytes.len() - 1] {
        desk.refuses_file("p.exr", &bytes[..length], &[]);
    }
    for header in
        ["#?RADIANCE\n\n-Y 16384 +X 16384\n", "#?RADIANCE\n\n-Y 99999999999999999999 +X 1\n", "#?", ""]
    {
        desk.refuses_file("p.hdr", header.as_bytes(), &[]);
    }
    // A sequence whose pictures differ in size, and one with a picture that is none.
    fs::create_dir(desk.path("sequence")).unwrap();
    fs::copy(&sound, desk.path("sequence/frame-00000.exr")).unwrap();
    let other = Video::new(1, 8, 6, vec![0.5; 48]).unwrap();
    video::write(desk.path("sequence/frame-00001.exr"), &other, Writing::default()).unwrap();
    let sequence = desk.name("sequence");
    desk.refuses("pictures of two sizes", &["sample", &sequence], &["frame-00001.exr", "6×8"]);
    fs::remove_file(desk.path("sequence/frame-00001.exr")).unwrap();
    fs::copy(&sound, desk.path("sequence/frame-00003.exr")).unwrap();
    desk.refuses("a gap", &["sample", &sequence], &["frames 1 to 2", "frame-00003"]);
    fs::rename(desk.path("sequence/frame-00003.exr"), desk.path("sequence/mask-00001.exr")).unwrap();
    desk.refuses("two sequences", &["sample", &sequence], &["2 sequences", "mask"]);
    fs::remove_file(desk.path("sequence/mask-00001.exr")).unwrap();
    fs::create_dir(desk.path("sequence/frame-00001.exr")).unwrap();
    desk.refuses("a folder in the place of a picture", &["sample", &sequence], &["frame-00001.exr"]);
}

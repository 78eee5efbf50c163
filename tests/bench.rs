//! `pix2hdr bench`: what machines read has all keys with the right types, and figures that can be.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// Runs the benchmark on pictures small enough for any machine.
fn bench(arguments: &[&str], out: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pix2hdr"))
        .args(["bench", "--quick", "--size", "32x16", "--frames", "12", "--out"])
        .arg(out)
        .args(arguments)
        .env_remove("RUST_LOG")
        .output()
        .expect("the program starts")
}

fn json(arguments: &[&str], out: &Path) -> Value {
    let output = bench(&[arguments, &["--json"]].concat(), out);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("standard output is one JSON object and nothing else")
}

const TEXTS: [&str; 6] = ["preset", "weights", "executor", "precision", "skip", "scene"];
const COUNTS: [&str; 5] = ["width", "height", "frames", "samples", "activation_bytes"];
/// Positive and always measured.
const FIGURES: [&str; 12] = [
    "ms_per_frame_median",
    "ms_per_frame_p95",
    "frames_per_s",
    "mpixel_per_s",
    "gflop_per_frame",
    "mbyte_per_frame",
    "least_mbyte_per_frame",
    "arithmetic_floor_ms_per_frame",
    "bytes_floor_ms_per_frame",
    "peak_fraction",
    "end_to_end_ms_per_frame",
    "box_psnr_mu_db",
];
/// Positive, or null where it cannot be measured.
const PERHAPS: [&str; 7] = [
    "device_ms_per_frame_median",
    "processor_ms_per_frame",
    "tiles_computed_fraction",
    "psnr_mu_db",
    "psnr_vs_oracle_db",
    "max_error_bound_fraction",
    "peak_memory_bytes",
];

/// The value of `key`, which has to be there.
fn value<'a>(row: &'a Value, key: &str) -> &'a Value {
    row.get(key).unwrap_or_else(|| panic!("no '{key}' in {row:#}"))
}

fn positive(row: &Value, key: &str) -> f64 {
    let figure = value(row, key).as_f64().filter(|figure| *figure > 0.0 && figure.is_finite());
    figure.unwrap_or_else(|| panic!("'{key}' is not a positive number in {row:#}"))
}

fn check_row(row: &Value) {
    for key in TEXTS {
        assert!(value(row, key).is_string(), "'{key}' in {row:#}");
    }
    for key in COUNTS {
        assert!(value(row, key).as_u64().is_some_and(|count| count > 0), "'{key}' in {row:#}");
    }
    for key in FIGURES {
        positive(row, key);
    }
    for key in PERHAPS {
        if !value(row, key).is_null() {
            positive(row, key);
        }
    }
    let adapter = value(row, "adapter");
    assert!(adapter.is_string() == (row["executor"] == "gpu"), "{row:#}");
    assert!(positive(row, "ms_per_frame_p95") >= positive(row, "ms_per_frame_median"), "{row:#}");
    let (ms, rate) = (positive(row, "ms_per_frame_median"), positive(row, "frames_per_s"));
    assert!((ms * rate / 1e3 - 1.0).abs() < 1e-6, "{row:#}");
    assert_eq!((&row["width"], &row["height"], &row["frames"]), (&32.into(), &16.into(), &12.into()));
    assert_eq!(row["psnr_mu_db"].is_number(), row["weights"] == "trained", "{row:#}");
    // An executor at f32 is as exact as this on any net, and no step leaves its bound.
    assert!(positive(row, "psnr_vs_oracle_db") > 60.0, "{row:#}");
    assert!(positive(row, "max_error_bound_fraction") <= 1.0, "{row:#}");
}

#[test]
fn the_json_object_is_complete_on_cpu_and_gpu() {
    let out = tempfile::tempdir().unwrap();
    let report = json(&["--weights", "fast,tiny", "--executor", "cpu,gpu", "--per-layer"], out.path());
    let machine = value(&report, "machine");
    assert!(value(machine, "cpu_threads").as_u64().is_some_and(|threads| threads > 0));
    for key in ["version", "os", "arch"] {
        assert!(value(machine, key).is_string());
    }
    let peaks = value(machine, "peaks").as_array().unwrap();
    assert_eq!(peaks.len(), 2);
    for peak in peaks {
        // A hundredth of what the slowest machine can do, and more than any has.
        let (flop, copy) = (positive(peak, "gflop_per_s"), positive(peak, "copy_gbyte_per_s"));
        assert!((0.05..1e7).contains(&flop) && (0.01..1e6).contains(&copy), "{peak:#}");
    }
    let rows = value(&report, "rows").as_array().unwrap();
    let ways: Vec<_> = rows.iter().map(|row| (&row["preset"], &row["executor"])).collect();
    let wanted = [("fast", "cpu"), ("fast", "gpu"), ("tiny", "cpu"), ("tiny", "gpu")];
    assert_eq!(ways.len(), wanted.len());
    assert!(ways.iter().zip(wanted).all(|(way, wanted)| (way.0 == wanted.0) && (way.1 == wanted.1)));
    for row in rows {
        check_row(row);
        let layers = value(row, "layers").as_array().unwrap();
        assert!(layers.len() > 2);
        for layer in layers {
            assert!(["step", "kernel", "output"].iter().all(|key| value(layer, key).is_string()));
            for key in ["ms_per_frame", "roofline_ms_per_frame", "times_roofline"] {
                positive(layer, key);
            }
            let convolution = layer["kernel"].as_str().unwrap().starts_with("conv");
            assert_eq!(value(layer, "gflop_per_s").as_f64().unwrap() > 0.0, convolution, "{layer:#}");
        }
    }
    // Both compute the same net, and of it only what the window before has not computed.
    let gflop = [0, 1].map(|row: usize| positive(&rows[row], "gflop_per_frame"));
    assert_eq!(gflop[0], gflop[1]);
    let written: Value = serde_json::from_slice(&fs::read(out.path().join("bench.json")).unwrap()).unwrap();
    assert_eq!(written["rows"].as_array().unwrap().len(), rows.len());
    let svg = fs::read_to_string(out.path().join("frontier.svg")).unwrap();
    assert!(svg.starts_with("<svg") && svg.contains(">fast<") && svg.contains("box filter"), "{svg}");
    assert!(fs::read(out.path().join("frontier.png")).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn tables_name_their_units() {
    let out = tempfile::tempdir().unwrap();
    let output = bench(&["--weights", "fast", "--executor", "cpu", "--markdown"], out.path());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    for word in ["| net ", "ms/frame", "GFLOP/frame", "PSNR-µ dB", "| fast ", "GB/s of copying", "|--:|"] {
        assert!(text.contains(word), "'{word}' is not in\n{text}");
    }
}

/// Every kernel within its bounds, a long recording without drift, and defects that cost less once they are known.
#[test]
fn the_stability_report_is_complete() {
    let out = tempfile::tempdir().unwrap();
    let arguments =
        ["bench", "--stability", "--quick", "--weights", "tiny", "--executor", "cpu", "--json", "--out"];
    let output =
        Command::new(env!("CARGO_BIN_EXE_pix2hdr")).args(arguments).arg(out.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        report,
        serde_json::from_slice::<Value>(&fs::read(out.path().join("stability.json")).unwrap()).unwrap()
    );
    let rows = |key: &str| value(&report, key).as_array().unwrap().clone();
    let steps: Vec<Value> = rows("outcomes")
        .iter()
        .flat_map(|outcome| value(outcome, "steps").as_array().unwrap().clone())
        .collect();
    assert!(steps.len() > 500 && steps.iter().all(|step| step["fraction"].as_f64().unwrap() <= 1.0));
    for soak in rows("soak") {
        assert_eq!((&soak["frames"], &soak["differing"]), (&4000.into(), &0.into()), "{soak}");
    }
    let sensitivity = rows("sensitivity");
    let psnr = |what: &str| {
        let row = sensitivity
            .iter()
            .find(|row| row["disturbance"] == what)
            .unwrap_or_else(|| panic!("no '{what}'"));
        positive(row, "psnr_mu_db")
    };
    let undisturbed = positive(&sensitivity[0], "undisturbed_db");
    for (unknown, filled) in [
        ("0.5% dead pixels, not known", "0.5% dead pixels, filled"),
        ("0.5% hot pixels, not known", "0.5% hot pixels, filled"),
        ("1% of read-outs missing, as 0", "1% of read-outs missing, filled"),
        ("every 16th frame dropped, not known", "every 16th frame dropped, filled"),
    ] {
        let (unknown, filled) = (psnr(unknown), psnr(filled));
        assert!(filled > unknown + 1.0 && filled > undisturbed - 1.0, "{undisturbed}, {unknown}, {filled}");
    }
}

#[test]
fn requests_that_cannot_be_met_are_refused() {
    for (arguments, word) in [
        (&["--precision", "f16", "--executor", "cpu"][..], "f32 only"),
        (&["--scene", "nonesuch"], "nonesuch"),
        (&["--weights", "nonesuch"], "nonesuch"),
        (&["--weights", "fast", "--executor", "cpu", "--variant", "4x2"], "--variant"),
        (&["--executor", "gpu", "--adapter", "nonesuch"], "nonesuch"),
    ] {
        let out = tempfile::tempdir().unwrap();
        let output = bench(arguments, out.path());
        let error = String::from_utf8_lossy(&output.stderr);
        let ours: Vec<&str> = error.lines().filter(|line| line.starts_with("pix2hdr:")).collect();
        assert!(!output.status.success() && output.stdout.is_empty(), "{arguments:?}");
        assert!(ours.len() == 1 && ours[0].contains(word), "{arguments:?}: {error}");
        assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0);
    }
}

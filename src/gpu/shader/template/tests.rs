use std::collections::BTreeSet;
use std::path::Path;

use naga::valid::Capabilities;

use super::*;
use crate::gpu::shader::table::files;
use crate::gpu::shader::validation::validate;

fn lines(text: &str) -> Vec<Line> {
    (1..)
        .zip(text.lines())
        .map(|(n, line)| Line { text: line.to_owned(), origin: ("test.wgsl", n) })
        .collect()
}

fn written(text: &str, parameters: &Parameters) -> String {
    let mut written = Vec::new();
    write(&lines(text), parameters, &mut written);
    finish(written, Vec::new()).text
}

fn parameters() -> Parameters {
    let mut parameters = Parameters::default();
    parameters.set("pixels", 2_usize);
    parameters.set("slope", 0.2_f32);
    parameters.set("taps", Value::array("i32", [1, -2]));
    parameters.set("team", true);
    parameters.set("alone", false);
    parameters
}

#[test]
fn parameters_replace_defaults() {
    let text = "const PIXELS: i32 = 1; //!parameter\n\
                const SLOPE: f32 = 0.0; //!parameter\n\
                const TAPS = array<i32, 1>(0); //!parameter\n\
                const OTHER = 1; // stays\n";
    let expected = "const PIXELS: i32 = 2;\n\
                    const SLOPE: f32 = 0.2f;\n\
                    const TAPS = array<i32, 2>(1, -2);\n\
                    const OTHER = 1;\n";
    assert_eq!(written(text, &parameters()), expected);
}

#[test]
fn static_loops_are_written_out() {
    let text = "a;\nfor (var p = 0; p < PIXELS; p++) { //!static\n    b[p]; // comment\n\
                    for (var i = 0; i < 1; i++) { //!static\n        if (x) {\n        c;\n        }\n    }\n}\nd;\n";
    let turn = |p: usize| {
        format!(
            "{{ const p = {p};\n    b[p];\n{{ const i = 0;\n        if (x) {{\n        c;\n        }}\n}}\n}}\n"
        )
    };
    assert_eq!(written(text, &parameters()), format!("a;\n{}{}d;\n", turn(0), turn(1)));
}

#[test]
fn static_branches_are_decided() {
    let text = "if (NAME) { //!static\n    a;\n} else {\n    b;\n}\nc;\n";
    assert_eq!(written(&text.replace("NAME", "TEAM"), &parameters()), "    a;\nc;\n");
    assert_eq!(written(&text.replace("NAME", "ALONE"), &parameters()), "    b;\nc;\n");
    assert_eq!(written("if (ALONE) { //!static\n    a;\n}\n", &parameters()), "");
}

#[test]
fn members_of_the_geometry_are_values() {
    let text = "struct Geometry {\n    // Comment.\n    pixels: i32,\n    taps: i32, // more\n}\n";
    let mut parameters = parameters();
    parameters.set("taps", 7_usize);
    assert_eq!(geometry(&lines(text), &parameters), [("pixels".to_owned(), 2), ("taps".to_owned(), 7)]);
    assert_eq!(geometry(&lines("fn f() {}\n"), &parameters), []);
}

#[test]
fn files_are_included_once_and_renamed() {
    let text = as_it_stands(file("conv3d.wgsl")).text;
    for name in ["fn invocation_index(", "fn input_values(", "alias WeightsVector", "fn output_vector("] {
        assert_eq!(text.matches(name).count(), 1, "{name}");
    }
    assert!(!text.to_lowercase().contains("fn stored"), "{text}");
}

fn refusal(work: impl FnOnce() + std::panic::UnwindSafe) -> String {
    *std::panic::catch_unwind(work).unwrap_err().downcast::<String>().unwrap()
}

#[test]
fn what_nobody_says_is_named_with_its_line() {
    for (text, expected) in [
        ("\nconst WIDTH: i32 = 1; //!parameter\n", "test.wgsl:2: nobody says what WIDTH is"),
        ("for (var p = 0; p < WIDTH; p++) { //!static\n}\n", "test.wgsl:1: nobody says how many WIDTH is"),
        ("for (var p = 1; p < 2; p++) { //!static\n}\n", "test.wgsl:1: only loops that count up from 0"),
        ("if (WIDTH) { //!static\n}\n", "test.wgsl:1: nobody says whether that is so"),
        ("if (TEAM) { //!static\n", "test.wgsl:1: the block has no end"),
    ] {
        let refusal = refusal(|| _ = written(text, &parameters()));
        assert!(refusal.starts_with(expected), "{refusal}");
    }
}

/// The files in a folder of the repository and in those in it.
fn found(folder: &str) -> Vec<ShaderFile> {
    let entries = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder).read_dir().unwrap();
    let sources = entries.flat_map(|entry| {
        let entry = entry.unwrap();
        let path = format!("{folder}/{}", entry.file_name().to_str().unwrap());
        if entry.file_type().unwrap().is_dir() {
            return found(&path);
        }
        let text = std::fs::read_to_string(entry.path()).unwrap();
        vec![ShaderFile { path: path.leak(), text: text.leak() }]
    });
    sources.collect()
}

#[test]
fn every_file_is_in_the_table() {
    let paths = |sources: &[ShaderFile]| sources.iter().map(|source| source.path).collect::<BTreeSet<_>>();
    assert_eq!(paths(&found("shaders")), paths(&files().collect::<Vec<_>>()));
}

#[test]
fn every_file_is_valid_as_it_stands() {
    let sources = [found("shaders"), found("viewer/shaders")].concat();
    assert!(sources.len() > files().count());
    for source in sources {
        validate(&as_it_stands(source), Capabilities::all()).unwrap_or_else(|problem| panic!("{problem}"));
    }
}

#[test]
fn problems_are_reported_with_file_and_line() {
    let sound = as_it_stands(file("log_irradiance.wgsl"));
    for (from, to) in [
        // The first does not parse, the second is not valid.
        ("return log(1.0 + MU * p)", "return log(1.0 + MU * ) p"),
        ("return log(1.0 + MU * p)", "return 1u; //"),
    ] {
        let broken = Shader { text: sound.text.replace(from, to), ..sound.clone() };
        let problem = validate(&broken, Capabilities::all()).unwrap_err();
        let text = file("common/tone.wgsl").text;
        let line = 1 + text.lines().position(|line| line.contains(from)).unwrap();
        assert!(problem.starts_with(&format!("shaders/common/tone.wgsl:{line}: ")), "{problem}");
    }
}

//! What the trainer must agree with, in `weights-format/golden-layouts`: the layout of nets, the tables of patterns and
//! responses, the ends of recordings. `UPDATE_SNAPSHOTS=1` writes the files anew.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use pix2hdr::network::{MU, Model, Plan, SATURATED, presets};
use pix2hdr::sensor::{Calibration, Form, Pattern, Response, Symmetry};
use pix2hdr::synth::windows::stand_in;
use serde::Serialize;

/// How a net is laid out for one window.
#[derive(Serialize)]
struct Layout {
    /// Rows and columns of the window.
    size: [usize; 2],
    /// Extents t, y, x of which a window is a multiple.
    granularity: [usize; 3],
    /// Pixels to each side along t, y, x that a result depends on.
    reach: [usize; 3],
    /// Values of the weights file.
    parameters: usize,
    /// Operations of the nodes' convolutions for one window.
    flop: f64,
    /// t, y, x, c of every tensor.
    shapes: BTreeMap<String, [usize; 4]>,
    /// Frames of the node that are computed for a window's result.
    computed: BTreeMap<String, usize>,
}

/// When the pixels of a pattern integrate, and which views of it look the same.
#[derive(Serialize)]
struct Table {
    period: usize,
    rows: usize,
    cols: usize,
    saturation: f32,
    /// Exposure in frames of the read-out that covers a frame: [period, rows, cols].
    exposures: Vec<f32>,
    symmetries: Vec<Symmetry>,
}

/// A window at an end of a recording.
#[derive(Serialize)]
struct End {
    /// First recorded frame of the window, and the one behind the last.
    recorded: [usize; 2],
    /// For each frame of the window the recorded one that it shows.
    stand_ins: Vec<usize>,
}

/// A response.
#[derive(Serialize)]
struct Curve {
    saturation: f64,
    /// x = R⁻¹(y) at the 1024 levels y of 10 bits.
    inverse_response: Vec<f32>,
    /// Pairs (x, R(x)).
    values: Vec<[f64; 2]>,
}

fn weights_format() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("weights-format")
}

/// The layout of a window of 2×3 times the granularity.
fn layout(model: &Model) -> Layout {
    let graph = &model.graph;
    let granularity = graph.granularity().unwrap();
    let size = [2 * granularity[1], 3 * granularity[2]];
    let shapes = graph.shapes(size[0], size[1]).unwrap();
    let plan = Plan::lower(model, size[0], size[1]).unwrap();
    // Steps that only copy a tensor to where it is wanted are no nodes.
    let nodes: Vec<_> = plan.steps.iter().filter(|step| shapes.contains_key(step.name.as_str())).collect();
    Layout {
        size,
        granularity,
        reach: graph.reach().unwrap(),
        parameters: model.parameters(),
        flop: nodes.iter().map(|step| step.flop()).sum(),
        computed: nodes.iter().map(|step| (step.name.clone(), step.output.shape.t)).collect(),
        shapes: shapes.iter().map(|(name, s)| ((*name).to_owned(), [s.t, s.y, s.x, s.c])).collect(),
    }
}

/// Layouts by file: of the presets' graphs and of the golden nets.
fn nets() -> BTreeMap<String, Layout> {
    let mut nets = BTreeMap::new();
    for preset in presets::all() {
        let model = Model::random(preset.graph().unwrap(), 0).unwrap();
        nets.insert(format!("presets/{}.json", preset.name), layout(&model));
    }
    for entry in std::fs::read_dir(weights_format().join("golden")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if !name.ends_with(".io.safetensors") {
            nets.insert(format!("golden/{name}"), layout(&Model::read(&path).unwrap()));
        }
    }
    nets
}

/// The tables of a built-in pattern with the linear response.
fn calibration(name: &str) -> Calibration {
    let pattern = Pattern::built_in(name).unwrap();
    let response = Response::new(Form::Linear, pattern.shortest_exposure() as f64).unwrap();
    Calibration::new(&pattern, &response)
}

fn patterns() -> BTreeMap<&'static str, Table> {
    let table = |name| {
        let calibration = calibration(name);
        let [period, rows, cols] = calibration.repeat();
        Table {
            period,
            rows,
            cols,
            saturation: *calibration.inverse_response().last().unwrap(),
            exposures: calibration.exposures().to_vec(),
            symmetries: calibration.symmetries().to_vec(),
        }
    };
    Pattern::NAMES.into_iter().map(|name| (name, table(name))).collect()
}

/// Of a window of which only some frames were recorded, those that stand in for the others.
fn ends() -> BTreeMap<&'static str, Vec<End>> {
    let all = |name| {
        let calibration = calibration(name);
        let frames = 3 * calibration.repeat()[0];
        let end = |first: usize, end: usize| End {
            recorded: [first, end],
            stand_ins: (0..frames as i64)
                .map(|t| first + stand_in(&calibration, first as i64, end - first, t))
                .collect(),
        };
        vec![end(0, frames), end(5, frames), end(0, frames - 3), end(7, frames - 2)]
    };
    ["mpve-1-4", "mpve-1-8", "mpve-1-16"].into_iter().map(|name| (name, all(name))).collect()
}

fn responses() -> BTreeMap<&'static str, Curve> {
    let curve = |form| {
        let saturation = 2.0;
        let response = Response::new(form, saturation).unwrap();
        let values = (-1..=34).map(|i| f64::from(i) * saturation / 33.0).map(|x| [x, response.value(x)]);
        Curve {
            saturation,
            inverse_response: (0..1024).map(|i| response.exposure(f64::from(i) / 1023.0) as f32).collect(),
            values: values.collect(),
        }
    };
    let forms =
        [("linear", Form::Linear), ("gamma:2.2", Form::Gamma(2.2)), ("soft-knee:0.6", Form::SoftKnee(0.6))];
    forms.into_iter().map(|(name, form)| (name, curve(form))).collect()
}

/// A JSON object with an entry a line.
fn lines<V: Serialize>(entries: &BTreeMap<impl AsRef<str>, V>) -> String {
    let line = |(name, value): (&_, &V)| {
        let name: &str = AsRef::as_ref(name);
        format!("\"{name}\": {}", serde_json::to_string(value).unwrap())
    };
    format!("{{\n{}\n}}\n", entries.iter().map(line).collect::<Vec<_>>().join(",\n"))
}

/// Compares a file with what the code says; `UPDATE_SNAPSHOTS=1` writes it anew.
fn check(name: &str, text: &str) {
    let path = weights_format().join("golden-layouts").join(name);
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        return std::fs::write(path, text).unwrap();
    }
    let stored = std::fs::read_to_string(&path).unwrap_or_default();
    let differing =
        text.lines().zip(stored.lines().chain(std::iter::repeat(""))).find(|(new, old)| new != old);
    if let Some((new, old)) = differing {
        panic!("{name} is not what the code says (UPDATE_SNAPSHOTS=1 writes it anew):\n{old}\nis now\n{new}");
    }
    assert_eq!(stored.lines().count(), text.lines().count(), "{name} has more lines than the code says");
}

#[test]
fn layouts_of_nets_are_those_on_file() {
    let nets = nets();
    assert!(nets.len() > 50, "{} nets", nets.len());
    check("nets.json", &lines(&nets));
}

#[test]
fn tables_of_patterns_are_those_on_file() {
    check("patterns.json", &lines(&patterns()));
}

#[test]
fn ends_of_recordings_are_those_on_file() {
    check("ends.json", &lines(&ends()));
}

#[test]
fn curves_are_those_on_file() {
    let constants = BTreeMap::from([("mu", MU), ("saturated", SATURATED)]);
    check("constants.json", &lines(&constants));
    check("responses.json", &lines(&responses()));
}

//! The golden files of `weights-format/golden`: what real PyTorch computes.

use std::path::Path;

use pix2hdr::network::Model;
use pix2hdr::sensor::Calibration;
use safetensors::SafeTensors;
use serde::de::DeserializeOwned;

/// One case.
pub struct Golden {
    /// Name of the files.
    pub name: String,
    /// Graph and weights.
    pub model: Model,
    /// The camera.
    pub calibration: Calibration,
    /// Schedule time of the first frame.
    pub schedule: i64,
    /// Rows and columns of the window.
    pub size: [usize; 2],
    /// Pixel values [t, y, x].
    pub measurement: Vec<f32>,
    /// The plan's result: the window's result frames, if the output is a video.
    pub result: Vec<f32>,
}

/// All cases, in the order of their names.
pub fn all() -> Vec<Golden> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights-format/golden");
    let mut names: Vec<String> = std::fs::read_dir(&folder)
        .expect("the golden files are part of the repository")
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter_map(|name| name.strip_suffix(".io.safetensors").map(str::to_owned))
        .collect();
    names.sort();
    names.iter().map(|name| read(&folder, name)).collect()
}

fn read(folder: &Path, name: &str) -> Golden {
    let model = Model::read(folder.join(format!("{name}.safetensors"))).unwrap();
    let bytes = std::fs::read(folder.join(format!("{name}.io.safetensors"))).unwrap();
    let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
    let metadata = header.metadata().clone().unwrap();
    assert_eq!(metadata["format"], "pix2hdr-golden/1");
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let (measurement, shape) = tensor(&file, "measurement");
    let (mut result, output) = tensor(&file, "output");
    let window = model.graph.window;
    if output[0] == window.frames && output[3] == 1 {
        let frame = output[1] * output[2];
        result = result[window.lead * frame..][..window.hop * frame].to_vec();
    }
    Golden {
        name: name.to_owned(),
        model,
        calibration: Calibration::from_tables(
            ["period", "rows", "cols"].map(|key| parse(&metadata[key])),
            parse(&metadata["exposures"]),
            parse(&metadata["inverse_response"]),
        )
        .unwrap(),
        schedule: parse(&metadata["schedule_time"]),
        size: [shape[1], shape[2]],
        measurement,
        result,
    }
}

fn parse<T: DeserializeOwned>(json: &str) -> T {
    serde_json::from_str(json).unwrap()
}

fn tensor(file: &SafeTensors<'_>, name: &str) -> (Vec<f32>, Vec<usize>) {
    let view = file.tensor(name).unwrap();
    assert_eq!(view.dtype(), safetensors::Dtype::F32);
    let values = view.data().as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    (values, view.shape().to_vec())
}

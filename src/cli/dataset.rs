//! `pix2hdr dataset`: training cubes.

use std::path::PathBuf;

use crate::dataset::{self, Recipe, Scenes};
use crate::scene::Panorama;
use crate::sensor::{CameraModel, Pattern, Sampler};
use crate::video::{Outputs, check_folder_name};
use crate::{Error, Result};
use clap::Args;
use serde_json::json;

use super::options::{ResponseOption, SizeArgs, at_least_one, parse_response, show};
use super::terminal::{self, counted};

/// Makes training cubes: random clips from panoramas or from your own videos, through the camera simulator
#[derive(Args)]
pub struct Dataset {
    /// Folder of equirectangular panoramas (.exr or .hdr)
    #[arg(long, value_name = "FOLDER", required_unless_present = "videos", conflicts_with = "videos")]
    panoramas: Option<PathBuf>,
    /// Folder with a folder of .exr pictures for each video; their frames are taken as if they followed each other at
    /// the camera's rate
    #[arg(long, value_name = "FOLDER")]
    videos: Option<PathBuf>,
    /// Folder for the data set
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Number of cubes
    #[arg(long, default_value_t = 1024, value_parser = at_least_one)]
    cubes: usize,
    /// Frames per cube
    #[arg(long, default_value_t = 24, value_parser = at_least_one)]
    frames: usize,
    #[command(flatten)]
    size: SizeArgs<128>,
    /// Sampling pattern: a built-in name or a JSON file
    #[arg(long, default_value = "mpve-1-4", value_name = "NAME|FILE")]
    pattern: String,
    /// Camera of all cubes: default, pe-cmos, or a JSON file. The options below replace what it says
    #[arg(long, value_name = "NAME|FILE")]
    camera: Option<String>,
    /// Response: linear, gamma:2.2, soft-knee:0.6, or a CSV file [default: linear]
    #[arg(long, value_parser = parse_response, value_name = "CURVE")]
    response: Option<ResponseOption>,
    /// Electrons at y = 1: each cube's camera has another full well in this range, evenly drawn in its logarithm
    /// [default: 300..18000]
    #[arg(long, value_parser = positive_range, value_name = "LOW..HIGH")]
    full_well: Option<[f32; 2]>,
    /// Read noise in electrons rms, in the same way [default: 1..8]
    #[arg(long, value_parser = positive_range, value_name = "LOW..HIGH")]
    read_noise: Option<[f32; 2]>,
    /// Count of 1023 at which black lies. Above 0, counts keep noise below black [default: 0]
    #[arg(long, alias = "pedestal", value_parser = clap::value_parser!(u16).range(..1023), value_name = "COUNT")]
    black_level: Option<u16>,
    /// Schedule time of each cube's first frame; windows must fit behind it
    #[arg(long, default_value_t = 4, allow_hyphen_values = true, value_name = "FRAME")]
    schedule_start: i64,
    /// Seed of every random draw
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Replace what is there
    #[arg(long)]
    overwrite: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Parses two positive numbers, `LOW..HIGH`.
fn positive_range(text: &str) -> std::result::Result<[f32; 2], String> {
    let numbers = text.split_once("..").and_then(|(low, high)| Some([low.parse().ok()?, high.parse().ok()?]));
    match numbers {
        Some([low, high]) if 0.0 < low && low <= high && high < f32::INFINITY => Ok([low, high]),
        _ => Err("expected two positive numbers, LOW..HIGH".into()),
    }
}

impl Dataset {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        let camera = self.camera.as_deref().map(CameraModel::load).transpose()?.unwrap_or_default();
        if camera.bit_depth != CameraModel::default().bit_depth {
            return Err(Error::Usage(format!("cubes have 10 bits, the camera has {}", camera.bit_depth)));
        }
        // All cubes have the noise of a camera that is named.
        let range =
            |given: Option<[f32; 2]>, drawn: [f32; 2], own: Option<f64>| match (given, own, &self.camera) {
                (Some(range), ..) => Ok(range),
                (None, _, None) => Ok(drawn),
                (None, Some(own), Some(_)) if own > 0.0 => Ok([own as f32; 2]),
                _ => Err(Error::Usage("cubes need a camera with shot noise and read noise".into())),
            };
        let [height, width] = self.size.extent();
        let recipe = Recipe {
            pattern: Pattern::load(&self.pattern)?,
            form: self.response.as_ref().map_or_else(|| Ok(camera.response.clone()), ResponseOption::form)?,
            cubes: self.cubes,
            extent: [self.frames, height, width],
            full_well_e: range(self.full_well, [300.0, 18_000.0], camera.full_well_e)?,
            read_noise_e: range(self.read_noise, [1.0, 8.0], Some(camera.read_noise_e))?,
            black_level: self.black_level.unwrap_or(camera.black_level),
            schedule_start: self.schedule_start,
            seed: self.seed,
        };
        Sampler::new(recipe.pattern.clone(), recipe.form.clone())?;
        check_folder_name(&self.out)?;
        let sources = self.panoramas.iter().chain(&self.videos);
        let outputs = Outputs::new(self.overwrite).reading(sources);
        dataset::files(self.cubes).iter().try_for_each(|name| outputs.check(self.out.join(name)))?;
        let scenes = match (&self.panoramas, &self.videos) {
            (_, Some(folder)) => Scenes::read_videos(folder)?,
            (Some(folder), None) => Scenes::Panoramas(Panorama::read_folder(folder)?),
            (None, None) => return Err(Error::Usage("give --panoramas or --videos".into())),
        };
        let bar = terminal::progress(self.cubes, "making cubes");
        let files = dataset::write(&recipe, &scenes, &self.out, |done| bar.set_position(done as u64))?;
        bar.finish_and_clear();
        let report = json!({
            "cubes": self.cubes, "scenes": scenes.names().len(),
            "files": files.iter().map(|path| show(path)).collect::<Vec<_>>(),
        });
        terminal::result(self.json, &report, || {
            format!(
                "{}: {} from {}",
                show(&self.out),
                counted(self.cubes, "cube"),
                counted(scenes.names().len(), "scene")
            )
        })
    }
}

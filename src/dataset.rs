//! Training cubes: random clips from panoramas or videos through the camera simulator, written as arrays that a trainer
//! maps.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use half::f16;
use rayon::prelude::*;
use serde::Serialize;

use crate::scene::{Draw, Panorama, Rendering, render, training_clip};
use crate::sensor::{Calibration, Form, Noise, Pattern, Sampler};
use crate::video::atomic::write_bytes;
use crate::video::npy::{write_counts, write_halves};
use crate::video::{Counts, Pictures, Video};
use crate::{At, Error, Result};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Name of the file that describes a data set. It is written last: a folder without it is not a whole data set.
pub const INDEX: &str = "dataset.json";

/// Cubes per file.
const SHARD: usize = 256;

/// What to make of scenes.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// Pattern of the camera.
    pub pattern: Pattern,
    /// Response of the camera.
    pub form: Form,
    /// Number of cubes.
    pub cubes: usize,
    /// Extents of a cube: frames, rows, columns.
    pub extent: [usize; 3],
    /// Least and largest full well of a camera in electrons; each is drawn evenly in its logarithm.
    pub full_well_e: [f32; 2],
    /// The same of the read noise in electrons rms.
    pub read_noise_e: [f32; 2],
    /// Count at y = 0 of every camera; above 0, counts keep noise below black.
    pub black_level: u16,
    /// Schedule time of each cube's first frame.
    pub schedule_start: i64,
    /// Seed of everything.
    pub seed: u64,
}

/// What cubes are cut from.
#[derive(Clone, Debug)]
pub enum Scenes {
    /// Views of panoramas that move, with objects in front.
    Panoramas(Vec<Arc<Panorama>>),
    /// Crops of videos, by name. Their frames are taken as if they followed each other at the camera's rate.
    Videos(Vec<(String, Pictures)>),
}

/// What is known of one cube.
#[derive(Clone, Debug, Serialize)]
struct CubeInfo {
    seed: u64,
    kind: &'static str,
    full_well_e: f64,
    read_noise_e: f64,
    black_error: f64,
    gain_error: f64,
    exposure_gain: f32,
}

#[derive(Serialize)]
struct Shard {
    truth: String,
    measurement: String,
    info: String,
    cubes: usize,
}

/// One cube: irradiance and counts.
struct Cube {
    truth: Video,
    counts: Vec<u16>,
    info: CubeInfo,
}

/// Names of the shard `number`: truth, measurement and what is known of its cubes.
fn shard_files(number: usize) -> [String; 3] {
    [
        format!("truth-{number:03}.npy"),
        format!("measurement-{number:03}.npy"),
        format!("info-{number:03}.json"),
    ]
}

/// Names of all files of a data set of so many cubes.
pub fn files(cubes: usize) -> Vec<String> {
    (0..cubes.div_ceil(SHARD)).flat_map(shard_files).chain([INDEX.to_owned()]).collect()
}

/// Writes a data set into `folder`, in the place of one that is there; `progress` hears of every finished shard. Returns the files written.
///
/// The same recipe gives the same files on any number of threads.
pub fn write(
    recipe: &Recipe,
    scenes: &Scenes,
    folder: &Path,
    mut progress: impl FnMut(usize),
) -> Result<Vec<PathBuf>> {
    if recipe.cubes == 0 || recipe.extent.contains(&0) || scenes.names().is_empty() {
        return Err(Error::Usage("a data set needs scenes, cubes, and an extent".into()));
    }
    scenes.check(recipe.extent)?;
    let index = folder.join(INDEX);
    if index.exists() {
        fs::remove_file(&index).at(&index)?;
    }
    let mut shards = Vec::new();
    let mut files = Vec::new();
    for first in (0..recipe.cubes).step_by(SHARD) {
        let count = SHARD.min(recipe.cubes - first);
        let cubes: Vec<Cube> =
            (first..first + count).into_par_iter().map(|i| cube(recipe, scenes, i)).collect::<Result<_>>()?;
        let number = shards.len();
        let [truth, measurement, info] = shard_files(number);
        let shard = Shard { truth, measurement, info, cubes: count };
        let [t, y, x] = recipe.extent;
        let truth: Vec<f16> =
            cubes.iter().flat_map(|cube| cube.truth.data.iter().map(|&p| f16::from_f32(p))).collect();
        let counts = Counts::U16(cubes.iter().flat_map(|cube| cube.counts.iter().copied()).collect());
        let infos: Vec<&CubeInfo> = cubes.iter().map(|cube| &cube.info).collect();
        write_halves(folder.join(&shard.truth), &[count, t, y, x], &truth)?;
        write_counts(folder.join(&shard.measurement), &[count, t, y, x], &counts)?;
        write_bytes(folder.join(&shard.info), &json(&infos)?)?;
        files.extend([&shard.truth, &shard.measurement, &shard.info].map(|name| folder.join(name)));
        shards.push(shard);
        progress(first + count);
    }
    write_bytes(&index, &json(&index_of(recipe, scenes, &shards)?)?)?;
    files.push(index);
    Ok(files)
}

fn json(value: &impl Serialize) -> Result<Vec<u8>> {
    Ok(serde_json::to_vec(value)?)
}

fn index_of(recipe: &Recipe, scenes: &Scenes, shards: &[Shard]) -> Result<serde_json::Value> {
    let sampler = Sampler::new(recipe.pattern.clone(), recipe.form.clone())?;
    let calibration = Calibration::new(sampler.pattern(), sampler.response());
    let [frames, height, width] = recipe.extent;
    let mut index = serde_json::json!({
        "format": "pix2hdr-dataset/1",
        "pattern": recipe.pattern.name(),
        "response": recipe.form,
        "period": calibration.period,
        "rows": calibration.rows,
        "cols": calibration.cols,
        "exposures": calibration.exposures,
        "symmetries": calibration.symmetries,
        "saturation": sampler.response().saturation(),
        "inverse_response": calibration.inverse_response,
        "bit_depth": sampler.bit_depth,
        "schedule_start": recipe.schedule_start,
        "cubes": recipe.cubes,
        "frames": frames,
        "height": height,
        "width": width,
        "seed": recipe.seed,
        "scenes": scenes.names(),
        "shards": shards,
    });
    if recipe.black_level > 0 {
        index["black_level"] = recipe.black_level.into();
    }
    Ok(index)
}

impl Scenes {
    /// All videos in the folders of `folder`, one folder of EXR pictures each.
    pub fn read_videos(folder: &Path) -> Result<Self> {
        let mut videos = Vec::new();
        for entry in std::fs::read_dir(folder).at(folder)? {
            let path = entry.at(folder)?.path();
            if path.is_dir() {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                videos.push((name, Pictures::open(&path)?));
            }
        }
        videos.sort_by(|(a, _), (b, _)| a.cmp(b));
        if videos.is_empty() {
            return Err(Error::Usage("no folders of .exr pictures in it".into()).at(folder));
        }
        Ok(Self::Videos(videos))
    }

    /// Names of the panoramas or videos.
    pub fn names(&self) -> Vec<&str> {
        match self {
            Self::Panoramas(panoramas) => panoramas.iter().map(|panorama| panorama.name.as_str()).collect(),
            Self::Videos(videos) => videos.iter().map(|(name, _)| name.as_str()).collect(),
        }
    }

    /// Checks that cubes of an extent can be cut.
    fn check(&self, [_, height, width]: [usize; 3]) -> Result<()> {
        let Self::Videos(videos) = self else { return Ok(()) };
        // A crop may be turned, so it must fit both ways.
        let side = height.max(width);
        match videos.iter().find(|(_, pictures)| pictures.extent().iter().any(|&n| n < side)) {
            Some((name, _)) => Err(Error::Usage(format!(
                "the pictures of '{name}' are smaller than a cube of {height}×{width}"
            ))),
            None => Ok(()),
        }
    }

    /// A random clip, and how it moves.
    fn clip(&self, extent: [usize; 3], seed: u64) -> Result<(Video, &'static str)> {
        let [frames, height, width] = extent;
        match self {
            Self::Panoramas(panoramas) => {
                let (scene, speed) = training_clip(panoramas, [height, width], frames, seed);
                let rendering = Rendering { frames, height, width, instants: 6, positions: 1, seed };
                Ok((render(&scene, rendering, || ()), speed.name()))
            }
            Self::Videos(videos) => Ok((crop(videos, extent, seed)?, "video")),
        }
    }
}

/// A random crop of a random video, turned by a random multiple of 90°. A video that is too short runs forwards and
/// backwards.
fn crop(videos: &[(String, Pictures)], [frames, height, width]: [usize; 3], seed: u64) -> Result<Video> {
    let mut draw = Draw(ChaCha8Rng::seed_from_u64(seed));
    let (_, pictures) = &videos[draw.0.random_range(0..videos.len())];
    let turns = draw.0.random_range(0..4);
    let [rows, cols] = if turns % 2 == 0 { [height, width] } else { [width, height] };
    let [whole_rows, whole_cols] = pictures.extent();
    let top = draw.0.random_range(0..=whole_rows - rows);
    let left = draw.0.random_range(0..=whole_cols - cols);
    // There and back again: 0, 1 … n − 1, n − 2 … 1.
    let cycle = (2 * pictures.count() - 2).max(1);
    let first = draw.0.random_range(0..cycle.max(2) / 2 + 1);
    let mut video = Video::black(frames, height, width);
    for t in 0..frames {
        let index = (first + t) % cycle;
        let picture = pictures.read(index.min(cycle - index).min(pictures.count() - 1))?;
        let frame = video.frame_mut(t);
        for (i, p) in frame.iter_mut().enumerate() {
            let (y, x) = (i / width, i % width);
            let (row, col) = match turns {
                0 => (y, x),
                1 => (x, cols - 1 - y),
                2 => (rows - 1 - y, cols - 1 - x),
                _ => (rows - 1 - x, y),
            };
            *p = picture.data[(top + row) * whole_cols + left + col];
        }
    }
    Ok(video)
}

/// Cube number `index`: a random clip seen by a camera with random noise and errors of calibration.
fn cube(recipe: &Recipe, scenes: &Scenes, index: usize) -> Result<Cube> {
    let seed = recipe.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(index as u64);
    let (mut truth, kind) = scenes.clip(recipe.extent, seed)?;
    truth.normalise();
    let mut draw = Draw(ChaCha8Rng::seed_from_u64(!seed));
    // The user's exposure is not always set to the anchor: darker, or with more in saturation.
    let exposure_gain = if draw.chance(0.5) { 1.0 } else { draw.log_within(0.2, 2.0) };
    truth.data.iter_mut().for_each(|p| *p = (*p * exposure_gain).min(1.0));
    let ([least_well, most_well], [least_noise, most_noise]) = (recipe.full_well_e, recipe.read_noise_e);
    let noise = Noise {
        full_well_e: f64::from(draw.log_within(least_well, most_well)),
        // In octaves, which for 1 to 8 e⁻ gives the bits that cubes have always had.
        read_noise_e: f64::from(least_noise * ((most_noise / least_noise).log2() * draw.unit()).exp2()),
    };
    // Most recordings are calibrated well; the others are off in black level and gain, as lossy or drifting ones are.
    let (black_error, gain_error) = if draw.chance(0.75) {
        (0.0, 0.0)
    } else {
        let size = draw.log_within(0.0005, 0.01);
        let black_error = if draw.chance(0.5) { size } else { -size };
        (f64::from(black_error), f64::from(draw.within(-0.03, 0.03)))
    };
    let mut sampler = Sampler::new(recipe.pattern.clone(), recipe.form.clone())?;
    (sampler.noise, sampler.seed, sampler.schedule_start) = (noise, seed, recipe.schedule_start);
    (sampler.black_level, sampler.black_error, sampler.gain_error) =
        (recipe.black_level, black_error, gain_error);
    let Counts::U16(counts) = sampler.sample(&truth)?.counts else {
        unreachable!("the sampler writes 16 bits")
    };
    let Noise { full_well_e, read_noise_e } = noise;
    let info = CubeInfo { seed, kind, full_well_e, read_noise_e, black_error, gain_error, exposure_gain };
    Ok(Cube { truth, counts, info })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::video::{Writing, write};

    /// Frame t, row y, column x hold 100·t + 10·y + x.
    fn folder_of_videos(frames: usize) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let data = (0..frames * 54).map(|i| (100 * (i / 54) + 10 * (i / 9 % 6) + i % 9) as f32).collect();
        let video = Video::new(frames, 6, 9, data).unwrap();
        write(folder.path().join("clip"), &video, Writing::default()).unwrap();
        folder
    }

    #[test]
    fn crops_of_videos_keep_neighbours_in_space_and_time() {
        let folder = folder_of_videos(3);
        let Scenes::Videos(videos) = Scenes::read_videos(folder.path()).unwrap() else { unreachable!() };
        let mut steps = std::collections::BTreeSet::new();
        for seed in 0..40 {
            let video = crop(&videos, [7, 4, 3], seed).unwrap();
            let at = |t: usize, y: usize, x: usize| video.frame(t)[y * 3 + x];
            let (down, right) = (at(0, 1, 0) - at(0, 0, 0), at(0, 0, 1) - at(0, 0, 0));
            for (t, i) in (0..7).flat_map(|t| (0..12).map(move |i| (t, i))) {
                let (y, x) = (i / 3, i % 3);
                assert_eq!(at(t, y, x), at(t, 0, 0) + y as f32 * down + x as f32 * right, "seed {seed}");
                assert!(t == 0 || (at(t, y, x) - at(t - 1, y, x)).abs() == 100.0, "seed {seed}");
            }
            steps.insert([down as i32, right as i32]);
        }
        // All four turns, none of them mirrored.
        assert_eq!(steps, [[-10, -1], [-1, 10], [1, -10], [10, 1]].into());
    }

    #[test]
    fn one_picture_is_a_still_and_small_ones_are_refused() {
        let folder = folder_of_videos(1);
        let scenes = Scenes::read_videos(folder.path()).unwrap();
        let (video, kind) = scenes.clip([5, 4, 4], 1).unwrap();
        assert!((1..5).all(|t| video.frame(t) == video.frame(0)) && kind == "video");
        assert!(scenes.check([5, 7, 4]).unwrap_err().to_string().contains("clip"));
        assert!(Scenes::read_videos(&folder.path().join("clip")).is_err());
    }

    /// A recipe for one small cube of a video from cameras with these full wells.
    fn recipe(full_well_e: [f32; 2], black_level: u16) -> Recipe {
        Recipe {
            pattern: Pattern::built_in("mpve-1-4").unwrap(),
            form: Form::Linear,
            cubes: 1,
            extent: [5, 4, 4],
            full_well_e,
            read_noise_e: [2.0, 3.0],
            black_level,
            schedule_start: 4,
            seed: 7,
        }
    }

    #[test]
    fn cameras_lie_in_their_ranges_and_see_the_same_scenes() {
        let folder = folder_of_videos(3);
        let scenes = Scenes::read_videos(folder.path()).unwrap();
        let of = |full_well_e, index| cube(&recipe(full_well_e, 64), &scenes, index).unwrap();
        let mut below = 0;
        for index in 0..40 {
            let (many, one) = (of([100.0, 20_000.0], index), of([200.0, 200.0], index));
            assert!((100.0..=20_000.0).contains(&many.info.full_well_e), "{}", many.info.full_well_e);
            assert!((2.0..=3.0).contains(&many.info.read_noise_e), "{}", many.info.read_noise_e);
            assert_eq!(one.info.full_well_e, 200.0);
            assert_eq!(many.truth.data, one.truth.data);
            below += usize::from(many.info.full_well_e < 1414.0);
        }
        assert!((12..=28).contains(&below), "evenly in the logarithm, {below} of 40 are below the middle");
    }

    #[test]
    fn the_index_tells_a_pedestal() {
        let folder = folder_of_videos(3);
        let scenes = Scenes::read_videos(folder.path()).unwrap();
        let index = |black_level| index_of(&recipe([300.0, 300.0], black_level), &scenes, &[]).unwrap();
        assert_eq!(index(64)["black_level"], 64);
        assert_eq!(index(0).get("black_level"), None);
    }
}

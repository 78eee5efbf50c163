//! Training cubes: random clips through the camera simulator, written as arrays that a trainer maps.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use half::f16;
use rayon::prelude::*;
use serde::Serialize;

use crate::scene::{Draw, Panorama, Rendering, render, training_clip};
use crate::sensor::{Calibration, Form, Noise, Pattern, Sampler};
use crate::video::Video;
use crate::video::atomic::write_bytes;
use crate::video::npy::{Counts, write_counts, write_halves};
use crate::{Error, Result};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Name of the file that describes a data set. It is written last: a folder without it is not a whole data set.
pub const INDEX: &str = "dataset.json";

/// Cubes per file.
const SHARD: usize = 256;

/// What to make.
#[derive(Clone, Debug)]
pub struct Request {
    /// Pattern of the camera.
    pub pattern: Pattern,
    /// Response of the camera.
    pub form: Form,
    /// Number of cubes.
    pub cubes: usize,
    /// Extents of a cube: frames, rows, columns.
    pub extent: [usize; 3],
    /// Schedule time of each cube's first frame.
    pub schedule_start: i64,
    /// Seed of everything.
    pub seed: u64,
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

/// Writes a data set into `folder`; `progress` hears of every finished shard. Returns the files written.
///
/// The same request gives the same files on any number of threads.
pub fn write(
    request: &Request,
    panoramas: &[Arc<Panorama>],
    folder: &Path,
    mut progress: impl FnMut(usize),
) -> Result<Vec<PathBuf>> {
    if request.cubes == 0 || request.extent.contains(&0) || panoramas.is_empty() {
        return Err(Error::Usage("a data set needs panoramas, cubes, and an extent".into()));
    }
    let mut shards = Vec::new();
    let mut files = Vec::new();
    for first in (0..request.cubes).step_by(SHARD) {
        let count = SHARD.min(request.cubes - first);
        let cubes: Vec<Cube> = (first..first + count)
            .into_par_iter()
            .map(|i| cube(request, panoramas, i))
            .collect::<Result<_>>()?;
        let number = shards.len();
        let shard = Shard {
            truth: format!("truth-{number:03}.npy"),
            measurement: format!("measurement-{number:03}.npy"),
            info: format!("info-{number:03}.json"),
            cubes: count,
        };
        let [t, y, x] = request.extent;
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
    let index = folder.join(INDEX);
    write_bytes(&index, &json(&index_of(request, panoramas, &shards)?)?)?;
    files.push(index);
    Ok(files)
}

fn json(value: &impl Serialize) -> Result<Vec<u8>> {
    serde_json::to_vec(value).map_err(|e| Error::Usage(e.to_string()))
}

fn index_of(request: &Request, panoramas: &[Arc<Panorama>], shards: &[Shard]) -> Result<serde_json::Value> {
    let sampler = Sampler::new(request.pattern.clone(), request.form.clone())?;
    let calibration = Calibration::new(&sampler.pattern, &sampler.response);
    let [frames, height, width] = request.extent;
    Ok(serde_json::json!({
        "format": "pix2hdr-dataset/1",
        "pattern": request.pattern.name,
        "response": request.form,
        "period": calibration.period,
        "rows": calibration.rows,
        "cols": calibration.cols,
        "exposures": calibration.exposures,
        "saturation": sampler.response.saturation(),
        "inverse_response": calibration.inverse_response,
        "bit_depth": sampler.bit_depth,
        "schedule_start": request.schedule_start,
        "cubes": request.cubes,
        "frames": frames,
        "height": height,
        "width": width,
        "seed": request.seed,
        "panoramas": panoramas.iter().map(|panorama| panorama.name.as_str()).collect::<Vec<_>>(),
        "shards": shards,
    }))
}

/// Cube number `index`: a random clip seen by a camera with random noise and errors of calibration.
fn cube(request: &Request, panoramas: &[Arc<Panorama>], index: usize) -> Result<Cube> {
    let seed = request.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(index as u64);
    let [frames, height, width] = request.extent;
    let (scene, speed) = training_clip(panoramas, [height, width], frames, seed);
    let mut truth =
        render(&scene, Rendering { frames, height, width, instants: 6, positions: 1, seed }, || ());
    truth.normalise();
    let mut draw = Draw(ChaCha8Rng::seed_from_u64(!seed));
    // The user's exposure is not always set to the anchor: darker, or with more in saturation.
    let exposure_gain = if draw.chance(0.5) { 1.0 } else { draw.log_within(0.2, 2.0) };
    truth.data.iter_mut().for_each(|p| *p = (*p * exposure_gain).min(1.0));
    let noise = Noise {
        full_well_e: f64::from(draw.log_within(300.0, 18_000.0)),
        read_noise_e: f64::from(draw.log_within(1.0, 8.0)),
    };
    // Most recordings are calibrated well; the others are off in black level and gain, as lossy or drifting ones are.
    let (black_error, gain_error) = if draw.chance(0.75) {
        (0.0, 0.0)
    } else {
        let size = draw.log_within(0.0005, 0.01);
        let black_error = if draw.chance(0.5) { size } else { -size };
        (f64::from(black_error), f64::from(draw.within(-0.03, 0.03)))
    };
    let mut sampler = Sampler::new(request.pattern.clone(), request.form.clone())?;
    (sampler.noise, sampler.seed, sampler.schedule_start) = (noise, seed, request.schedule_start);
    (sampler.black_error, sampler.gain_error) = (black_error, gain_error);
    let Counts::U16(counts) = sampler.sample(&truth)?.counts else {
        unreachable!("the sampler writes 16 bits")
    };
    let Noise { full_well_e, read_noise_e } = noise;
    let info = CubeInfo {
        seed,
        kind: speed.name(),
        full_well_e,
        read_noise_e,
        black_error,
        gain_error,
        exposure_gain,
    };
    Ok(Cube { truth, counts, info })
}

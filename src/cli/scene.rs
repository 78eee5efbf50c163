//! `pix2hdr scene`: writes a ground-truth video.

use std::path::PathBuf;
use std::sync::Arc;

use crate::scene::{self, Moves, Panorama, Rendering, Scene, Speed, procedural};
use crate::video::{self, Outputs, Video, Writing};
use crate::{Error, Result};
use clap::{Args, ValueEnum};
use serde_json::json;

use super::options::{SizeArgs, at_least_one, show};
use super::terminal::{self, counted};

/// Writes a ground-truth HDR video: a built-in scene, or a clip from a panorama
///
/// Built-in scenes: fan, leds, falling, pouring, edge, wedge, still, still-moving. With --panorama, NAME is one of the
/// speeds static, slow, medium, fast, extreme.
#[derive(Args)]
pub struct SceneCommand {
    /// Name of a built-in scene, or of a speed with --panorama
    name: String,
    /// Folder of EXR frames, or a .npy file
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    #[command(flatten)]
    clip: ClipArgs,
    /// Cut the clip from this equirectangular panorama (.exr or .hdr)
    #[arg(long, value_name = "FILE")]
    panorama: Option<PathBuf>,
    /// What moves in a clip from a panorama
    #[arg(long, value_enum, default_value_t)]
    moves: MovesOption,
    /// Seed of every random draw
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Write 16-bit instead of 32-bit floating-point numbers
    #[arg(long)]
    half: bool,
    /// Replace what is there
    #[arg(long)]
    overwrite: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// What is rendered of a scene.
#[derive(Args, Clone, Copy, Debug)]
pub struct ClipArgs {
    /// Number of frames
    #[arg(long, default_value_t = 64, value_parser = at_least_one)]
    frames: usize,
    #[command(flatten)]
    size: SizeArgs<256>,
    /// Samples per pixel and frame: instants of motion blur
    #[arg(long, default_value_t = 8, value_parser = at_least_one)]
    samples: usize,
}

/// What moves.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum MovesOption {
    /// The camera turns
    Pan,
    /// Objects pass
    Object,
    /// Both
    #[default]
    Both,
}

impl ClipArgs {
    /// How it is rendered.
    pub fn rendering(&self, seed: u64) -> Rendering {
        let [height, width] = self.size.extent();
        Rendering { frames: self.frames, height, width, instants: self.samples, positions: 1, seed }
    }
}

/// Renders and normalises `scene`, with a progress bar. Returns the anchor too.
pub fn render(scene: &dyn Scene, how: Rendering) -> Result<(Video, f32)> {
    let Rendering { frames, height, width, .. } = how;
    let pixels = frames.checked_mul(height).and_then(|n| n.checked_mul(width)).filter(|n| *n <= 1 << 31);
    if pixels.is_none() {
        return Err(Error::Usage(format!(
            "{} of {width}×{height} pixels do not fit into memory",
            counted(frames, "frame")
        )));
    }
    let bar = terminal::progress(frames, "rendering");
    let mut video = scene::render(scene, how, || bar.inc(1));
    bar.finish_and_clear();
    let anchor = video.normalise();
    Ok((video, anchor))
}

impl SceneCommand {
    /// Runs the command.
    pub fn run(&self) -> Result<()> {
        Outputs::new(self.overwrite).reading(self.panorama.clone()).check_video(&self.out)?;
        let scene = self.scene()?;
        let (video, anchor) = render(&*scene, self.clip.rendering(self.seed))?;
        let how = Writing {
            half: self.half,
            overwrite: self.overwrite,
            frame_period_ms: Some(1.0),
            anchor: Some(anchor),
        };
        video::write(&self.out, &video, how)?;
        let Rendering { frames, height, width, .. } = self.clip.rendering(self.seed);
        let report = json!({
            "scene": self.name, "frames": frames, "height": height, "width": width,
            "anchor": anchor, "files": [show(&self.out)],
        });
        terminal::result(self.json, &report, || {
            let frames = counted(frames, "frame");
            format!("{}: {frames} of {width}×{height}, p = 1 at radiance {anchor:.4}", show(&self.out))
        })
    }

    fn scene(&self) -> Result<Box<dyn Scene>> {
        let Rendering { height, width, frames, .. } = self.clip.rendering(self.seed);
        let Some(path) = &self.panorama else {
            return procedural::by_name(&self.name, height, width, self.seed).ok_or_else(|| {
                Error::Usage(format!("no scene '{}'; there are {}", self.name, procedural::NAMES.join(", ")))
            });
        };
        let speed = Speed::ALL.into_iter().find(|speed| speed.name() == self.name).ok_or_else(|| {
            let names = Speed::ALL.map(Speed::name).join(", ");
            Error::Usage(format!("with --panorama the name is a speed: {names}; not '{}'", self.name))
        })?;
        let moves = match self.moves {
            MovesOption::Pan => Moves::Pan,
            MovesOption::Object => Moves::Object,
            MovesOption::Both => Moves::Both,
        };
        let panoramas = [Arc::new(Panorama::read(path)?)];
        Ok(Box::new(scene::suite_clip(&panoramas, 0, (speed, moves), [height, width], frames, self.seed)))
    }
}

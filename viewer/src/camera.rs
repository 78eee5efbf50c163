//! A simulated camera that runs live: a scene, rendered and sampled block after block.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use glam::Vec2;
use rayon::ThreadPool;

use crate::clock::CameraClock;
use pix2hdr::frame::Frame;
use pix2hdr::scene::{Rendering, Scene, render};
use pix2hdr::sensor::{Recording, Sampler, Source, Timing};
use pix2hdr::synth::live::DropPolicy;
use pix2hdr::video::Video;
use pix2hdr::{Error, Result};

/// Frames that are exposed before they are delivered together; a multiple of every built-in pattern's period.
pub const BLOCK: usize = 32;
/// When a camera drops frames.
pub const POLICY: DropPolicy = DropPolicy { block: BLOCK };
/// Instants of motion blur per frame.
const INSTANTS: usize = 2;
/// Frames, and their distance, that the anchor is taken from.
const ANCHOR_FRAMES: [usize; 2] = [4, 40];
/// How often a camera looks at its clock.
const TICK: Duration = Duration::from_millis(2);

/// A scene seen later.
struct Later<'a> {
    scene: &'a dyn Scene,
    by: f32,
}

impl Scene for Later<'_> {
    fn instant(&self, t: f32) -> Box<dyn Fn(Vec2) -> f32 + Sync + '_> {
        self.scene.instant(t + self.by)
    }
}

/// A simulated camera in front of a scene.
pub struct LiveCamera {
    scene: Box<dyn Scene>,
    sampler: Sampler,
    extent: [usize; 2],
    seed: u64,
    anchor: f32,
}

impl LiveCamera {
    /// A camera of `extent` [rows, columns] in front of `scene`. Its anchor is the 99th percentile of a few frames.
    pub fn new(scene: Box<dyn Scene>, mut sampler: Sampler, extent: [usize; 2], seed: u64) -> Result<Self> {
        // Frames are delivered when all of their exposures have ended.
        sampler.timing = Timing::Covering;
        sampler.schedule_start = 0;
        if !BLOCK.is_multiple_of(sampler.pattern().period()) {
            return Err(Error::Usage(format!(
                "a live camera wants a pattern that repeats within {BLOCK} frames; sample a video of the scene instead"
            )));
        }
        let mut camera = Self { scene, sampler, extent, seed, anchor: 1.0 };
        let [frames, apart] = ANCHOR_FRAMES;
        let mut looks = Video::black(0, extent[0], extent[1]);
        for i in 0..frames {
            looks.data.extend(camera.light(i * apart, 1).data);
            looks.frames += 1;
        }
        camera.anchor = looks.normalise();
        Ok(camera)
    }

    /// Irradiance of `frames` frames from frame `from` on.
    pub fn light(&self, from: usize, frames: usize) -> Video {
        let [height, width] = self.extent;
        let how = Rendering { frames, height, width, instants: INSTANTS, positions: 1, seed: self.seed };
        let mut video = render(&Later { scene: &*self.scene, by: from as f32 }, how, || ());
        for value in &mut video.data {
            *value = (*value / self.anchor).min(1.0);
        }
        video
    }

    /// Rows and columns.
    pub fn extent(&self) -> [usize; 2] {
        self.extent
    }

    /// Longest exposure in frames: the latency that the camera costs.
    pub fn latency(&self) -> usize {
        self.sampler.pattern().longest_readout()
    }

    /// What is known of a recording that begins with frame `from`.
    pub fn recording(&self, from: usize) -> Result<Recording> {
        let [height, width] = self.extent;
        let mut recording = self.sampler.sample(&Video::black(1, height, width))?.recording();
        recording.info.schedule_start = from as i64;
        recording.info.anchor = Some(f64::from(self.anchor));
        Ok(recording)
    }
}

/// What a run of a live camera shares with the outside.
#[derive(Clone, Debug)]
pub struct Shared<'a> {
    /// The camera's clock.
    pub clock: Arc<CameraClock>,
    /// Ends the run.
    pub stop: Arc<AtomicBool>,
    /// What renders and samples.
    pub beside: &'a ThreadPool,
}

/// Frames of a live camera from one on, until it has to drop some: a recording of its own.
pub struct LiveRun<'a> {
    camera: &'a LiveCamera,
    recording: Recording,
    shared: Shared<'a>,
    /// The frame that comes next.
    next: usize,
    /// Irradiance from frame `first` on, as much as read-outs of the next block need.
    light: VecDeque<Vec<f32>>,
    first: usize,
    /// Pixel values and irradiance of the frames from `next` on.
    ready: VecDeque<[Vec<f32>; 2]>,
    heard: Box<Hear<'a>>,
}

/// Gets number, pixel values and truth of a frame.
type Hear<'a> = dyn FnMut(usize, &[f32], &[f32]) + Send + 'a;

impl<'a> LiveRun<'a> {
    /// A run from frame `from` on, a multiple of [`BLOCK`]. `heard` gets the number, the pixel values and the truth of
    /// each frame as it is delivered.
    pub fn new(
        camera: &'a LiveCamera,
        from: usize,
        shared: Shared<'a>,
        heard: impl FnMut(usize, &[f32], &[f32]) + Send + 'a,
    ) -> Result<Self> {
        Ok(Self {
            camera,
            recording: camera.recording(from)?,
            shared,
            next: from,
            light: VecDeque::new(),
            first: from.saturating_sub(camera.latency()),
            ready: VecDeque::new(),
            heard: Box::new(heard),
        })
    }

    /// Waits until the next block is exposed; `false` if the run ends.
    fn wait(&self) -> bool {
        let Shared { clock, stop, .. } = &self.shared;
        let end = self.next + BLOCK;
        loop {
            if stop.load(Ordering::Relaxed) {
                return false;
            }
            let exposed = clock.exposed(Instant::now());
            if POLICY.is_too_late(end, exposed, clock.rate()) {
                return false;
            }
            if exposed >= end as f64 {
                return true;
            }
            std::thread::sleep(TICK);
        }
    }

    /// Samples the next block. The camera's draws do not depend on how a video is cut, so blocks fit seamlessly.
    fn sample(&mut self) -> Result<()> {
        let around = self.camera.latency();
        let before = self.next.saturating_sub(around);
        let end = self.next + BLOCK + around;
        while self.first < before {
            self.light.pop_front();
            self.first += 1;
        }
        let known = self.first + self.light.len();
        let new = self.camera.light(known, end - known);
        self.light.extend(new.data.chunks(new.frame_len()).map(<[f32]>::to_vec));
        let [height, width] = self.camera.extent;
        let data = self.light.iter().flatten().copied().collect();
        let video = Video::new(self.light.len(), height, width, data)?;
        let mut sampler = self.camera.sampler.clone();
        sampler.schedule_start = self.first as i64;
        let capture = sampler.sample(&video)?;
        for t in self.next - self.first..self.next - self.first + BLOCK {
            let mut values = vec![0.0; height * width];
            capture.pixel_values(t, &mut values);
            self.ready.push_back([values, video.frame(t).to_vec()]);
        }
        Ok(())
    }
}

impl Source for LiveRun<'_> {
    fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Nobody knows when the camera ends.
    fn frames(&self) -> Option<usize> {
        None
    }

    fn next(&mut self) -> Result<Option<Frame>> {
        if self.ready.is_empty() {
            if !self.wait() {
                return Ok(None);
            }
            self.shared.beside.install(|| self.sample())?;
        }
        let Some([mosaic, truth]) = self.ready.pop_front() else { return Ok(None) };
        (self.heard)(self.next, &mosaic, &truth);
        let frame = Frame::new(self.recording.extent(), self.next as i64, mosaic);
        self.next += 1;
        Ok(Some(frame))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pix2hdr::scene::procedural;
    use pix2hdr::sensor::{Form, Pattern};

    fn camera() -> LiveCamera {
        let sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
        LiveCamera::new(procedural::by_name("fan", 24, 32, 0).unwrap(), sampler, [24, 32], 0).unwrap()
    }

    fn pool() -> ThreadPool {
        rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap()
    }

    fn shared(beside: &ThreadPool) -> Shared<'_> {
        Shared { clock: Arc::new(CameraClock::new(Instant::now())), stop: Arc::default(), beside }
    }

    /// Block by block it is the same as one video sampled as a whole, from the first frame and from a later one.
    #[test]
    fn blocks_make_the_recording_of_the_whole() {
        let (camera, pool) = (camera(), pool());
        let truth = camera.light(0, 4 * BLOCK);
        let whole = camera.sampler.sample(&truth).unwrap().measurement();
        for from in [0, BLOCK] {
            let shared = shared(&pool);
            let mut heard = Vec::new();
            let mut run = LiveRun::new(&camera, from, shared.clone(), |number, mosaic, light| {
                heard.push((number, mosaic.to_vec(), light.to_vec()));
            })
            .unwrap();
            for t in from..from + 2 * BLOCK {
                // As if each frame had just been exposed.
                shared.clock.set((t + BLOCK) as f64, Instant::now());
                let frame = run.next().unwrap().unwrap();
                assert_eq!(frame.values(), whole.frame(t), "frame {t} of a run from {from}");
            }
            drop(run);
            assert_eq!(heard.len(), 2 * BLOCK);
            assert_eq!((heard[0].0, &heard[0].2[..]), (from, truth.frame(from)));
        }
    }

    #[test]
    fn a_camera_that_nobody_keeps_up_with_ends_its_run() {
        let (camera, pool) = (camera(), pool());
        let shared = shared(&pool);
        shared.clock.set(BLOCK as f64 + POLICY.kept(0.0) + 1.0, Instant::now());
        let mut run = LiveRun::new(&camera, 0, shared.clone(), |_, _, _| ()).unwrap();
        assert!(run.next().unwrap().is_none());
        shared.clock.set(0.0, Instant::now());
        shared.stop.store(true, Ordering::Relaxed);
        assert!(run.next().unwrap().is_none());
    }

    #[test]
    fn long_patterns_are_refused_with_the_cure() {
        let sampler = Sampler::new(Pattern::built_in("coded").unwrap(), Form::Linear).unwrap();
        let scene = procedural::by_name("fan", 24, 32, 0).unwrap();
        let period = sampler.pattern().period();
        let outcome = LiveCamera::new(scene, sampler, [24, 32], 0);
        if BLOCK.is_multiple_of(period) {
            assert!(outcome.is_ok());
        } else {
            assert!(outcome.err().unwrap().to_string().contains("sample a video"));
        }
    }
}

//! The way of a frame past the net: pixel values and truth are remembered until the result is there, and all of it goes
//! into the store together.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use rayon::ThreadPool;

use super::arrival::Arrival;
use super::status::Status;
use crate::frame::{Computed, Frame};
use crate::lock::lock;
use crate::store::{Generation, Store};
use pix2hdr::baseline::box_filter;
use pix2hdr::gpu::Results;
use pix2hdr::sensor::{Calibration, Recording, Source};
use pix2hdr::synth::ResultFrame;
use pix2hdr::video::Video;
use pix2hdr::{Error, Result};

/// Pixel values and truth of a frame that is on its way through the net.
pub(super) struct Passing {
    pub(super) number: usize,
    pub(super) mosaic: Vec<f32>,
    pub(super) truth: Option<Vec<f32>>,
}

/// Frames on their way, in order. As many as [`Synthesizer::stream`] lets wait.
pub(super) type Pending = Mutex<VecDeque<Passing>>;

/// A source whose frames are remembered until their results are there.
pub(super) struct Overheard<'a> {
    pub(super) frames: Box<dyn Source + 'a>,
    pub(super) next: usize,
    pub(super) from: usize,
    pub(super) truth: Option<&'a Arc<Video>>,
    pub(super) pending: &'a Pending,
}

impl Source for Overheard<'_> {
    fn recording(&self) -> &Recording {
        self.frames.recording()
    }

    fn frames(&self) -> Option<usize> {
        self.frames.frames()
    }

    fn next(&mut self) -> Result<Option<pix2hdr::frame::Frame>> {
        let Some(frame) = self.frames.next()? else { return Ok(None) };
        if self.next >= self.from {
            let truth = self.truth.map(|truth| truth.frame(self.next).to_vec());
            let mosaic = frame.values().to_vec();
            lock(self.pending).push_back(Passing { number: self.next, mosaic, truth });
        }
        self.next += 1;
        Ok(Some(frame))
    }
}

/// Where results go.
pub(super) struct Delivery<'a> {
    pub(super) beside: &'a ThreadPool,
    pub(super) store: &'a Store,
    pub(super) status: &'a Mutex<Status>,
    pub(super) arrival: &'a Arrival,
    /// Where results are that stay on the GPU.
    pub(super) results: Option<Arc<Results>>,
    pub(super) calibration: Calibration,
    pub(super) schedule_start: i64,
    pub(super) extent: [usize; 2],
    pub(super) generation: Generation,
    /// The number of the run's first frame.
    pub(super) begin: usize,
    /// Whether frames wait for room, instead of pushing the oldest out.
    pub(super) patient: bool,
    /// Frames delivered.
    pub(super) count: AtomicU64,
}

impl Delivery<'_> {
    /// Puts a result with all else that is known of its frame into the store.
    pub(super) fn deliver(&self, result: ResultFrame, pending: &Pending) -> Result<()> {
        let number = self.begin + result.number;
        let passing = {
            let mut pending = lock(pending);
            while pending.front().is_some_and(|passing| passing.number < number) {
                pending.pop_front();
            }
            pending.pop_front()
        };
        let t = self.schedule_start + result.number as i64;
        let on_gpu = self.results.as_ref().and_then(|results| results.take(t));
        let (mosaic, truth) = passing.map_or((None, None), |passing| (Some(passing.mosaic), passing.truth));
        let [height, width] = self.extent;
        let filtered = match &mosaic {
            Some(mosaic) => {
                let video = Video::new(1, height, width, mosaic.clone())?;
                Some(self.beside.install(|| box_filter(&video, &self.calibration, t)).data)
            }
            None => None,
        };
        let frame = Frame {
            number,
            height,
            width,
            mosaic,
            filtered,
            ours: Some(
                Arc::try_unwrap(result.frame)
                    .map_or_else(|frame| frame.values().to_vec(), pix2hdr::frame::Frame::into_values),
            ),
            on_gpu,
            truth,
            computed: result.computed.map(|(active, slab)| Computed { active, slab, cell: result.cell }),
            inference: result.inference,
        };
        lock(self.status).add(&frame);
        let kept = if self.patient {
            self.store.push_patiently(self.generation, frame)
        } else {
            self.store.push(self.generation, frame)
        };
        if !kept {
            return Err(Error::Stopped);
        }
        self.count.fetch_add(1, Ordering::Relaxed);
        self.arrival.announce();
        Ok(())
    }
}

//! Accumulation: where a scene rests, results get better the longer they are looked at.
//!
//! A net sees a hundred frames at most and believes a pixel's neighbours. But a pixel's own read-outs since it last changed
//! have a mean without bias, whose variance the noise model knows ([`readings`]). An [`accumulator`] keeps it for each
//! pixel, and the mean of the net's results besides, which serves where the pixel saturates. How far off the net is, is seen
//! in the pixels around that know better; the two are fused by precision.
//!
//! What changes must leave no ghost. Each new read-out is held against what the pixel expects, as in a Kalman filter
//! whose process noise is estimated from its innovations: what they have beyond the read-outs' noise, [`pooled`] over the
//! pixels around, is how far the scene has moved away from what is remembered, and makes memories short. Whether the net or
//! the memory is right where they differ is seen in new read-outs, too: it is the one on whose side they lie.
//!
//! A pixel that is dead is filled from its neighbours before anything sees it, and says nothing of its own; a read-out that is
//! missing counts as what it is filled by. Everything is causal: a result depends on frames up to the one in which its read-out shows, and on nothing behind.

mod accumulator;
mod pooled;
mod readings;
#[cfg(test)]
mod tests;

use crate::Result;
use crate::frame::Extent;
use crate::sensor::{Calibration, Recording};

use accumulator::Accumulator;
use readings::Readings;

/// Frames after which a memory is followed by another one, which was begun as many frames before. So no memory is older
/// than twice this, and a run that is gone on with needs no more of what came before.
pub const SUCCESSION: usize = 2048;

/// What a run remembers of the frames before.
#[derive(Debug)]
pub struct Accumulation {
    readings: Readings,
    extent: Extent,
    /// The memory that results are fused with.
    elder: Option<Accumulator>,
    /// The one that follows it.
    heir: Option<Accumulator>,
}

impl Accumulation {
    /// Of frames of `extent`, in which nothing is believed of `dead` pixels [y, x]. A camera that does not state its noise is
    /// refused.
    pub fn new(
        recording: &Recording,
        calibration: &Calibration,
        extent: Extent,
        dead: Option<Vec<bool>>,
    ) -> Result<Self> {
        let readings = Readings::new(recording, calibration, dead)?;
        Ok(Self { readings, extent, elder: None, heir: None })
    }

    /// Number of the frame with which a run has to begin that is to deliver frames from `number` on, to the bit as one that
    /// began with the first frame.
    pub fn begins(number: usize) -> usize {
        (number / SUCCESSION).saturating_sub(1) * SUCCESSION
    }

    /// Goes on to frame `number` at schedule time `t`, one behind the last one: fuses `result`, irradiance p [y, x], with
    /// what is remembered. Rows of `measured`, pixel values y, are `stride` long.
    pub fn fuse(&mut self, number: usize, t: i64, (measured, stride): (&[f32], usize), result: &mut [f32]) {
        if number.is_multiple_of(SUCCESSION) || self.elder.is_none() {
            if let Some(heir) = self.heir.take() {
                self.elder = Some(heir);
            }
            let begun = Accumulator::new(self.extent, self.readings.period());
            if self.elder.is_none() { self.elder = Some(begun) } else { self.heir = Some(begun) }
        }
        let frame = self.readings.frame(t, measured, stride, self.extent);
        if let Some(heir) = &mut self.heir {
            heir.advance(&frame, result);
        }
        if let Some(elder) = &mut self.elder {
            elder.advance(&frame, result);
            elder.fuse(result);
        }
    }
}

//! Results that stay on the GPU, for whoever draws them.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use wgpu::{BufferUsages, CommandEncoder};

use super::GpuError;
use crate::network::View;

/// The last results of the executors of a [shared](Gpu::shared) GPU, until they are taken.
///
/// A window's result is copied into a buffer of its own, on the GPU. Whoever takes a frame shares that buffer; it goes
/// with the last frame of the window.
#[derive(Debug)]
pub struct Results {
    device: wgpu::Device,
    inner: Mutex<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    wanted: bool,
    windows: VecDeque<Kept>,
}

/// A window's result [frames, rows, columns].
#[derive(Debug)]
struct Kept {
    /// Schedule time of its first frame.
    first: i64,
    frames: usize,
    extent: [usize; 2],
    buffer: wgpu::Buffer,
}

/// A result frame on the GPU: irradiance p, f32.
#[derive(Clone, Debug)]
pub struct DeviceFrame {
    /// What holds it, and other frames.
    pub buffer: wgpu::Buffer,
    /// The device that the buffer belongs to.
    pub device: wgpu::Device,
    /// Values in front of the frame's first one.
    pub offset: usize,
    /// Values from one row to the next.
    pub row: usize,
}

impl Results {
    /// None yet; they will be on `device`.
    pub(super) fn new(device: wgpu::Device) -> Self {
        Self { device, inner: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A run begins, of which results are `wanted`: every window has to be the whole of its frames then, and be taken
    /// in order.
    pub fn begin(&self, wanted: bool) {
        *self.lock() = Inner { wanted, windows: VecDeque::new() };
    }

    /// The frame at schedule time `t`. Earlier windows are forgotten. `None` if it was not kept.
    pub fn take(&self, t: i64) -> Option<DeviceFrame> {
        let mut inner = self.lock();
        let end = |kept: &Kept| kept.first + kept.frames as i64;
        while inner.windows.front().is_some_and(|kept| end(kept) <= t) {
            inner.windows.pop_front();
        }
        let Kept { first, extent: [height, width], buffer, .. } = inner.windows.front()?;
        let number = usize::try_from(t - first).ok()?;
        Some(DeviceFrame {
            buffer: buffer.clone(),
            device: self.device.clone(),
            offset: number * height * width,
            row: *width,
        })
    }

    /// Records a copy of the result that `view` shows in `slot`, whose first frame is that of schedule time `first`, into what
    /// `allocate` gives for so many bytes. A window that is computed again takes the place of what it was; values that do not
    /// lie side by side are not kept.
    pub(super) fn keep(
        &self,
        (slot, view): (&wgpu::Buffer, &View),
        first: i64,
        encoder: &mut CommandEncoder,
        allocate: impl FnOnce(u64, BufferUsages) -> Result<wgpu::Buffer, GpuError>,
    ) {
        let mut inner = self.lock();
        if !inner.wanted || view.stride != 1 {
            return;
        }
        let [frames, height, width] = view.shape.extent();
        let bytes = (4 * frames * height * width) as u64;
        match allocate(bytes, BufferUsages::STORAGE | BufferUsages::COPY_DST) {
            Ok(buffer) => {
                encoder.copy_buffer_to_buffer(slot, (4 * view.offset) as u64, &buffer, 0, bytes);
                let kept = Kept { first, frames, extent: [height, width], buffer };
                match inner.windows.iter_mut().find(|known| known.first == first) {
                    Some(known) => *known = kept,
                    None => inner.windows.push_back(kept),
                }
            }
            Err(error) => {
                tracing::warn!("results are not kept on the GPU: {error}");
                inner.wanted = false;
            }
        }
    }
}

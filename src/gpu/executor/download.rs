//! The way of values from a slot back to the CPU.

use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use wgpu::{BufferUsages, MapMode};

use super::arena::Arena;
use crate::gpu::storage::TensorFormat;
use crate::gpu::weights::loaded;
use crate::gpu::{Gpu, GpuError};
use crate::network::{Tensor, View};

/// Values on their way from a slot to the CPU.
#[derive(Debug)]
pub(super) struct Download {
    pub(super) buffer: wgpu::Buffer,
    view: View,
    format: TensorFormat,
    /// What the values are stored in.
    unit: f32,
    mapped: Receiver<Result<(), wgpu::BufferAsyncError>>,
}

/// How long another thread may take to report a finished map before it counts as failed.
pub(super) const CALLBACK_TIME: Duration = Duration::from_secs(10);

impl Arena {
    /// A buffer that the values of `view`, and `more` bytes behind them, can be copied to.
    pub(super) fn staging(&self, view: &View, more: u64) -> Result<wgpu::Buffer, GpuError> {
        let bytes = copied_bytes(view, self.formats.of(view)) + more;
        self.gpu.buffer("result", bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST)
    }

    /// Submits what is recorded, followed by a copy of `view`.
    pub(super) fn download(
        &self,
        view: View,
        buffer: wgpu::Buffer,
        mut encoder: wgpu::CommandEncoder,
    ) -> (Download, wgpu::SubmissionIndex) {
        let (format, unit) = (self.formats.of(&view), self.units.of(view.tensor));
        let offset = (view.offset * format.bytes()) as u64;
        encoder.copy_buffer_to_buffer(
            &self.slots[view.slot],
            offset,
            &buffer,
            0,
            copied_bytes(&view, format),
        );
        let submission = self.gpu.queue.submit([encoder.finish()]);
        let (sender, mapped) = mpsc::channel();
        buffer.map_async(MapMode::Read, .., move |outcome| {
            // Nobody listens if the executor is gone.
            let _ = sender.send(outcome);
        });
        (Download { buffer, view, format, unit, mapped }, submission)
    }

    /// The tensor that a view shows.
    pub(super) fn tensor(&self, view: &View) -> Result<Tensor, GpuError> {
        let encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let buffer = self.staging(view, 0)?;
        let (download, submission) = self.download(*view, buffer, encoder);
        self.gpu.wait(submission)?;
        let mut data = Vec::with_capacity(view.shape.len());
        download.read(&self.gpu, |values, _| data.extend(values))?;
        Ok(Tensor { shape: view.shape, data })
    }
}

impl Download {
    /// Shows the values without padding channels, and the bytes behind them. The submission must be done.
    pub(super) fn read(
        &self,
        gpu: &Gpu,
        visit: impl FnOnce(&mut dyn Iterator<Item = f32>, &[u8]),
    ) -> Result<(), GpuError> {
        // Where several threads wait on one device, another one may be about to make the call that reports this map.
        match self.mapped.recv_timeout(CALLBACK_TIME) {
            Ok(Ok(())) => {}
            outcome => {
                gpu.check()?;
                return Err(GpuError::Failed(format!("the result cannot be mapped: {outcome:?}")));
            }
        }
        {
            let bytes =
                self.buffer.get_mapped_range(..).map_err(|error| GpuError::Failed(error.to_string()))?;
            let (values, more) = bytes.split_at(copied_bytes(&self.view, self.format) as usize);
            let values = loaded(&values[..span(&self.view) * self.format.bytes()], self.format);
            let channels = self.view.shape.c;
            let pixels = values.chunks(self.view.stride);
            visit(&mut pixels.flat_map(|pixel| &pixel[..channels]).map(|value| value * self.unit), more);
        }
        self.buffer.unmap();
        Ok(())
    }
}

/// Values from the first pixel's first channel to the last pixel's last one.
fn span(view: &View) -> usize {
    view.shape.pixels().checked_sub(1).map_or(0, |last| last * view.stride + view.shape.c)
}

/// Bytes that are copied to read the values of `view`: copies are made in units of four bytes.
fn copied_bytes(view: &View, format: TensorFormat) -> u64 {
    (span(view) * format.bytes()).next_multiple_of(4) as u64
}

//! How long the steps of a window take, by the GPU's own clock where it has one.

use std::sync::mpsc;
use std::time::{Duration, Instant};

use wgpu::{BufferUsages, CommandEncoder, CommandEncoderDescriptor, ComputePassDescriptor, MapMode};

use super::download::CALLBACK_TIME;
use super::record::{Recorded, encode, record};
use crate::gpu::{Gpu, GpuError};
use crate::network::WindowTime;

/// Bytes of a time stamp.
const STAMP: usize = size_of::<u64>();

/// Computes `steps` `windows` times, in one submission.
pub(super) fn time_windows(gpu: &Gpu, steps: &[Recorded], windows: usize) -> Result<WindowTime, GpuError> {
    let stamps = Stamps::new(gpu, 1)?;
    let begun = Instant::now();
    let mut encoder = encoder(gpu);
    {
        let mut pass = encoder.begin_compute_pass(&pass(stamps.as_ref(), 0));
        for _ in 0..windows {
            record(&mut pass, steps);
        }
    }
    if let Some(stamps) = &stamps {
        stamps.resolve(&mut encoder);
    }
    let submission = gpu.queue.submit([encoder.finish()]);
    gpu.wait(submission)?;
    let wall = begun.elapsed();
    let device = stamps.map(|stamps| stamps.read(gpu)).transpose()?.map(|times| times[0]);
    Ok(WindowTime { wall, device })
}

/// Time of each step: on the device's clock, else from submission to completion.
pub(super) fn time_steps(gpu: &Gpu, steps: &[Recorded]) -> Result<Vec<Duration>, GpuError> {
    let Some(stamps) = Stamps::new(gpu, steps.len())? else {
        let time = |step| {
            let begun = Instant::now();
            let mut encoder = encoder(gpu);
            encode(step, &mut encoder);
            let submission = gpu.queue.submit([encoder.finish()]);
            gpu.wait(submission).map(|()| begun.elapsed())
        };
        return steps.chunks(1).map(time).collect();
    };
    let mut encoder = encoder(gpu);
    for (index, step) in steps.chunks(1).enumerate() {
        record(&mut encoder.begin_compute_pass(&pass(Some(&stamps), index)), step);
    }
    stamps.resolve(&mut encoder);
    let submission = gpu.queue.submit([encoder.finish()]);
    gpu.wait(submission)?;
    stamps.read(gpu)
}

fn encoder(gpu: &Gpu) -> CommandEncoder {
    gpu.device.create_command_encoder(&CommandEncoderDescriptor::default())
}

/// A compute pass that takes the two stamps number `index`.
fn pass(stamps: Option<&Stamps>, index: usize) -> ComputePassDescriptor<'_> {
    ComputePassDescriptor {
        label: None,
        timestamp_writes: stamps.map(|stamps| wgpu::ComputePassTimestampWrites {
            query_set: &stamps.queries,
            beginning_of_pass_write_index: Some(2 * index as u32),
            end_of_pass_write_index: Some(2 * index as u32 + 1),
        }),
    }
}

/// Time stamps at the begin and end of several passes.
struct Stamps {
    queries: wgpu::QuerySet,
    passes: usize,
    resolved: wgpu::Buffer,
    readable: wgpu::Buffer,
}

impl Stamps {
    /// None where the device has no clock, or cannot take that many stamps at once.
    fn new(gpu: &Gpu, passes: usize) -> Result<Option<Self>, GpuError> {
        let there = gpu.device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        if !there || 2 * passes > wgpu::QUERY_SET_MAX_QUERIES as usize {
            return Ok(None);
        }
        let queries = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("time stamps"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * passes as u32,
        });
        let buffer =
            |usage| gpu.buffer("time stamps", (2 * passes * STAMP) as u64, usage | BufferUsages::COPY_DST);
        let resolved = buffer(BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC)?;
        let readable = buffer(BufferUsages::MAP_READ)?;
        Ok(Some(Self { queries, passes, resolved, readable }))
    }

    fn resolve(&self, encoder: &mut CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..2 * self.passes as u32, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.readable, 0, self.readable.size());
    }

    /// Time of each pass, once the submission is done.
    fn read(self, gpu: &Gpu) -> Result<Vec<Duration>, GpuError> {
        let (sender, mapped) = mpsc::channel();
        self.readable.map_async(MapMode::Read, .., move |outcome| {
            // Nobody listens if reading has failed already.
            let _ = sender.send(outcome);
        });
        let submission = gpu.queue.submit([]);
        gpu.wait(submission)?;
        let failed = |problem: String| GpuError::Failed(format!("time stamps cannot be read: {problem}"));
        match mapped.recv_timeout(CALLBACK_TIME) {
            Ok(Ok(())) => {}
            outcome => {
                gpu.check()?;
                return Err(failed(format!("{outcome:?}")));
            }
        }
        let bytes = self.readable.get_mapped_range(..).map_err(|error| failed(error.to_string()))?;
        let stamps: Vec<u64> =
            bytes.as_chunks::<STAMP>().0.iter().map(|&bytes| u64::from_le_bytes(bytes)).collect();
        let period = f64::from(gpu.queue.get_timestamp_period());
        // Nanoseconds. A clock that steps back says nothing.
        let time =
            |pair: &[u64]| Duration::from_secs_f64(1e-9 * period * pair[1].saturating_sub(pair[0]) as f64);
        Ok(stamps.chunks_exact(2).map(time).collect())
    }
}

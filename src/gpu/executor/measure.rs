//! Which variant of a convolution is fastest here.

use std::ops::Range;
use std::time::{Duration, Instant};

use wgpu::{BufferUsages, MapMode};

use super::options::ExecutorOptions;
use super::record::{Builder, Recorded, encode};
use crate::gpu::tune::Tuning;
use crate::gpu::variant::Variant;
use crate::gpu::weights::{loaded, stored};
use crate::gpu::{Gpu, GpuError};
use crate::network::Step;
use crate::system::Trials;

/// Bytes of its output in which variants of a convolution have to agree.
const COMPARED_BYTES: usize = 1 << 22;

/// Operations from which on a convolution is worth measuring.
const WORTH_TUNING: f64 = 2e7;

/// The variant of a step: the one that the options want, or the fastest one where that is worth measuring.
pub(super) fn variant(
    builder: &Builder<'_>,
    index: usize,
    step: &Step,
    options: &ExecutorOptions<'_>,
    tuning: Option<&mut Tuning>,
) -> Result<Option<Variant>, GpuError> {
    match (options.variant, tuning) {
        (None, Some(tuning)) if step.flop() >= WORTH_TUNING => fastest(builder, index, step, tuning),
        (variant, _) => Ok(variant),
    }
}

/// The fastest variant of a convolution, if there was time to find it.
fn fastest(
    builder: &Builder<'_>,
    index: usize,
    step: &Step,
    tuning: &mut Tuning,
) -> Result<Option<Variant>, GpuError> {
    let gpu = builder.gpu.clone();
    let chosen = builder.dispatch(step, None)?;
    // Its shader and its size.
    let layer = format!("{}{:?}", chosen.shader.text, chosen.shader.uniform());
    let Some(extent) = chosen.extent else { return Ok(None) };
    let candidates = Variant::candidates(extent, gpu.abilities());
    let [read, written] = [&step.inputs[0], &step.output].map(|view| builder.formats.of(view));
    let (input, output) = (step.inputs[0].slot, step.output.slot);
    let mut expected: Option<Vec<f32>> = None;
    let variant = tuning.variant(&gpu, &layer, &candidates, |variant| {
        if expected.is_none() {
            let count = builder.formats.slot_bytes[input] / read.bytes();
            let values: Vec<f32> = (0..count).map(|i| (i * 7 % 31) as f32 / 31.0 - 0.5).collect();
            gpu.queue.write_buffer(&builder.buffers.slots[input], 0, &stored(&values, read));
        }
        let recorded = builder.bind(index, step, &builder.dispatch(step, Some(variant))?)?;
        // Or a variant that writes nothing would show what the one before it wrote.
        clear(&gpu, [&builder.buffers.slots[output]]);
        let time = time(&gpu, &recorded)?;
        // Not every driver may number the invocations of a subgroup as teams want it.
        let begin = step.output.offset * written.bytes();
        let end = builder.formats.slot_bytes[output].min(begin + COMPARED_BYTES);
        let result = loaded(&read_back(&gpu, &builder.buffers.slots[output], begin..end)?, written);
        let same = expected.as_ref().is_none_or(|expected| agree(expected, &result));
        expected.get_or_insert(result);
        Ok::<_, GpuError>(same.then_some(time))
    })?;
    if expected.is_some() {
        clear(&gpu, [&builder.buffers.slots[input], &builder.buffers.slots[output]]);
    }
    Ok(variant)
}

/// Time of one dispatch of a step.
fn time(gpu: &Gpu, step: &Recorded) -> Result<Duration, GpuError> {
    const TRIALS: Trials =
        Trials { long_enough: Duration::from_millis(3), careful: 2, least: 3, patience: Duration::ZERO };
    let rate = TRIALS.rate(|count| {
        let begun = Instant::now();
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for _ in 0..count {
            encode(std::slice::from_ref(step), &mut encoder);
        }
        gpu.wait(gpu.queue.submit([encoder.finish()]))?;
        Ok::<_, GpuError>(begun.elapsed())
    })?;
    Ok(Duration::from_secs_f64(rate.recip()))
}

/// Fills buffers with zeros.
fn clear<const N: usize>(gpu: &Gpu, buffers: [&wgpu::Buffer; N]) {
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    for buffer in buffers {
        encoder.clear_buffer(buffer, 0, None);
    }
    gpu.queue.submit([encoder.finish()]);
}

/// Some bytes of a buffer, from a multiple of 4 to another.
fn read_back(gpu: &Gpu, buffer: &wgpu::Buffer, range: Range<usize>) -> Result<Vec<u8>, GpuError> {
    let bytes = range.len() as u64;
    let copy = gpu.buffer("result", bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, range.start as u64, &copy, 0, bytes);
    let submission = gpu.queue.submit([encoder.finish()]);
    copy.map_async(MapMode::Read, .., |_| {});
    gpu.wait(submission)?;
    let values = copy.get_mapped_range(..).map_err(|error| GpuError::Failed(error.to_string()))?;
    Ok(values.to_vec())
}

/// Whether two variants computed the same, but for rounding.
fn agree(a: &[f32], b: &[f32]) -> bool {
    const TOLERANCE: f32 = 2e-3;
    let scale = a.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= TOLERANCE * scale)
}

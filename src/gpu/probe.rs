//! What an adapter can do at most: operations and copied bytes per second, measured.
//!
//! Each probe repeats its work in one submission until that takes long enough ([`TRIALS`]), so that the way to the device does
//! not count, and keeps the fastest of several submissions.

use std::time::{Duration, Instant};

use wgpu::BufferUsages;

use super::shader::table::file;
use super::shader::{Parameters, dump, specialise};
use super::{Gpu, GpuError};
use crate::system::Trials;

const WORKGROUP_SIZE: usize = 256;
const TRIALS: Trials =
    Trials { long_enough: Duration::from_millis(10), careful: 3, least: 20, patience: Duration::ZERO };
/// Bytes of a vec4<f32>.
const VECTOR: usize = 16;

/// Vectors of sums that an invocation of the probe keeps: few where registers are few, more where it takes many
/// independent operations to keep the units busy. The fastest counts.
const ACCUMULATORS: [usize; 3] = [2, 4, 8];
/// Multiply-adds on each accumulator in one turn of the loop.
const ROUNDS: usize = 16;
/// Invocations of the probe: more than a large GPU runs at once.
const INVOCATIONS: usize = 1 << 19;

/// Bytes that are copied at once: more than caches hold.
const COPIED_BYTES: usize = 128 << 20;
const COPIED_BYTES_SOFTWARE: usize = 64 << 20;

impl Gpu {
    /// Operations per second at f32, two for each multiply-add, as a loop of nothing else reaches them.
    pub fn measure_flop_rate(&self) -> Result<f64, GpuError> {
        let output = self.buffer("probe", (INVOCATIONS * VECTOR) as u64, BufferUsages::STORAGE)?;
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let parameters = self.buffer("probe", 3 * VECTOR as u64, usage)?;
        let mut best: f64 = 0.0;
        for accumulators in ACCUMULATORS {
            let mut values = Parameters::default();
            values.set("accumulators", accumulators);
            values.set("rounds", ROUNDS);
            let probe = Probe::new(self, "probe_fma", values, [&parameters, &output])?;
            let flop = (2 * 4 * accumulators * ROUNDS * INVOCATIONS) as f64;
            let rate = TRIALS.rate(|times| {
                let (x, y) = (0.999_f32, 0.001_f32);
                let values = [[x.to_bits(); 4], [y.to_bits(); 4], [times; 4]];
                self.queue.write_buffer(&parameters, 0, bytemuck::cast_slice(&values));
                probe.time(INVOCATIONS / WORKGROUP_SIZE, 1)
            })?;
            best = best.max(flop * rate);
        }
        Ok(best)
    }

    /// Bytes per second that a kernel copies from one buffer to another, those read and those written together.
    pub fn measure_copy_rate(&self) -> Result<f64, GpuError> {
        let wanted = if self.adapter().is_software() { COPIED_BYTES_SOFTWARE } else { COPIED_BYTES };
        // A power of two that a kernel can see at once.
        let bytes = (wanted as u64).min(1 << self.largest_binding().ilog2()) as usize;
        let buffer = || self.buffer("probe", bytes as u64, BufferUsages::STORAGE);
        let probe = Probe::new(self, "probe_copy", Parameters::default(), [&buffer()?, &buffer()?])?;
        let rate = TRIALS.rate(|times| probe.time(bytes / VECTOR / WORKGROUP_SIZE, times))?;
        Ok(2.0 * bytes as f64 * rate)
    }
}

/// A pipeline with its two buffers.
struct Probe<'a> {
    gpu: &'a Gpu,
    pipeline: wgpu::ComputePipeline,
    bind_group: wgpu::BindGroup,
}

impl<'a> Probe<'a> {
    fn new(
        gpu: &'a Gpu,
        name: &str,
        mut parameters: Parameters,
        buffers: [&wgpu::Buffer; 2],
    ) -> Result<Self, GpuError> {
        let device = &gpu.device;
        let entry = |binding: u32, read_only| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(name),
            entries: &[entry(0, true), entry(1, false)],
        });
        parameters.set("workgroup_size", WORKGROUP_SIZE);
        let shader = specialise(file(&format!("{name}.wgsl")), &parameters);
        dump(&[name], &shader);
        let pipeline = gpu.pipeline(name, &shader.text, |device| {
            device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(name),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            })
        })?;
        let entries = [0, 1].map(|binding| wgpu::BindGroupEntry {
            binding: binding as u32,
            resource: buffers[binding].as_entire_binding(),
        });
        let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(name),
            layout: &layout,
            entries: &entries,
        });
        Ok(Self { gpu, pipeline, bind_group })
    }

    /// Time of one submission of `dispatches`.
    fn time(&self, workgroups: usize, dispatches: u32) -> Result<Duration, GpuError> {
        let begun = Instant::now();
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.bind_group, &[]);
            for _ in 0..dispatches {
                pass.dispatch_workgroups(workgroups as u32, 1, 1);
            }
        }
        let submission = self.gpu.queue.submit([encoder.finish()]);
        self.gpu.wait(submission)?;
        Ok(begun.elapsed())
    }
}

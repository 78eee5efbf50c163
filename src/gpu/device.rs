//! An open GPU: buffers, pipelines and failures.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use wgpu::{BufferUsages, ErrorFilter, Features, PollError, PollStatus, PollType};

use super::dispatch::WORKGROUP_SIZE;
use super::pipelines::Pipelines;
use super::variant::{Abilities, Variant};
use super::{Adapter, AdapterChoice, GpuError, Results};

/// Bytes that the executor may add to a slot: the zeros of one pixel of padding (`TensorFormats::zeros_bytes`).
const MAX_ZEROS: u64 = 1 << 16;
/// How often a device that is shared with a window is asked whether a window of frames is done.
const GLANCE: Duration = Duration::from_micros(200);

/// An open GPU. Cheap to clone; the clones share device and queue.
#[derive(Clone, Debug)]
pub struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    adapter: Arc<Adapter>,
    opened: Arc<(wgpu::Instance, wgpu::Adapter)>,
    failures: Arc<Failures>,
    pipelines: Arc<Pipelines>,
    /// Where executors keep results, if somebody draws them with this device.
    results: Option<Arc<Results>>,
}

/// What the driver reports outside of calls.
#[derive(Debug, Default)]
struct Failures {
    lost: OnceLock<String>,
    first: Mutex<Option<GpuError>>,
}

impl Gpu {
    /// Opens the adapter of `choice`, with all of its limits.
    pub fn open(choice: &AdapterChoice) -> Result<Self, GpuError> {
        let (instance, wgpu_adapter, adapter) = choice.find()?;
        let request = wgpu_adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("pix2hdr"),
            // Time stamps for benchmarks; each of the others makes some kernels faster.
            required_features: wgpu_adapter.features()
                & (Features::TIMESTAMP_QUERY | Features::SUBGROUP | Features::SHADER_INT64),
            required_limits: wgpu_adapter.limits(),
            ..Default::default()
        });
        let (device, queue) = pollster::block_on(request)
            .map_err(|e| GpuError::Open { adapter: adapter.name.clone(), problem: e.to_string() })?;
        let failures = Arc::new(Failures::default());
        device.set_device_lost_callback({
            let failures = Arc::clone(&failures);
            move |reason, message| {
                // Only the first loss counts.
                let _ = failures.lost.set(format!("{message} ({reason:?})"));
            }
        });
        device.on_uncaptured_error({
            let failures = Arc::clone(&failures);
            Arc::new(move |error: wgpu::Error| {
                let error = match error {
                    wgpu::Error::OutOfMemory { .. } => {
                        GpuError::OutOfMemory { what: "a transfer".into(), bytes: 0 }
                    }
                    other => GpuError::Failed(other.to_string()),
                };
                failures.first.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
            })
        });
        let opened = Arc::new((instance, wgpu_adapter));
        let pipelines = Arc::default();
        Ok(Self { device, queue, adapter: Arc::new(adapter), opened, failures, pipelines, results: None })
    }

    /// The same GPU for somebody who draws results with it: executors keep them in [`Gpu::results`], and none of them
    /// holds a lock of the device while it waits, which presenting a picture would wait for.
    #[must_use]
    pub fn shared(&self) -> Self {
        Self { results: Some(Arc::new(Results::new(self.device.clone()))), ..self.clone() }
    }

    /// What executors have kept, if the GPU is [`Gpu::shared`].
    pub fn results(&self) -> Option<&Arc<Results>> {
        self.results.as_ref()
    }

    /// What it consists of, to draw with.
    pub fn parts(&self) -> (wgpu::Instance, wgpu::Adapter, wgpu::Device, wgpu::Queue) {
        let (instance, adapter) = &*self.opened;
        (instance.clone(), adapter.clone(), self.device.clone(), self.queue.clone())
    }

    /// The adapter that is open.
    pub fn adapter(&self) -> &Adapter {
        &self.adapter
    }

    /// Name of the adapter, with its backend.
    pub fn name(&self) -> String {
        format!("{}: {}", self.adapter.backend, self.adapter.name)
    }

    /// Bytes of the largest slot that a plan may have here.
    pub fn largest_binding(&self) -> u64 {
        self.max_binding().saturating_sub(MAX_ZEROS)
    }

    /// Bytes of the largest buffer that a kernel can use: shaders know lengths of 32 bits.
    fn max_binding(&self) -> u64 {
        let Adapter { max_binding_bytes, max_buffer_bytes, .. } = *self.adapter;
        max_binding_bytes.min(max_buffer_bytes).min(u64::from(u32::MAX) & !15)
    }

    /// Whether convolutions can be divided in a given way here.
    pub fn supports(&self, variant: Variant) -> bool {
        let Abilities { subgroup, int64, .. } = self.abilities();
        let Variant { pixels, vectors, lanes, wide } = variant;
        let sums = pixels.saturating_mul(vectors);
        (1..=Variant::MAX_SUMS).contains(&sums) && (lanes == 1 || lanes == subgroup) && (int64 || !wide)
    }

    /// What kernels can make use of.
    pub(super) fn abilities(&self) -> Abilities {
        let [smallest, largest] = self.adapter.subgroup_sizes;
        let fixed = self.adapter.subgroups && smallest == largest;
        // Lanes are told apart by a workgroup's invocation numbers.
        let subgroup =
            if fixed && WORKGROUP_SIZE.is_multiple_of(largest.max(1) as usize) { largest } else { 1 };
        Abilities {
            software: self.adapter.is_software(),
            subgroup: subgroup.max(1) as usize,
            int64: self.device.features().contains(Features::SHADER_INT64),
            max_workgroups: self.device.limits().max_compute_workgroups_per_dimension,
        }
    }

    /// Gives the device up. Whatever still uses it fails with [`GpuError::Lost`].
    pub fn destroy(&self) {
        self.device.destroy();
    }

    /// Why the device is gone, if it is, whether or not something has been tried with it.
    pub fn lost(&self) -> Option<String> {
        // A loss is reported while polling.
        if self.failures.lost.get().is_none() {
            let _ = self.poll(PollType::Poll);
        }
        self.check().err().filter(GpuError::is_lost).map(|error| error.to_string())
    }

    /// Polls the device; `None` if it is lost. Where the driver says so, and nobody gave the device up, wgpu panics.
    fn poll(&self, how: PollType) -> Option<Result<PollStatus, PollError>> {
        let polled = catch_unwind(AssertUnwindSafe(|| self.device.poll(how)));
        polled
            .inspect_err(|_| {
                let _ = self.failures.lost.set("the driver does not answer any more".into());
            })
            .ok()
    }

    /// Fails if anything has failed since the device was opened. A lost device comes first, since everything else
    /// fails after it.
    pub fn check(&self) -> Result<(), GpuError> {
        if let Some(reason) = self.failures.lost.get() {
            return Err(GpuError::Lost(reason.clone()));
        }
        let first = self.failures.first.lock().unwrap_or_else(PoisonError::into_inner);
        first.clone().map_or(Ok(()), Err)
    }

    /// A buffer of `bytes` bytes, zero at first, that a kernel or a transfer can use for `usage`.
    pub(super) fn buffer(
        &self,
        what: &str,
        bytes: u64,
        usage: BufferUsages,
    ) -> Result<wgpu::Buffer, GpuError> {
        self.check()?;
        let limits = self.device.limits();
        let kernels = BufferUsages::STORAGE | BufferUsages::UNIFORM;
        let limit = if usage.intersects(kernels) { self.max_binding() } else { limits.max_buffer_size };
        if bytes > limit {
            return Err(GpuError::TooLarge { what: what.to_owned(), bytes, limit });
        }
        let out_of_memory = self.device.push_error_scope(ErrorFilter::OutOfMemory);
        let invalid = self.device.push_error_scope(ErrorFilter::Validation);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size: bytes,
            usage,
            mapped_at_creation: false,
        });
        let invalid = pollster::block_on(invalid.pop());
        let out_of_memory = pollster::block_on(out_of_memory.pop());
        self.check()?;
        if out_of_memory.is_some() {
            return Err(GpuError::OutOfMemory { what: what.to_owned(), bytes });
        }
        match invalid {
            Some(error) => Err(GpuError::Failed(format!("{what}: {error}"))),
            None => Ok(buffer),
        }
    }

    /// A buffer that kernels read, filled with `values`; at least 16 bytes.
    pub(super) fn storage<T: bytemuck::NoUninit>(
        &self,
        what: &str,
        values: &[T],
    ) -> Result<wgpu::Buffer, GpuError> {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let buffer = self.buffer(what, (bytes.len() as u64).max(16), usage)?;
        self.queue.write_buffer(&buffer, 0, bytes);
        Ok(buffer)
    }

    /// A compute pipeline with the only entry point of `source`, which is compiled once. A step that is computed by it gives
    /// it its name.
    pub(super) fn pipeline(
        &self,
        step: &str,
        source: &str,
        layout: impl FnOnce(&wgpu::Device) -> wgpu::PipelineLayout,
    ) -> Result<wgpu::ComputePipeline, GpuError> {
        self.pipelines.get(source, || self.compile(step, source, &layout(&self.device)))
    }

    fn compile(
        &self,
        step: &str,
        source: &str,
        layout: &wgpu::PipelineLayout,
    ) -> Result<wgpu::ComputePipeline, GpuError> {
        self.check()?;
        let internal = self.device.push_error_scope(ErrorFilter::Internal);
        let invalid = self.device.push_error_scope(ErrorFilter::Validation);
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(step),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(step),
            layout: Some(layout),
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        });
        let invalid = pollster::block_on(invalid.pop());
        let internal = pollster::block_on(internal.pop());
        self.check()?;
        match invalid.or(internal) {
            Some(error) => Err(GpuError::Shader { step: step.to_owned(), problem: error.to_string() }),
            None => Ok(pipeline),
        }
    }

    /// Waits until `submission` is done.
    pub(super) fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<(), GpuError> {
        let poll =
            |submission, timeout| self.poll(PollType::Wait { submission_index: Some(submission), timeout });
        let waited = match self.results {
            None => poll(submission, None),
            Some(_) => loop {
                match poll(submission.clone(), Some(Duration::ZERO)) {
                    Some(Err(PollError::Timeout)) => std::thread::sleep(GLANCE),
                    done => break done,
                }
            },
        };
        if waited.as_ref().is_some_and(Result::is_err) {
            // A loss is reported while polling.
            let _ = self.poll(PollType::Poll);
        }
        self.check()?;
        match waited {
            Some(Err(error)) => Err(GpuError::Failed(error.to_string())),
            _ => Ok(()),
        }
    }
}

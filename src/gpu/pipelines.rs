//! Pipelines by their text, each compiled once for a device.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use super::GpuError;

/// The compute pipelines of a device. Layers that differ in their weights or in the size of their windows alone share one,
/// and so do executors.
#[derive(Debug, Default)]
pub(super) struct Pipelines(Mutex<HashMap<String, wgpu::ComputePipeline>>);

impl Pipelines {
    /// The pipeline of a shader, compiled if there is none yet.
    pub fn get(
        &self,
        text: &str,
        compile: impl FnOnce() -> Result<wgpu::ComputePipeline, GpuError>,
    ) -> Result<wgpu::ComputePipeline, GpuError> {
        let mut pipelines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pipeline) = pipelines.get(text) {
            return Ok(pipeline.clone());
        }
        let pipeline = compile()?;
        pipelines.insert(text.to_owned(), pipeline.clone());
        Ok(pipeline)
    }
}

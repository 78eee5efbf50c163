//! A graph with its tensors, read from and written to weights files.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use half::f16;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde_json::Value;

use super::error::NetworkError;
use super::graph::Graph;
use super::kernel::{Convolution, Direction, Layer};
use super::presets;
use crate::fingerprint::{Fingerprint, Fingerprinted};
use crate::math::fnv_1a;
use crate::sensor::Pattern;
use crate::video::ending;
use crate::{At, Error, Result};

/// Value of the metadata key `format`.
const FORMAT: &str = "pix2hdr-weights/1";

/// Largest weights file that is read: a bound on what a hostile file can make us allocate.
const MAX_FILE: u64 = 1 << 30;

/// A net that can be lowered: graph and tensors.
#[derive(Clone, Debug)]
pub struct Model {
    /// The operations.
    pub graph: Graph,
    /// Tensors of each convolution, by node.
    pub layers: HashMap<String, Arc<Layer>>,
    /// What the weights were trained for and how.
    pub trained: Trained,
}

/// What is known about the training.
#[derive(Clone, Debug, PartialEq)]
pub struct Trained {
    /// The response that the net was trained for, as in `capture.json`, or "any".
    pub response: Value,
    /// Data, seed, steps, hours, hardware, scores.
    pub provenance: Value,
}

impl Fingerprinted for Model {
    fn mark(&self, fingerprint: &mut Fingerprint) -> Result<()> {
        fingerprint.note("net", &self.graph.name)?;
        fingerprint.note("weights_digest", self.digest())
    }
}

impl Model {
    /// Reads a weights file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut bytes = Vec::new();
        let file = File::open(path).at(path)?;
        if !file.metadata().at(path)?.is_file() {
            return Err(Error::from(NetworkError::Format("not a file".into())).at(path));
        }
        file.take(MAX_FILE + 1).read_to_end(&mut bytes).at(path)?;
        if bytes.len() as u64 > MAX_FILE {
            let problem = format!("more than the {MAX_FILE} bytes that a weights file may have");
            return Err(Error::from(NetworkError::Format(problem)).at(path));
        }
        Self::from_bytes(&bytes).at(path)
    }

    /// A weights file by its path, or a built-in preset by its name.
    pub fn load(name: &str) -> Result<Self> {
        if Path::new(name).is_file() || ending(Path::new(name)) == "safetensors" {
            return Self::read(name);
        }
        Ok(Self::from_bytes(presets::by_name(name)?.weights()?)?)
    }

    /// A weights file or preset for captures of `pattern`; `fast` stands for `fast-1-8` where only that one fits.
    pub fn load_for(name: &str, pattern: &Pattern) -> Result<Self> {
        let model = Self::load(name)?;
        let Err(refusal) = model.check_pattern(pattern) else { return Ok(model) };
        let variant = format!("{name}-");
        for preset in presets::all().into_iter().filter(|preset| preset.trained) {
            if preset.name.starts_with(&variant) {
                let model = Self::load(preset.name)?;
                if model.check_pattern(pattern).is_ok() {
                    return Ok(model);
                }
            }
        }
        Err(refusal)
    }

    /// Checks that the net was made for `pattern`: any, a built-in one that samples alike, or one of that name.
    pub fn check_pattern(&self, pattern: &Pattern) -> Result<()> {
        let made_for = &self.graph.pattern;
        let fits = match Pattern::built_in(made_for) {
            Ok(known) => known.samples_like(pattern),
            Err(_) => made_for == "any" || made_for == pattern.name(),
        };
        if fits {
            return Ok(());
        }
        let name = &self.graph.name;
        Err(Error::Usage(format!("weights '{name}' are for pattern {made_for}, not for {}", pattern.name())))
    }

    /// Reads a weights file from memory.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, NetworkError> {
        let format = |problem: String| NetworkError::Format(problem);
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| format(e.to_string()))?;
        let metadata = header.metadata().clone().unwrap_or_default();
        let entry = |key: &str| {
            metadata.get(key).ok_or_else(|| NetworkError::Format(format!("its metadata lacks '{key}'")))
        };
        if entry("format")? != FORMAT {
            return Err(format(format!(
                "its format is '{}', this program reads '{FORMAT}'",
                entry("format")?
            )));
        }
        let json = |key: &str| -> Result<Value, NetworkError> {
            serde_json::from_str(entry(key)?).map_err(|e| format(format!("metadata '{key}': {e}")))
        };
        let graph = Graph::from_json(entry("graph")?)?;
        let trained = Trained { response: json("response")?, provenance: json("provenance")? };
        let file = SafeTensors::deserialize(bytes).map_err(|e| format(e.to_string()))?;
        let mut tensors: HashMap<String, TensorView<'_>> = file.tensors().into_iter().collect();
        let mut layers = HashMap::new();
        for (name, specs) in layer_shapes(&graph)? {
            let mut read: Vec<Vec<f32>> = Vec::new();
            for (suffix, shape) in &specs {
                let tensor = format!("{name}.{suffix}");
                let view = tensors.remove(&tensor).ok_or_else(|| NetworkError::Tensor {
                    tensor: tensor.clone(),
                    problem: format!("missing; the graph wants it as {shape:?}"),
                })?;
                read.push(values(&view, shape).map_err(|problem| NetworkError::Tensor { tensor, problem })?);
            }
            layers.insert(name.to_owned(), Arc::new(Layer::from_parts(read)));
        }
        if let Some(name) = tensors.keys().min() {
            return Err(NetworkError::Tensor {
                tensor: name.clone(),
                problem: "the graph has no use for it".into(),
            });
        }
        Ok(Self { graph, layers, trained })
    }

    /// The same graph with random weights of a spread that keeps activations near unit size: for benchmarks
    /// and tests, which do not care what a net was trained for.
    pub fn random(graph: Graph, seed: u64) -> Result<Self, NetworkError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut layers = HashMap::new();
        for (name, specs) in layer_shapes(&graph)? {
            let parts = specs.iter().map(|(suffix, shape)| {
                let len: usize = shape.iter().product();
                let fan_in = if *suffix == "weight" { len / shape[0].max(1) } else { 100 };
                let spread = (3.0 / fan_in.max(1) as f32).sqrt();
                let center = if *suffix == "scale" { 1.0 } else { 0.0 };
                (0..len).map(|_| center + rng.random_range(-spread..spread)).collect()
            });
            layers.insert(name.to_owned(), Arc::new(Layer::from_parts(parts.collect())));
        }
        let trained = Trained { response: "any".into(), provenance: serde_json::json!({"random": seed}) };
        Ok(Self { graph, layers, trained })
    }

    /// A number that differs between models with different graphs or weights (FNV-1a).
    pub fn digest(&self) -> u64 {
        let mut layers: Vec<_> = self.layers.iter().collect();
        layers.sort_by_key(|(name, _)| *name);
        let values = layers.into_iter().flat_map(|(_, layer)| {
            let norm = layer.norm.iter().flat_map(|(scale, shift)| scale.iter().chain(shift));
            layer.weight.iter().chain(&layer.bias).chain(norm)
        });
        let graph = serde_json::to_vec(&self.graph).unwrap_or_default();
        let bytes = graph.into_iter().chain(values.flat_map(|value| value.to_le_bytes()));
        fnv_1a(bytes)
    }

    /// Number of values in all tensors.
    pub fn parameters(&self) -> usize {
        let norm = |layer: &Layer| layer.norm.as_ref().map_or(0, |(a, b)| a.len() + b.len());
        self.layers.values().map(|layer| layer.weight.len() + layer.bias.len() + norm(layer)).sum()
    }
}

impl Layer {
    /// Weight, bias and, if there are four parts, scale and shift.
    fn from_parts(parts: Vec<Vec<f32>>) -> Self {
        let mut parts = parts.into_iter();
        let mut next = || parts.next();
        let (weight, bias) = (next().unwrap_or_default(), next().unwrap_or_default());
        Self { weight, bias, norm: next().zip(next()) }
    }
}

/// Suffixes and shapes of a layer's tensors.
type Specs = Vec<(&'static str, Vec<usize>)>;

/// Names, suffixes and shapes of all tensors that a graph needs, by node.
fn layer_shapes(graph: &Graph) -> Result<BTreeMap<&str, Specs>, NetworkError> {
    let [_, y, x] = graph.granularity()?;
    let shapes = graph.shapes(y, x)?;
    let specs = |(conv, direction): (&Convolution, Direction), input: usize| {
        let [kt, ky, kx] = conv.kernel;
        let out = conv.out_channels;
        let [rows, columns] = match direction {
            Direction::Forward => [out, input],
            Direction::Transposed => [input, out],
        };
        let mut specs = vec![("weight", vec![rows, columns, kt, ky, kx]), ("bias", vec![out])];
        if conv.norm {
            specs.extend([("scale", vec![out]), ("shift", vec![out])]);
        }
        specs
    };
    let convolutions = graph.nodes.iter().filter_map(|node| {
        let input = shapes[node.inputs[0].as_str()].c;
        Some((node.name.as_str(), specs(node.operation().convolution()?, input)))
    });
    Ok(convolutions.collect())
}

/// The values of a tensor as f32, checked.
fn values(view: &TensorView<'_>, shape: &[usize]) -> Result<Vec<f32>, String> {
    if view.shape() != shape {
        return Err(format!("its shape is {:?}, the graph wants {shape:?}", view.shape()));
    }
    let bytes = view.data();
    let values: Vec<f32> = match view.dtype() {
        Dtype::F32 => bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
        Dtype::F16 => bytes.as_chunks().0.iter().map(|&b| f16::from_le_bytes(b).to_f32()).collect(),
        other => return Err(format!("its type is {other:?}; F32 and F16 are read")),
    };
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(format!("value {at} is {}", values[at])),
        None => Ok(values),
    }
}

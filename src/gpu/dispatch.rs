//! A step of a plan as what a GPU is given: a shader with its values, what it is bound to, and how often it runs.

use super::GpuError;
use super::shader::bindings::{self, KernelShader};
use super::shader::{Parameters, Shader, Value, specialise};
use super::storage::{LARGEST_F16, TensorFormat, TensorFormats};
use super::variant::{Abilities, Extent, Variant};
use super::weights::{Packing, Terms, pack, stored, weight_units};
use crate::network::{Activation, ConvolutionStep, Direction, Parameter, Step, View};
use crate::sensor::Calibration;

/// Invocations of a workgroup.
pub(super) const WORKGROUP_SIZE: usize = 64;

/// A step, ready to be compiled and recorded.
#[derive(Clone, Debug)]
pub(super) struct Dispatch {
    /// What is bound, in which order.
    pub kernel: &'static KernelShader,
    /// The specialised shader.
    pub shader: Shader,
    /// The inputs to bind: as many as the kernel has.
    pub inputs: Vec<View>,
    /// Workgroups along x and y.
    pub workgroups: [u32; 2],
    /// Size of a convolution.
    pub extent: Option<Extent>,
    /// Contents of those resources that belong to the step.
    pub weights: Vec<u8>,
    pub terms: Option<Terms>,
}

impl Dispatch {
    /// Specialises the shader of `step`, whose tensors are stored in `formats`; `variant` says how a convolution is divided,
    /// if that is not to be chosen by its size.
    pub fn new(
        step: &Step,
        formats: &TensorFormats,
        calibration: &Calibration,
        abilities: Abilities,
        variant: Option<Variant>,
    ) -> Result<Self, GpuError> {
        let kernel = bindings::kernel(step.kernel.name());
        let mut inputs = step.inputs.clone();
        inputs.resize(kernel.inputs.len(), inputs[0]);
        let output_format = formats.of(&step.output);
        let convolution = step.kernel.convolution().is_some();
        assert!(convolution || output_format == TensorFormat::F32, "only convolutions write f16");
        let mut parameters = Parameters::default();
        set_calibration(&mut parameters, calibration);
        for (name, view) in kernel
            .inputs
            .iter()
            .zip(&inputs)
            .map(|(name, view)| (name.as_str(), view))
            .chain([("output", &step.output)])
        {
            set_view(&mut parameters, name, view, formats.of(view), formats.slot_bytes[view.slot])?;
        }
        parameters.set("first_frame", step.first_frame);

        for (number, name) in kernel.inputs.iter().enumerate() {
            parameters.set(&format!("{name}_given"), number < step.inputs.len());
        }
        for (name, value) in step.kernel.parameters() {
            match value {
                Parameter::Integer(value) => parameters.set(name, value),
                Parameter::Axes(values) => parameters.set_axes(name, values),
                Parameter::Integers(values) => parameters.set(name, Value::array("i32", values)),
                Parameter::Floats(values) => parameters.set(name, Value::array("f32", values)),
            }
        }

        let output = step.output.shape;
        let (mut division, mut weights, mut terms) = (None, Vec::new(), None);
        // An invocation computes up to four channels of a pixel, but where blocks of results have invocations.
        let mut invocations = output.pixels() * output.c.div_ceil(4);
        if let Some(conv) = step.kernel.convolution() {
            let Division { variant, extent } =
                *division.insert(Division::new(step, conv, abilities, variant));
            set_epilogue(&mut parameters, conv);
            let [input, added] = [&inputs[0], &inputs[1]].map(|view| formats.of(view));
            let read = [("input", input), ("added", added), ("weights", formats.weights)];
            set_formats(&mut parameters, read, output_format, variant.wide);
            let packing = set_division(&mut parameters, conv, variant, extent);
            let units = weight_units(conv, formats.weights);
            weights = stored(&pack(conv, packing, &units), formats.weights);
            terms = Some(Terms::new(conv, packing, &units));
            invocations = variant.teams(extent) * variant.lanes;
        }
        checked(&step.name, invocations)?;
        let workgroups = fold(invocations.div_ceil(WORKGROUP_SIZE), abilities.max_workgroups);
        parameters.set("workgroup_size", WORKGROUP_SIZE);
        parameters.set("invocations", invocations);
        let shader = specialise(kernel.source(), &parameters);
        let extent = division.map(|division| division.extent);
        Ok(Self { kernel, shader, inputs, workgroups, extent, weights, terms })
    }
}

/// How a convolution is divided among invocations.
#[derive(Clone, Copy)]
struct Division {
    variant: Variant,
    extent: Extent,
}

impl Division {
    /// By `variant`, or as its size suggests.
    fn new(step: &Step, conv: &ConvolutionStep, abilities: Abilities, variant: Option<Variant>) -> Self {
        let output = step.output.shape;
        // The pixels that blocks lie in: of a transposed convolution those of its input, for each phase.
        let (shape, phases) = match conv.direction {
            Direction::Forward => (output, 1),
            Direction::Transposed => (step.inputs[0].shape, conv.stride.iter().product()),
        };
        let extent =
            Extent { frames: phases * shape.t, frame: shape.y * shape.x, vectors: output.c.div_ceil(4) };
        let variant =
            variant.map_or_else(|| Variant::choose(extent, abilities), |variant| variant.fit(extent));
        Self { variant, extent }
    }
}

/// Shaders count in i32.
fn checked(what: &str, count: usize) -> Result<(), GpuError> {
    let limit = i32::MAX as u64;
    if count as u64 > limit {
        return Err(GpuError::TooLarge { what: format!("{what} in values"), bytes: count as u64, limit });
    }
    Ok(())
}

/// Workgroups in two dimensions that are at least `count`.
fn fold(count: usize, max: u32) -> [u32; 2] {
    let rows = count.div_ceil(max as usize).max(1);
    [count.div_ceil(rows) as u32, rows as u32]
}

/// The file that says how vectors of four channels are stored, and whether they are read 64 bits at a time.
fn file(format: TensorFormat, wide: bool) -> &'static str {
    match (format, wide) {
        (TensorFormat::F32, false) => "common/stored_f32.wgsl",
        (TensorFormat::F32, true) => "common/stored_f32_wide.wgsl",
        (TensorFormat::F16, false) => "common/stored_f16.wgsl",
        (TensorFormat::F16, true) => "common/stored_f16_wide.wgsl",
    }
}

fn set_calibration(parameters: &mut Parameters, calibration: &Calibration) {
    parameters.set("inverse_response_intervals", calibration.inverse_response.len() - 1);
    parameters.set("pattern_period", calibration.period);
    parameters.set("pattern_rows", calibration.rows);
    parameters.set("pattern_cols", calibration.cols);
}

/// Extents and place of a tensor. Feature tensors are bound as vectors of four channels and counted in them, tensors of
/// one value a pixel as single values.
fn set_view(
    parameters: &mut Parameters,
    name: &str,
    view: &View,
    format: TensorFormat,
    slot_bytes: usize,
) -> Result<(), GpuError> {
    checked(name, slot_bytes / format.bytes())?;
    let unit = if view.stride == 1 { 1 } else { 4 };
    debug_assert!(view.offset.is_multiple_of(unit) && view.stride.is_multiple_of(unit), "{view:?}");
    parameters.set_axes(name, view.shape.extent());
    let mut set = |what: &str, value: usize| parameters.set(&format!("{name}_{what}"), value);
    set("c", view.shape.c);
    set("vectors", view.shape.c.div_ceil(4));
    set("offset", view.offset / unit);
    set("stride", view.stride / unit);
    set("zeros", slot_bytes / (unit * format.bytes()));
    Ok(())
}

/// What follows the sum.
fn set_epilogue(parameters: &mut Parameters, conv: &ConvolutionStep) {
    parameters.set("norm", conv.layer.norm.is_some());
    // As activation.wgsl has them.
    let (activation, parameter) = match conv.activation {
        Activation::None => (0, 0.0),
        Activation::LeakyRelu(slope) => (1, slope),
        Activation::Sigmoid => (2, 0.0),
        Activation::Softplus(floor) => (3, floor),
    };
    parameters.set("activation", activation);
    parameters.set("activation_parameter", parameter);
}

/// How the layer is divided, and so how its weights are packed.
fn set_division(
    parameters: &mut Parameters,
    conv: &ConvolutionStep,
    variant: Variant,
    extent: Extent,
) -> Packing {
    let groups = variant.groups(extent);
    let packing = Packing { groups, vectors: variant.vectors, lanes: variant.lanes };
    parameters.set("pixels", variant.pixels);
    parameters.set("vectors", variant.vectors);
    parameters.set("lanes", variant.lanes);
    parameters.set("team", variant.lanes > 1);
    parameters.set("loads", variant.loads());
    parameters.set("groups", groups);
    parameters.set("blocks", variant.blocks(extent));
    parameters.set("frame", extent.frame);
    parameters.set("tap_weights", packing.tap(conv.in_channels));
    parameters.set("term_vectors", packing.out_vectors());
    packing
}

/// How a convolution's tensors are stored: those that are read, and the one that is written.
fn set_formats(
    parameters: &mut Parameters,
    read: [(&str, TensorFormat); 3],
    output: TensorFormat,
    wide: bool,
) {
    for (name, format) in read {
        parameters.include(name, file(format, wide));
    }
    parameters.include("output", file(output, false));
    parameters.set("limited", output == TensorFormat::F16);
    parameters.set("limit", LARGEST_F16);
}

#[cfg(test)]
mod tests;

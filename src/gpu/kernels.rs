//! The table of shaders, and how a step of a plan becomes the text of one.
//!
//! A shader is specialised by text, so that every loop bound and every stride is a constant for the driver's
//! compiler. In front of it stands a generated header of constants: extents, offsets and strides of its tensors by
//! the names in the table, the camera's tables, and the kernel's own parameters. Two things are expanded in the
//! text itself: a line `#paste NAME` becomes `shaders/common/NAME.wgsl`, and a line with `$p`, `$j`, `$k`, `$q` or
//! `$c` is repeated for the parts of the [`Block`] that an invocation computes.

use std::fmt::Write;

use super::GpuError;
use super::weights::{Packing, pack, pack_terms};
use crate::network::{Activation, Channel, ConvolutionStep, Feature, Kernel, MU, SATURATED, Step, View};
use crate::sensor::Calibration;

/// Invocations of a workgroup.
const WORKGROUP_SIZE: usize = 64;

/// What a binding behind the output holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Resource {
    /// Packed weights of the step.
    Weights,
    /// Packed bias, scale and shift of the step.
    Terms,
    /// Exposures of the step's channels.
    RenderedExposures,
    /// The calibration's table of R⁻¹.
    InverseResponse,
    /// The calibration's table of exposures.
    Exposures,
    /// Schedule time of the window, in the pattern's period.
    Schedule,
}
use Resource::{Exposures, InverseResponse, RenderedExposures, Schedule, Terms, Weights};

/// A shader: bindings are the inputs, the output, and the resources, in this order.
#[derive(Debug)]
pub(super) struct Shader {
    /// Name of the file and of the CPU twin.
    pub name: &'static str,
    text: &'static str,
    /// Names of the inputs in the header. The last one may be missing from a step; the first stands in for it.
    inputs: &'static [&'static str],
    /// Bindings behind the output.
    pub resources: &'static [Resource],
}

macro_rules! shader {
    ($name:literal, $inputs:expr, $resources:expr) => {
        Shader {
            name: $name,
            text: include_str!(concat!("../../shaders/", $name, ".wgsl")),
            inputs: &$inputs,
            resources: &$resources,
        }
    };
}

/// All shaders.
static SHADERS: [Shader; 8] = [
    shader!("box_estimate", ["MEASUREMENT"], [InverseResponse, Exposures, Schedule]),
    shader!("log_irradiance", ["MEASUREMENT"], [InverseResponse, Exposures, Schedule]),
    shader!("features", ["MEASUREMENT", "ESTIMATE", "LOGS"], [InverseResponse, Exposures, Schedule]),
    shader!("conv3d", ["INPUT", "ADDED"], [Weights, Terms]),
    shader!("conv_transpose3d", ["INPUT", "ADDED"], [Weights, Terms]),
    shader!("inverse_response", ["INPUT"], [InverseResponse, RenderedExposures]),
    shader!("fuse", ["WEIGHTS", "RENDERED"], []),
    shader!("blend", ["WEIGHTS", "LOGS", "ESTIMATE"], []),
];

/// Pieces that shaders share.
static PIECES: [(&str, &str); 6] = [
    ("dispatch", include_str!("../../shaders/common/dispatch.wgsl")),
    ("epilogue", include_str!("../../shaders/common/epilogue.wgsl")),
    ("exposure", include_str!("../../shaders/common/exposure.wgsl")),
    ("inverse_response", include_str!("../../shaders/common/inverse_response.wgsl")),
    ("products", include_str!("../../shaders/common/products.wgsl")),
    ("tone", include_str!("../../shaders/common/tone.wgsl")),
];

/// A step, ready to be compiled and recorded.
#[derive(Debug)]
pub(super) struct Call {
    /// The shader.
    pub shader: &'static Shader,
    /// Its specialised text.
    pub text: String,
    /// The inputs to bind: as many as the shader has.
    pub inputs: Vec<View>,
    /// Workgroups along x and y.
    pub workgroups: [u32; 2],
    /// Contents of those resources that belong to the step.
    pub weights: Vec<f32>,
    pub terms: Vec<f32>,
    pub rendered_exposures: Vec<f32>,
}

/// What one invocation of a convolution computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Block {
    /// Neighbours along x.
    pixels: usize,
    /// Vectors of four output channels.
    vectors: usize,
    /// Taps along x that are computed together.
    taps: usize,
    /// Inputs between neighbouring pixels.
    stride: usize,
}

/// What shapes a call besides the step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    /// Workgroups along one dimension of a dispatch.
    pub max_workgroups: u32,
    /// Whether the adapter computes on the CPU.
    pub software: bool,
    /// Pixels and vectors of a block, if they are not to be chosen by size.
    pub block: Option<[usize; 2]>,
}

/// Where the zeros behind the values of a slot begin, in values. Convolutions read them in place of padding.
pub(super) fn zeros_begin(slot_len: usize) -> usize {
    slot_len.next_multiple_of(4)
}

/// How many zeros a slot needs behind its values so that `step` can read one pixel of padding.
pub(super) fn zeros_len(step: &Step) -> usize {
    match step.kernel {
        Kernel::Conv3d(_) | Kernel::ConvTranspose3d(_) => step.inputs[0].shape.c.next_multiple_of(4),
        _ => 0,
    }
}

impl Call {
    /// Specialises the shader of `step`. `slots` are the sizes of the plan's slots.
    pub fn new(
        step: &Step,
        slots: &[usize],
        calibration: &Calibration,
        target: Target,
    ) -> Result<Self, GpuError> {
        let shader = shader(&step.kernel);
        let mut inputs = step.inputs.clone();
        inputs.resize(shader.inputs.len(), inputs[0]);
        let mut header = Header::default();
        for (name, view) in shader.inputs.iter().zip(&inputs) {
            header.view(name, view, slots[view.slot])?;
        }
        header.view("OUTPUT", &step.output, slots[step.output.slot])?;
        header.float("SATURATED", SATURATED);
        header.float("MU", MU);
        header.float("LN_1P_MU", MU.ln_1p());
        header.unsigned("INVERSE_RESPONSE_INTERVALS", calibration.inverse_response.len() - 1);
        header.int("PATTERN_PERIOD", calibration.period);
        header.int("PATTERN_ROWS", calibration.rows);
        header.int("PATTERN_COLS", calibration.cols);
        header.int("FIRST_FRAME", step.first_frame);

        let output = step.output.shape;
        let output_vectors = output.c.div_ceil(4);
        let mut block = Block::SINGLE;
        let (mut weights, mut terms, mut rendered_exposures) = (Vec::new(), Vec::new(), Vec::new());
        let invocations = match &step.kernel {
            Kernel::BoxEstimate | Kernel::LogIrradiance | Kernel::Fuse => output.pixels(),
            Kernel::Features { channels, block, lead } => {
                header.extents("BLOCK", *block);
                header.int("LEAD", *lead);
                header.boolean("LOGS_GIVEN", step.inputs.len() > 2);
                header.features(channels);
                output.pixels() * output_vectors
            }
            Kernel::Conv3d(conv) | Kernel::ConvTranspose3d(conv) => {
                let transposed = matches!(step.kernel, Kernel::ConvTranspose3d(_));
                // The pixels that blocks lie in: of a transposed convolution those of its input, for each phase.
                let (extent, phases) =
                    if transposed { (inputs[0].shape, conv.stride.iter().product()) } else { (output, 1) };
                let rows = if conv.in_channels < 4 {
                    conv.in_channels
                } else {
                    conv.in_channels.next_multiple_of(4)
                };
                block = Block::for_layer(conv, transposed, phases * extent.pixels(), extent.x, target);
                let groups = output_vectors.div_ceil(block.vectors);
                let blocks_x = extent.x.div_ceil(block.pixels);
                let packing = Packing { rows, vectors: groups * block.vectors };
                header.convolution(conv, packing, step.inputs.len() > 1);
                header.int("PIXELS", block.pixels);
                header.int("TAPS", block.taps);
                header.int("COLUMN_STEP", block.column_step());
                header.int("GROUPS", groups);
                header.int("BLOCKS_X", blocks_x);
                weights = pack(conv, transposed, packing);
                terms = pack_terms(conv, packing);
                phases * extent.t * extent.y * blocks_x * groups
            }
            Kernel::InverseResponse { exposures } => {
                rendered_exposures.clone_from(exposures);
                output.pixels() * output_vectors
            }
            Kernel::Blend { block, taps, lead } => {
                header.extents("BLOCK", *block);
                header.int("LEAD", *lead);
                header.int("TAPS", taps.len());
                for (axis, name) in ["TAPS_T", "TAPS_Y", "TAPS_X"].into_iter().enumerate() {
                    header.ints(name, taps.iter().map(|tap| tap[axis]));
                }
                output.pixels()
            }
        };
        checked(&step.name, invocations)?;
        let workgroups = fold(invocations.div_ceil(WORKGROUP_SIZE), target.max_workgroups);
        header.unsigned("WORKGROUP_SIZE", WORKGROUP_SIZE);
        header.unsigned("WORKGROUPS_X", workgroups[0] as usize);
        header.int("INVOCATIONS", invocations);
        let text = format!("{}\n{}", header.0, expand(shader.text, block));
        Ok(Self { shader, text, inputs, workgroups, weights, terms, rendered_exposures })
    }
}

impl Block {
    /// The block of kernels other than convolutions.
    const SINGLE: Self = Self { pixels: 1, vectors: 1, taps: 1, stride: 1 };

    /// Pixels and vectors, largest first. Larger blocks load less per operation, smaller ones keep more of a GPU
    /// busy. Software loads a hundred times slower than it multiplies, but compiles large blocks for seconds.
    const HARDWARE: [[usize; 2]; 4] = [[8, 2], [4, 2], [4, 1], [2, 1]];
    const SOFTWARE: [[usize; 2]; 3] = [[16, 2], [8, 2], [2, 1]];
    /// Invocations that are enough to keep the adapter busy.
    const ENOUGH_HARDWARE: usize = 8192;
    const ENOUGH_SOFTWARE: usize = 128;
    /// Taps times input channels that are computed together at most, which bounds the length of the code.
    const MAX_ROWS: usize = 12;

    /// A block for a layer with `results` pixels in rows of `width`.
    fn for_layer(
        conv: &ConvolutionStep,
        transposed: bool,
        results: usize,
        width: usize,
        target: Target,
    ) -> Self {
        let layer_vectors = conv.out_channels.div_ceil(4);
        // Balanced, so that the last block of a row is nearly full.
        let fit = |[pixels, vectors]: [usize; 2]| {
            [width.div_ceil(width.div_ceil(pixels)), vectors.min(layer_vectors)]
        };
        let (blocks, enough) = if target.software {
            (&Self::SOFTWARE[..], Self::ENOUGH_SOFTWARE)
        } else {
            (&Self::HARDWARE[..], Self::ENOUGH_HARDWARE)
        };
        let invocations = |[pixels, vectors]: [usize; 2]| {
            (results / width) * width.div_ceil(pixels) * layer_vectors.div_ceil(vectors)
        };
        let large_enough = || {
            let mut fitted = blocks.iter().map(|&block| fit(block));
            let smallest = fit(blocks[blocks.len() - 1]);
            fitted.find(|&block| invocations(block) >= enough).unwrap_or(smallest)
        };
        let [pixels, vectors] = target.block.map_or_else(large_enough, fit);
        // Which taps a transposed convolution has depends on the phase, so it takes them one by one.
        let together = !transposed && conv.kernel[2] * conv.in_channels.min(4) <= Self::MAX_ROWS;
        let taps = if together { conv.kernel[2] } else { 1 };
        Self { pixels, vectors, taps, stride: if transposed { 1 } else { conv.stride[2] } }
    }

    /// Input columns that the block depends on at once: neighbours where several taps share them.
    fn columns(self) -> usize {
        if self.taps == 1 { self.pixels } else { (self.pixels - 1) * self.stride + self.taps }
    }

    /// Inputs between neighbouring columns.
    fn column_step(self) -> usize {
        if self.taps == 1 { self.stride } else { 1 }
    }

    /// The column that tap `k` of pixel `p` reads.
    fn column(self, p: usize, k: usize) -> usize {
        if self.taps == 1 { p } else { p * self.stride + k }
    }
}

fn shader(kernel: &Kernel) -> &'static Shader {
    let name = match kernel {
        Kernel::BoxEstimate => "box_estimate",
        Kernel::LogIrradiance => "log_irradiance",
        Kernel::Features { .. } => "features",
        Kernel::Conv3d(_) => "conv3d",
        Kernel::ConvTranspose3d(_) => "conv_transpose3d",
        Kernel::InverseResponse { .. } => "inverse_response",
        Kernel::Fuse => "fuse",
        Kernel::Blend { .. } => "blend",
    };
    SHADERS.iter().find(|shader| shader.name == name).expect("every kernel has a line in the table")
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

/// Replaces `#paste` lines, then repeats lines for the parts of a block.
fn expand(text: &str, block: Block) -> String {
    let pasted = text.lines().flat_map(|line| match line.trim().strip_prefix("#paste ") {
        Some(name) => {
            let (_, piece) =
                PIECES.iter().find(|(piece, _)| *piece == name).expect("pasted pieces are in the table");
            piece.lines().collect()
        }
        None => vec![line],
    });
    let mut expanded = String::new();
    for line in pasted {
        // Comments explain the parts and stand once.
        let line = line.split("//").next().unwrap_or_default().trim_end();
        let count = |tokens: &[&str], count| if tokens.iter().any(|t| line.contains(t)) { count } else { 1 };
        for k in 0..count(&["$k", "$c"], block.taps) {
            for j in 0..count(&["$j"], block.vectors) {
                for q in 0..count(&["$q"], block.columns()) {
                    for p in 0..count(&["$p", "$c"], block.pixels) {
                        let parts = [("$k", k), ("$j", j), ("$q", q), ("$p", p), ("$c", block.column(p, k))];
                        let repeated = parts.iter().fold(line.to_owned(), |line, (token, value)| {
                            line.replace(token, &value.to_string())
                        });
                        expanded.push_str(&repeated);
                        expanded.push('\n');
                    }
                }
            }
        }
    }
    expanded
}

/// The constants in front of a shader.
#[derive(Debug, Default)]
struct Header(String);

impl Header {
    fn line(&mut self, name: &str, type_name: &str, value: impl std::fmt::Display) {
        let _ = writeln!(self.0, "const {name}: {type_name} = {value};");
    }

    fn int(&mut self, name: &str, value: usize) {
        self.line(name, "i32", value);
    }

    fn unsigned(&mut self, name: &str, value: usize) {
        self.line(name, "u32", format_args!("{value}u"));
    }

    fn float(&mut self, name: &str, value: f64) {
        self.line(name, "f32", format_args!("{:?}f", value as f32));
    }

    fn boolean(&mut self, name: &str, value: bool) {
        self.line(name, "bool", value);
    }

    fn extents(&mut self, name: &str, [t, y, x]: [usize; 3]) {
        self.int(&format!("{name}_T"), t);
        self.int(&format!("{name}_Y"), y);
        self.int(&format!("{name}_X"), x);
    }

    /// Extents and place of a tensor. Feature tensors are bound as vectors of four channels and counted in them,
    /// tensors of one value a pixel as single values.
    fn view(&mut self, name: &str, view: &View, slot_len: usize) -> Result<(), GpuError> {
        checked(name, slot_len)?;
        let unit = if view.stride == 1 { 1 } else { 4 };
        debug_assert!(view.offset.is_multiple_of(unit) && view.stride.is_multiple_of(unit), "{view:?}");
        self.extents(name, view.shape.extent());
        self.int(&format!("{name}_C"), view.shape.c);
        self.int(&format!("{name}_VECTORS"), view.shape.c.div_ceil(4));
        self.int(&format!("{name}_OFFSET"), view.offset / unit);
        self.int(&format!("{name}_STRIDE"), view.stride / unit);
        self.int(&format!("{name}_ZEROS"), zeros_begin(slot_len) / unit);
        Ok(())
    }

    /// The channels of a pixel: which feature each is, and how many frames later.
    fn features(&mut self, channels: &[Channel]) {
        const NAMES: [(&str, Feature); 4] = [
            ("LOG_IRRADIANCE", Feature::LogIrradiance),
            ("LOG_ESTIMATE", Feature::LogEstimate),
            ("IS_SATURATED", Feature::Saturated),
            ("LOG_EXPOSURE", Feature::LogExposure),
        ];
        // 0 is the measurement itself.
        for (index, (name, _)) in NAMES.iter().enumerate() {
            self.int(name, index + 1);
        }
        let code = |feature| NAMES.iter().position(|(_, f)| *f == feature).map_or(0, |index| index + 1);
        self.int("CHANNELS", channels.len());
        self.ints("FEATURES", channels.iter().map(|channel| code(channel.feature) as i32));
        self.ints("FRAME_OFFSETS", channels.iter().map(|channel| channel.offset));
    }

    fn ints(&mut self, name: &str, values: impl ExactSizeIterator<Item = i32>) {
        let type_name = format!("array<i32, {}>", values.len());
        let list: Vec<String> = values.map(|value| value.to_string()).collect();
        self.line(name, &type_name, format_args!("{type_name}({})", list.join(", ")));
    }

    fn convolution(&mut self, conv: &ConvolutionStep, packing: Packing, add: bool) {
        self.extents("KERNEL", conv.kernel);
        self.extents("STRIDE", conv.stride);
        self.extents("PADDING", conv.padding);
        self.int("WEIGHT_ROWS", packing.rows);
        self.int("WEIGHT_VECTORS", packing.vectors);
        self.int("TAP_WEIGHTS", packing.rows * packing.vectors);
        self.boolean("NORM", conv.layer.norm.is_some());
        self.boolean("ADD", add);
        let (activation, parameter) = match conv.activation {
            Activation::None => (0, 0.0),
            Activation::LeakyRelu(slope) => (1, slope),
            Activation::Sigmoid => (2, 0.0),
            Activation::Softplus(floor) => (3, floor),
        };
        for (name, code) in [("LEAKY_RELU", 1), ("SIGMOID", 2), ("SOFTPLUS", 3), ("ACTIVATION", activation)] {
            self.unsigned(name, code);
        }
        self.float("ACTIVATION_PARAMETER", parameter as f64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workgroups_are_folded_into_two_dimensions() {
        assert_eq!(fold(1, 65535), [1, 1]);
        assert_eq!(fold(65535, 65535), [65535, 1]);
        assert_eq!(fold(65536, 65535), [32768, 2]);
        for count in [0, 1, 7, 999, 1_000_003] {
            let [x, y] = fold(count, 100_000);
            assert!(x <= 100_000 && x as usize * y as usize >= count);
        }
    }

    #[test]
    fn lines_are_repeated_for_pixels_and_vectors() {
        let block = Block { pixels: 2, vectors: 2, taps: 1, stride: 1 };
        let text = "a_$p += b_$j; // $p\nc\n    #paste dispatch";
        let expanded = expand(text, block);
        let expected = "a_0 += b_0;\na_1 += b_0;\na_0 += b_1;\na_1 += b_1;\nc\n";
        assert!(expanded.starts_with(expected), "{expanded}");
        assert!(expanded.contains("fn invocation_index"));
    }

    #[test]
    fn every_paste_is_in_the_table() {
        for shader in &SHADERS {
            let text = expand(shader.text, Block { pixels: 2, vectors: 3, taps: 3, stride: 2 });
            assert!(!text.contains('#') && !text.contains('$'), "{}", shader.name);
        }
    }
}

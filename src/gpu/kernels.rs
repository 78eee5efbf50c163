//! The table of shaders, and how a step of a plan becomes the text of one.
//!
//! A shader is specialised by text, so that every loop bound and every stride is a constant for the driver's
//! compiler. In front of it stands a generated header of constants: extents, offsets and strides of its tensors by
//! the names in the table, the camera's tables, and the kernel's own parameters. Two things are expanded in the
//! text itself: a line `#paste NAME` becomes `shaders/common/NAME.wgsl`, and a line with `$p`, `$j`, `$i`, `$w` or
//! `$row` is repeated for the parts of the block that an invocation computes; lines between `#each $j` and `#end` are
//! repeated together, and a line with `$tap` is repeated for the taps of a `blend`. The header also says how vectors of four channels are stored: for a tensor NAME it defines the
//! type `NAME_VECTOR` and the function `name_values` or, for the output, `output_vector`.

use std::fmt::Write;
use std::ops::Range;

use super::GpuError;
use super::storage::{Format, Formats, LARGEST_F16};
use super::variant::{Abilities, Extent, Variant};
use super::weights::{Packing, Terms, pack, stored, weight_units};
use crate::network::{
    Activation, Channel, ConvolutionStep, Direction, Feature, Kernel, MU, SATURATED, Step, View,
};
use crate::sensor::Calibration;

/// Invocations of a workgroup.
pub(super) const WORKGROUP_SIZE: usize = 64;

/// What a binding behind the output holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Resource {
    /// Packed weights of the step.
    Weights,
    /// Units, bias, scale and shift of the step ([`Terms`]).
    Terms,
    /// The largest magnitude that did not fit the step's output, as the bits of an f32.
    Overflow,
    /// Exposures of the step's channels.
    RenderedExposures,
    /// The calibration's table of R⁻¹.
    InverseResponse,
    /// The calibration's table of exposures.
    Exposures,
    /// Schedule time of the window, in the pattern's period.
    Schedule,
}
use Resource::{Exposures, InverseResponse, Overflow, RenderedExposures, Schedule};

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
    shader!("conv3d", ["INPUT", "ADDED"], [Resource::Weights, Resource::Terms, Overflow]),
    shader!("conv_transpose3d", ["INPUT", "ADDED"], [Resource::Weights, Resource::Terms, Overflow]),
    shader!("inverse_response", ["INPUT"], [InverseResponse, RenderedExposures]),
    shader!("fuse", ["WEIGHTS", "RENDERED"], []),
    shader!("blend", ["WEIGHTS", "LOGS", "ESTIMATE"], []),
];

/// Pieces that shaders share.
static PIECES: [(&str, &str); 7] = [
    ("dispatch", include_str!("../../shaders/common/dispatch.wgsl")),
    ("epilogue", include_str!("../../shaders/common/epilogue.wgsl")),
    ("exposure", include_str!("../../shaders/common/exposure.wgsl")),
    ("inverse_response", include_str!("../../shaders/common/inverse_response.wgsl")),
    ("products", include_str!("../../shaders/common/products.wgsl")),
    ("team", include_str!("../../shaders/common/team.wgsl")),
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
    /// Size of a convolution.
    pub extent: Option<Extent>,
    /// Contents of those resources that belong to the step.
    pub weights: Vec<u8>,
    pub terms: Option<Terms>,
    pub rendered_exposures: Vec<f32>,
}

/// What shapes a call besides the step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    /// Workgroups along one dimension of a dispatch.
    pub max_workgroups: u32,
    /// What the adapter can do.
    pub abilities: Abilities,
    /// How convolutions are divided, if that is not to be chosen by size.
    pub variant: Option<Variant>,
}

impl Call {
    /// Specialises the shader of `step`, whose tensors are stored in `formats`.
    pub fn new(
        step: &Step,
        formats: &Formats,
        calibration: &Calibration,
        target: Target,
    ) -> Result<Self, GpuError> {
        let shader = shader(&step.kernel);
        let mut inputs = step.inputs.clone();
        inputs.resize(shader.inputs.len(), inputs[0]);
        let mut header = Header::default();
        for (name, view) in shader.inputs.iter().zip(&inputs).chain([(&"OUTPUT", &step.output)]) {
            header.view(name, view, formats.of(view), formats.slot_bytes[view.slot])?;
        }
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
        let mut variant = Variant::SINGLE;
        let mut layer = None;
        let (mut weights, mut terms, mut rendered_exposures) = (Vec::new(), None, Vec::new());
        let invocations = match &step.kernel {
            Kernel::BoxEstimate | Kernel::LogIrradiance | Kernel::Fuse => output.pixels(),
            Kernel::Features { channels, block, lead } => {
                header.extents("BLOCK", *block);
                header.int("LEAD", *lead);
                header.boolean("LOGS_GIVEN", step.inputs.len() > 2);
                header.features(channels);
                output.pixels() * output_vectors
            }
            Kernel::Convolution(conv) => {
                // The pixels that blocks lie in: of a transposed convolution those of its input, for each phase.
                let (shape, phases) = match conv.direction {
                    Direction::Forward => (output, 1),
                    Direction::Transposed => (inputs[0].shape, conv.stride.iter().product()),
                };
                let extent =
                    Extent { frames: phases * shape.t, frame: shape.y * shape.x, vectors: output_vectors };
                layer = Some(extent);
                variant = match target.variant {
                    Some(variant) => variant.fit(extent),
                    None => Variant::choose(extent, target.abilities),
                };
                let groups = variant.groups(extent);
                let packing = Packing { groups, vectors: variant.vectors, lanes: variant.lanes };
                header.convolution(conv, step.inputs.len() > 1);
                header.values("INPUT", formats.of(&inputs[0]), variant.wide);
                header.values("ADDED", formats.of(&inputs[1]), variant.wide);
                header.values("WEIGHTS", formats.weights, variant.wide);
                header.int("PIXELS", variant.pixels);
                header.int("LANES", variant.lanes);
                header.int("LOADS", variant.loads());
                header.int("GROUPS", groups);
                header.int("BLOCKS", variant.blocks(extent));
                header.int("FRAME", extent.frame);
                header.int("TAP_WEIGHTS", packing.tap(conv.in_channels));
                header.int("TERM_VECTORS", packing.out_vectors());
                header.boolean("LIMITED", formats.of(&step.output) == Format::F16);
                header.float("LIMIT", LARGEST_F16 as f64);
                let units = weight_units(conv, formats.weights);
                weights = stored(&pack(conv, packing, &units), formats.weights);
                terms = Some(Terms::new(conv, packing, &units));
                variant.teams(extent) * variant.lanes
            }
            Kernel::InverseResponse { exposures } => {
                rendered_exposures.clone_from(exposures);
                output.pixels() * output_vectors
            }
            Kernel::Blend { block, taps, origin: [t, y] } => {
                header.extents("BLOCK", *block);
                header.int("ORIGIN_T", *t);
                header.int("ORIGIN_Y", *y);
                header.int("TAPS", taps.len());
                output.pixels()
            }
        };
        checked(&step.name, invocations)?;
        let workgroups = fold(invocations.div_ceil(WORKGROUP_SIZE), target.max_workgroups);
        header.unsigned("WORKGROUP_SIZE", WORKGROUP_SIZE);
        header.unsigned("WORKGROUPS_X", workgroups[0] as usize);
        header.int("INVOCATIONS", invocations);
        let taps: &[[i32; 3]] = if let Kernel::Blend { taps, .. } = &step.kernel { taps } else { &[] };
        let text = format!("{}\n{}", header.0, expand(&for_each_tap(shader.text, taps), variant));
        Ok(Self { shader, text, inputs, workgroups, extent: layer, weights, terms, rendered_exposures })
    }
}

/// The shader of the same name.
fn shader(kernel: &Kernel) -> &'static Shader {
    let shader = SHADERS.iter().find(|shader| shader.name == kernel.name());
    shader.expect("every kernel has a line in the table")
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

/// Repeats lines with `$tap` for each tap, as its number and its offsets (t, y, x).
fn for_each_tap(text: &str, taps: &[[i32; 3]]) -> String {
    let mut expanded = String::new();
    for line in text.lines() {
        if line.contains("$tap") {
            for (i, [t, y, x]) in taps.iter().enumerate() {
                expanded.push_str(&line.replace("$tap", &format!("{i}, {t}, {y}, {x}")));
                expanded.push('\n');
            }
        } else {
            expanded.push_str(line);
            expanded.push('\n');
        }
    }
    expanded
}

/// Replaces `#paste` lines, then repeats lines for the parts of a block.
fn expand(text: &str, variant: Variant) -> String {
    let pasted = text.lines().flat_map(|line| match line.trim().strip_prefix("#paste ") {
        Some(name) => {
            let (_, piece) =
                PIECES.iter().find(|(piece, _)| *piece == name).expect("pasted pieces are in the table");
            piece.lines().collect()
        }
        None => vec![line],
    });
    let mut expanded = String::new();
    // Lines that are repeated together.
    let mut each: Option<Vec<&str>> = None;
    for line in pasted {
        // Comments explain the parts and stand once.
        let line = line.split("//").next().unwrap_or_default().trim_end();
        match (line.trim(), &mut each) {
            ("#each $j", _) => each = Some(Vec::new()),
            ("#end", _) => {
                let lines = each.take().unwrap_or_default();
                for j in 0..variant.vectors {
                    for line in &lines {
                        repeat(line, variant, j..j + 1, &mut expanded);
                    }
                }
            }
            (_, Some(lines)) => lines.push(line),
            (_, None) => {
                let vectors = if line.contains("$j") { variant.vectors } else { 1 };
                repeat(line, variant, 0..vectors, &mut expanded);
            }
        }
    }
    expanded
}

/// Writes `line` for each of the `vectors`, and for each of the other parts of a block that it names.
fn repeat(line: &str, variant: Variant, vectors: Range<usize>, expanded: &mut String) {
    let count = |tokens: &[&str], count| if tokens.iter().any(|t| line.contains(t)) { count } else { 1 };
    for j in vectors {
        for p in 0..count(&["$p"], variant.pixels) {
            for w in 0..count(&["$w"], variant.loads()) {
                for i in 0..count(&["$i", "$x", "$row"], 4) {
                    let row = 4 * j + i;
                    let row = match variant.lanes {
                        1 => format!("loaded_{row}"),
                        lanes => format!("subgroupBroadcast(loaded_{}, {}u)", row / lanes, row % lanes),
                    };
                    let parts = [("$row", row.as_str()), ("$x", ["x", "y", "z", "w"][i])];
                    let line =
                        parts.iter().fold(line.to_owned(), |line, (token, to)| line.replace(token, to));
                    let numbers = [("$j", j), ("$p", p), ("$w", w), ("$i", i)];
                    let line =
                        numbers.iter().fold(line, |line, (token, n)| line.replace(token, &n.to_string()));
                    expanded.push_str(&line);
                    expanded.push('\n');
                }
            }
        }
    }
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
    fn view(&mut self, name: &str, view: &View, format: Format, slot_bytes: usize) -> Result<(), GpuError> {
        checked(name, slot_bytes / format.bytes())?;
        let unit = if view.stride == 1 { 1 } else { 4 };
        debug_assert!(view.offset.is_multiple_of(unit) && view.stride.is_multiple_of(unit), "{view:?}");
        self.extents(name, view.shape.extent());
        self.int(&format!("{name}_C"), view.shape.c);
        self.int(&format!("{name}_VECTORS"), view.shape.c.div_ceil(4));
        self.int(&format!("{name}_OFFSET"), view.offset / unit);
        self.int(&format!("{name}_STRIDE"), view.stride / unit);
        self.int(&format!("{name}_ZEROS"), slot_bytes / (unit * format.bytes()));
        if name == "OUTPUT" && unit == 4 {
            let (vector, stored) = match format {
                Format::F32 => ("vec4<f32>", "return v;".to_owned()),
                // What does not fit is reported elsewhere, and must stay finite here.
                Format::F16 => (
                    "vec2<u32>",
                    format!(
                        "let c = clamp(v, vec4<f32>(-{LARGEST_F16:?}f), vec4<f32>({LARGEST_F16:?}f)); \
                         return vec2<u32>(pack2x16float(c.xy), pack2x16float(c.zw));"
                    ),
                ),
            };
            let _ = writeln!(self.0, "alias OUTPUT_VECTOR = {vector};");
            let _ = writeln!(self.0, "fn output_vector(v: vec4<f32>) -> OUTPUT_VECTOR {{ {stored} }}");
        }
        Ok(())
    }

    /// How vectors of four values are stored and loaded.
    fn values(&mut self, name: &str, format: Format, wide: bool) {
        let (vector, values) = match (format, wide) {
            (Format::F32, false) => ("vec4<f32>", "v"),
            (Format::F32, true) => (
                "vec2<u64>",
                "bitcast<vec4<f32>>(vec4<u32>(u32(v.x), u32(v.x >> 32u), u32(v.y), u32(v.y >> 32u)))",
            ),
            (Format::F16, false) => ("vec2<u32>", "vec4<f32>(unpack2x16float(v.x), unpack2x16float(v.y))"),
            (Format::F16, true) => {
                ("u64", "vec4<f32>(unpack2x16float(u32(v)), unpack2x16float(u32(v >> 32u)))")
            }
        };
        let function = name.to_lowercase();
        let _ = writeln!(self.0, "alias {name}_VECTOR = {vector};");
        let _ =
            writeln!(self.0, "fn {function}_values(v: {name}_VECTOR) -> vec4<f32> {{ return {values}; }}");
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

    fn convolution(&mut self, conv: &ConvolutionStep, add: bool) {
        self.extents("KERNEL", conv.kernel);
        self.extents("STRIDE", conv.stride);
        self.extents("PADDING", conv.padding);
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
        let variant = Variant { pixels: 2, vectors: 2, lanes: 1, wide: false };
        let text = "a_$p += b_$j; // $p\nc\n    #paste dispatch";
        let expanded = expand(text, variant);
        let expected = "a_0 += b_0;\na_1 += b_0;\na_0 += b_1;\na_1 += b_1;\nc\n";
        assert!(expanded.starts_with(expected), "{expanded}");
        assert!(expanded.contains("fn invocation_index"));
        let together = expand("#each $j\na_$j\nb_$j\n#end", variant);
        assert_eq!(together, "a_0\nb_0\na_1\nb_1\n");
        // Eight rows of weights, of which five lanes load two each.
        let rows = expand("$j.$x = $row;", Variant { lanes: 5, ..variant });
        assert!(rows.starts_with("0.x = subgroupBroadcast(loaded_0, 0u);\n"), "{rows}");
        assert!(rows.ends_with("1.w = subgroupBroadcast(loaded_1, 2u);\n"), "{rows}");
    }

    #[test]
    fn every_paste_is_in_the_table() {
        for shader in &SHADERS {
            let text = for_each_tap(shader.text, &[[0, -1, 2]]);
            let text = expand(&text, Variant { pixels: 2, vectors: 3, lanes: 8, wide: false });
            assert!(!text.contains('#') && !text.contains('$'), "{}", shader.name);
        }
    }
}

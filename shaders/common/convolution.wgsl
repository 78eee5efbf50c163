// convolution: what conv3d and conv_transpose3d share.
//
// LANES invocations that run in step, and so can read each other's registers, are a team. It computes LANES · PIXELS
// pixels of a frame, its block, and VECTORS times four output channels of them: vectors `group`, `group` + GROUPS, … of
// the output. Each invocation loads a part of the weights. Where LANES is 1, neighbouring invocations compute
// neighbouring channels instead: what they read of the weights and what they write is contiguous, and what they read of
// the input is the same.
//
// What follows the sum (weights-format/README.md): v = activation(sum + bias), then v = v·scale + shift, then
// v = v + added. The sum is in the units of the input and of the weights, and where the output is f16, it is stored in a
// unit too. Units are powers of two, which change no digit.

//!include common/dispatch.wgsl
//!include common/activation.wgsl
//!include common/stored_f32.wgsl as input
//!include common/stored_f32.wgsl as added
//!include common/stored_f32.wgsl as output
//!include common/stored_f32.wgsl as weights

const KERNEL_T: i32 = 1; //!parameter
const KERNEL_Y: i32 = 1; //!parameter
const KERNEL_X: i32 = 1; //!parameter
const STRIDE_T: i32 = 1; //!parameter
const STRIDE_Y: i32 = 1; //!parameter
const STRIDE_X: i32 = 1; //!parameter
const PADDING_T: i32 = 0; //!parameter
const PADDING_Y: i32 = 0; //!parameter
const PADDING_X: i32 = 0; //!parameter

// Vectors of four channels, and vectors between neighbouring pixels.
const INPUT_VECTORS: i32 = 1; //!parameter
const INPUT_STRIDE: i32 = 1; //!parameter
const ADDED_STRIDE: i32 = 1; //!parameter
const OUTPUT_VECTORS: i32 = 1; //!parameter
const OUTPUT_STRIDE: i32 = 1; //!parameter

// How the layer is divided (gpu/variant.rs).
const PIXELS: i32 = 1; //!parameter
const VECTORS: i32 = 1; //!parameter
const LANES: i32 = 1; //!parameter
const TEAM: bool = false; //!parameter
// Vectors of weights that an invocation loads for four input channels.
const LOADS: i32 = 4; //!parameter
const GROUPS: i32 = 1; //!parameter
// Vectors of weights of a tap, and of a row of terms.
const TAP_WEIGHTS: i32 = 4; //!parameter
const TERM_VECTORS: i32 = 1; //!parameter

// Whether there is a normalisation, something to add, and a largest value that the output can hold.
const NORM: bool = false; //!parameter
const ADDED_GIVEN: bool = false; //!parameter
const LIMITED: bool = false; //!parameter
const LIMIT: f32 = 65504.0; //!parameter

struct Geometry {
    invocations: i32,
    // Pixels of a frame that blocks lie in, and blocks.
    frame: i32,
    blocks: i32,
    input_t: i32,
    input_y: i32,
    input_x: i32,
    input_offset: i32,
    // Zeros behind the slot, which stand in for the padding.
    input_zeros: i32,
    added_offset: i32,
    output_y: i32,
    output_x: i32,
    output_offset: i32,
}

@group(1) @binding(0) var<uniform> geometry: Geometry;
@group(1) @binding(1) var<storage, read> input: array<InputVector>;
@group(1) @binding(2) var<storage, read> added: array<AddedVector>;
@group(1) @binding(3) var<storage, read_write> output: array<OutputVector>;
// [tap][four input channels][load][group][lane]. The weights from input channel i of four to the channels of vector j are
// row 4j + i of the team's rows; row n is loaded by lane n % LANES in load n / LANES.
@group(1) @binding(4) var<storage, read> weights: array<WeightsVector>;
// Rows: units of the sum, bias, scale, shift, and parts of the output's unit that 1 is.
@group(1) @binding(5) var<storage, read> terms: array<vec4<f32>>;
// The largest magnitude that the output cannot hold.
@group(1) @binding(6) var<storage, read_write> overflow: atomic<u32>;

struct Team {
    lane: i32,
    group: i32,
    block: i32,
}

// Of each pixel of an invocation, and its sums.
alias Pixels = array<i32, PIXELS>;
alias Sums = array<array<vec4<f32>, VECTORS>, PIXELS>;

fn team_of(invocation: i32) -> Team {
    return Team(invocation % LANES, invocation / LANES % GROUPS, invocation / (LANES * GROUPS));
}

// The pixels of an invocation in its frame.
fn pixels_of(team: Team) -> Pixels {
    let first = team.block % geometry.blocks * (PIXELS * LANES) + team.lane;
    var pixels: Pixels;
    for (var p = 0; p < PIXELS; p++) { //!static
        pixels[p] = first + p * LANES;
    }
    return pixels;
}

// Where the channels of input pixel (t, y, x) begin. Pixels of the padding are read from zeros behind the slot.
fn input_at(t: i32, y: i32, x: i32) -> i32 {
    let inside = y >= 0 && y < geometry.input_y && x >= 0 && x < geometry.input_x;
    let pixel = (t * geometry.input_y + y) * geometry.input_x + x;
    return select(geometry.input_zeros, geometry.input_offset + pixel * INPUT_STRIDE, inside);
}

// Where the first weights of a tap lie.
fn weights_at(team: Team, t: i32, y: i32, x: i32) -> i32 {
    return ((t * KERNEL_Y + y) * KERNEL_X + x) * TAP_WEIGHTS + team.group * LANES + team.lane;
}

// Adds the products of input pixels with the weights of one tap.
fn add_products(sums: ptr<function, Sums>, pixels: Pixels, first_weight: i32) {
    var weight = first_weight;
    for (var vector = 0; vector < INPUT_VECTORS; vector++) {
        var loaded: array<vec4<f32>, LOADS>;
        for (var w = 0; w < LOADS; w++) { //!static
            loaded[w] = weights_values(weights[weight + w * (GROUPS * LANES)]);
        }
        var column: array<vec4<f32>, PIXELS>;
        for (var p = 0; p < PIXELS; p++) { //!static
            column[p] = input_values(input[pixels[p] + vector]);
        }
        for (var j = 0; j < VECTORS; j++) { //!static
            var row: array<vec4<f32>, 4>;
            for (var i = 0; i < 4; i++) { //!static
                if (TEAM) { //!static
                    row[i] = subgroupShuffle(loaded[(4 * j + i) / LANES], u32((4 * j + i) % LANES));
                } else {
                    row[i] = loaded[4 * j + i];
                }
            }
            for (var p = 0; p < PIXELS; p++) { //!static
                for (var i = 0; i < 4; i++) { //!static
                    (*sums)[p][j] = fma(vec4<f32>(column[p][i]), row[i], (*sums)[p][j]);
                }
            }
        }
        weight += LOADS * GROUPS * LANES;
    }
}

// Result for the four channels of `vector`, of pixel number `pixel` of the output.
fn epilogue(sum: vec4<f32>, vector: i32, pixel: i32) -> vec4<f32> {
    var v = activation(sum * terms[vector] + terms[TERM_VECTORS + vector]);
    if (NORM) {
        v = v * terms[2 * TERM_VECTORS + vector] + terms[3 * TERM_VECTORS + vector];
    }
    if (ADDED_GIVEN) {
        v += added_values(added[geometry.added_offset + pixel * ADDED_STRIDE + vector]);
    }
    return v;
}

// Writes four channels of a pixel, unless they are padding, and keeps the largest magnitude.
fn store(sum: vec4<f32>, vector: i32, pixel: i32, inside: bool, largest: ptr<function, f32>) {
    if (inside && vector < OUTPUT_VECTORS) {
        var v = epilogue(sum, vector, pixel);
        if (LIMITED) {
            let a = abs(v);
            *largest = max(*largest, max(max(a.x, a.y), max(a.z, a.w)));
            v *= terms[4 * TERM_VECTORS + vector];
        }
        output[geometry.output_offset + pixel * OUTPUT_STRIDE + vector] = output_vector(v);
    }
}

// Keeps a magnitude beyond what the output's format can hold. Magnitudes have the order of their bits.
fn report(largest: f32) {
    if (LIMITED && largest * terms[4 * TERM_VECTORS].x > LIMIT) {
        atomicMax(&overflow, bitcast<u32>(largest));
    }
}

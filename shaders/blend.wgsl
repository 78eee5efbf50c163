// blend: predicted kernels. With b = l(estimate), weights w and residual d of a pixel:
// l⁻¹(clamp(b + Σ w·(log irradiance of the tap − b) + d, 0, 1)). Taps outside do not count.
// Channel (i·by + dy)·bx + dx of a block is weight i of pixel (dy, dx); d stands behind the n weights.
//
// One invocation computes one pixel.

//!include common/dispatch.wgsl
//!include common/tone.wgsl

const BLOCK_Y: i32 = 1; //!parameter
const BLOCK_X: i32 = 1; //!parameter
const WEIGHTS_STRIDE: i32 = 1; //!parameter
// Offsets of the pixels that the weights are for.
const TAPS: i32 = 1; //!parameter
const TAP_T = array<i32, 1>(0); //!parameter
const TAP_Y = array<i32, 1>(0); //!parameter
const TAP_X = array<i32, 1>(0); //!parameter

struct Geometry {
    invocations: i32,
    weights_y: i32,
    weights_x: i32,
    weights_offset: i32,
    logs_t: i32,
    logs_y: i32,
    logs_offset: i32,
    // Frame and row of the logs at which the output begins.
    origin_t: i32,
    origin_y: i32,
    estimate_offset: i32,
    output_y: i32,
    output_x: i32,
    output_offset: i32,
}

@group(1) @binding(0) var<uniform> geometry: Geometry;
@group(1) @binding(1) var<storage, read> weights: array<vec4<f32>>;
@group(1) @binding(2) var<storage, read> logs: array<f32>;
@group(1) @binding(3) var<storage, read> estimate: array<f32>;
@group(1) @binding(4) var<storage, read_write> output: array<f32>;

struct Pixel {
    t: i32,
    y: i32,
    x: i32,
    // Its first vector of weights, and its first channel.
    vectors: i32,
    first: i32,
    base: f32,
}

// Weight `i` of a pixel.
fn weight(pixel: Pixel, i: i32) -> f32 {
    let channel = i * BLOCK_Y * BLOCK_X + pixel.first;
    let four = weights[pixel.vectors + channel / 4];
    let part = channel % 4;
    return select(select(four.x, four.y, part == 1), select(four.z, four.w, part == 3), part >= 2);
}

// What tap `i` adds.
fn contribution(pixel: Pixel, i: i32, dt: i32, dy: i32, dx: i32) -> f32 {
    let width = geometry.output_x;
    let t = geometry.origin_t + pixel.t + dt;
    let y = geometry.origin_y + pixel.y + dy;
    let x = pixel.x + dx;
    if (t >= 0 && t < geometry.logs_t && y >= 0 && y < geometry.logs_y && x >= 0 && x < width) {
        let tap = logs[geometry.logs_offset + (t * geometry.logs_y + y) * width + x];
        return weight(pixel, i) * (tap - pixel.base);
    }
    return 0.0;
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn blend(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = invocation_index(workgroup, workgroups, local);
    if (index >= geometry.invocations) {
        return;
    }
    let x = index % geometry.output_x;
    let y = index / geometry.output_x % geometry.output_y;
    let t = index / (geometry.output_x * geometry.output_y);
    let block = (t * geometry.weights_y + y / BLOCK_Y) * geometry.weights_x + x / BLOCK_X;
    let vectors = geometry.weights_offset + block * WEIGHTS_STRIDE;
    let first = y % BLOCK_Y * BLOCK_X + x % BLOCK_X;
    let pixel = Pixel(t, y, x, vectors, first, tone(estimate[geometry.estimate_offset + index]));
    var v = pixel.base;
    // Written out, taps are constants; an array of them would be copied by each invocation.
    for (var i = 0; i < TAPS; i++) { //!static
        v += contribution(pixel, i, TAP_T[i], TAP_Y[i], TAP_X[i]);
    }
    v += weight(pixel, TAPS);
    output[geometry.output_offset + index] = inverse_tone(clamp(v, 0.0, 1.0));
}

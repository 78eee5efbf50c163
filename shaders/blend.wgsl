// blend: predicted kernels. With b = l(estimate), weights w and residual d of a pixel:
// l⁻¹(clamp(b + Σ w·(log irradiance of the tap − b) + d, 0, 1)). Taps outside do not count.
// Channel (i·by + dy)·bx + dx of a block is weight i of pixel (dy, dx); d stands behind the n weights.
//
// One invocation computes one pixel.

@group(0) @binding(0) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> logs: array<f32>;
@group(0) @binding(2) var<storage, read> estimate: array<f32>;
@group(0) @binding(3) var<storage, read_write> output: array<f32>;

#paste dispatch
#paste tone

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

// What tap `i` adds. Taps are constants in the text: an array of them would be copied by each invocation.
fn contribution(pixel: Pixel, i: i32, dt: i32, dy: i32, dx: i32) -> f32 {
    let tap_t = ORIGIN_T + pixel.t + dt;
    let tap_y = ORIGIN_Y + pixel.y + dy;
    let tap_x = pixel.x + dx;
    if (tap_t >= 0 && tap_t < LOGS_T && tap_y >= 0 && tap_y < LOGS_Y && tap_x >= 0 && tap_x < OUTPUT_X) {
        return weight(pixel, i) * (logs[LOGS_OFFSET + (tap_t * LOGS_Y + tap_y) * OUTPUT_X + tap_x] - pixel.base);
    }
    return 0.0;
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn blend(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = invocation_index(workgroup, local);
    if (index >= INVOCATIONS) {
        return;
    }
    let x = index % OUTPUT_X;
    let y = index / OUTPUT_X % OUTPUT_Y;
    let t = index / (OUTPUT_X * OUTPUT_Y);
    let block = (t * WEIGHTS_Y + y / BLOCK_Y) * WEIGHTS_X + x / BLOCK_X;
    let vectors = WEIGHTS_OFFSET + block * WEIGHTS_STRIDE;
    let first = y % BLOCK_Y * BLOCK_X + x % BLOCK_X;
    let pixel = Pixel(t, y, x, vectors, first, tone(estimate[ESTIMATE_OFFSET + index]));
    var v = pixel.base;
    v += contribution(pixel, $tap);
    v += weight(pixel, TAPS);
    output[OUTPUT_OFFSET + index] = inverse_tone(clamp(v, 0.0, 1.0));
}

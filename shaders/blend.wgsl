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

@compute @workgroup_size(WORKGROUP_SIZE)
fn blend(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let pixel = invocation_index(workgroup, local);
    if (pixel >= INVOCATIONS) {
        return;
    }
    let x = pixel % OUTPUT_X;
    let y = pixel / OUTPUT_X % OUTPUT_Y;
    let t = pixel / (OUTPUT_X * OUTPUT_Y);
    let block = (t * WEIGHTS_Y + y / BLOCK_Y) * WEIGHTS_X + x / BLOCK_X;
    let vectors = WEIGHTS_OFFSET + block * WEIGHTS_STRIDE;
    let first = y % BLOCK_Y * BLOCK_X + x % BLOCK_X;
    let base = tone(estimate[ESTIMATE_OFFSET + pixel]);
    var v = base;
    for (var i = 0; i < TAPS; i++) {
        let tap_t = LEAD + t + TAPS_T[i];
        let tap_y = y + TAPS_Y[i];
        let tap_x = x + TAPS_X[i];
        if (tap_t >= 0 && tap_t < LOGS_T && tap_y >= 0 && tap_y < OUTPUT_Y && tap_x >= 0 && tap_x < OUTPUT_X) {
            let channel = i * BLOCK_Y * BLOCK_X + first;
            let weight = weights[vectors + channel / 4][channel % 4];
            v += weight * (logs[LOGS_OFFSET + (tap_t * OUTPUT_Y + tap_y) * OUTPUT_X + tap_x] - base);
        }
    }
    let residual = TAPS * BLOCK_Y * BLOCK_X + first;
    v += weights[vectors + residual / 4][residual % 4];
    output[OUTPUT_OFFSET + pixel] = inverse_tone(clamp(v, 0.0, 1.0));
}

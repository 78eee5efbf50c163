// unfold: channels unfolded into blocks of pixels, as a residual d over the estimate in the log domain:
// l⁻¹(clamp(l(estimate) + d, 0, 1)). d of pixel (dt, dy, dx) of a block is channel (dt·by + dy)·bx + dx.
//
// One invocation computes one pixel.

@group(0) @binding(0) var<storage, read> residual: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> estimate: array<f32>;
@group(0) @binding(2) var<storage, read_write> output: array<f32>;

#paste dispatch
#paste tone

@compute @workgroup_size(WORKGROUP_SIZE)
fn unfold(
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
    let block = (t / BLOCK_T * RESIDUAL_Y + y / BLOCK_Y) * RESIDUAL_X + x / BLOCK_X;
    let channel = (t % BLOCK_T * BLOCK_Y + y % BLOCK_Y) * BLOCK_X + x % BLOCK_X;
    let d = residual[RESIDUAL_OFFSET + block * RESIDUAL_STRIDE + channel / 4][channel % 4];
    let v = tone(estimate[ESTIMATE_OFFSET + pixel]) + d;
    output[OUTPUT_OFFSET + pixel] = inverse_tone(clamp(v, 0.0, 1.0));
}

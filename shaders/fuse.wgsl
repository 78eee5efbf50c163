// fuse: weights w (n channels) and the result of inverse_response (2n channels, the last n are p) → Σ w p / Σ w
// (eq. 23).
//
// One invocation computes one pixel.

@group(0) @binding(0) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> rendered: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> output: array<f32>;

#paste dispatch

@compute @workgroup_size(WORKGROUP_SIZE)
fn fuse(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let pixel = invocation_index(workgroup, local);
    if (pixel >= INVOCATIONS) {
        return;
    }
    var sum = 0.0;
    var weight = 0.0;
    for (var i = 0; i < WEIGHTS_C; i++) {
        let j = WEIGHTS_C + i;
        let w = weights[WEIGHTS_OFFSET + pixel * WEIGHTS_STRIDE + i / 4][i % 4];
        let p = rendered[RENDERED_OFFSET + pixel * RENDERED_STRIDE + j / 4][j % 4];
        sum += w * p;
        weight += w;
    }
    output[OUTPUT_OFFSET + pixel] = sum / weight;
}

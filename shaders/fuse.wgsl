// fuse: weights w (n channels) and the result of inverse_response (2n channels, the last n are p) → Σ w p / Σ w
// (eq. 23).
//
// One invocation computes one pixel.

//!include common/dispatch.wgsl

const WEIGHTS_C: i32 = 1; //!parameter
const WEIGHTS_STRIDE: i32 = 1; //!parameter
const RENDERED_STRIDE: i32 = 1; //!parameter

struct Geometry {
    invocations: i32,
    weights_offset: i32,
    rendered_offset: i32,
    output_offset: i32,
}

@group(1) @binding(0) var<uniform> geometry: Geometry;
@group(1) @binding(1) var<storage, read> weights: array<vec4<f32>>;
@group(1) @binding(2) var<storage, read> rendered: array<vec4<f32>>;
@group(1) @binding(3) var<storage, read_write> output: array<f32>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn fuse(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let pixel = invocation_index(workgroup, workgroups, local);
    if (pixel >= geometry.invocations) {
        return;
    }
    var sum = 0.0;
    var weight = 0.0;
    for (var i = 0; i < WEIGHTS_C; i++) {
        let j = WEIGHTS_C + i;
        let w = weights[geometry.weights_offset + pixel * WEIGHTS_STRIDE + i / 4][i % 4];
        let p = rendered[geometry.rendered_offset + pixel * RENDERED_STRIDE + j / 4][j % 4];
        sum += w * p;
        weight += w;
    }
    output[geometry.output_offset + pixel] = sum / weight;
}

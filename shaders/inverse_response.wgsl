// inverse_response: n channels of rendered pixel values → the same n channels, then R⁻¹(y_i)/e_i (eq. 22).
//
// One invocation computes four channels of one pixel.

//!include common/dispatch.wgsl
//!include common/calibration.wgsl

const INPUT_C: i32 = 1; //!parameter
const INPUT_STRIDE: i32 = 1; //!parameter
const OUTPUT_C: i32 = 2; //!parameter
const OUTPUT_VECTORS: i32 = 1; //!parameter
const OUTPUT_STRIDE: i32 = 1; //!parameter
// Exposure of each channel.
const RENDERED_EXPOSURES = array<f32, 1>(1.0); //!parameter

struct Geometry {
    invocations: i32,
    input_offset: i32,
    output_offset: i32,
}

@group(1) @binding(0) var<uniform> geometry: Geometry;
@group(1) @binding(1) var<storage, read> input: array<vec4<f32>>;
@group(1) @binding(2) var<storage, read_write> output: array<vec4<f32>>;

fn channel_of(channel: i32, pixel: i32) -> f32 {
    if (channel >= OUTPUT_C) {
        return 0.0; // padding
    }
    let i = channel % INPUT_C;
    let y = input[geometry.input_offset + pixel * INPUT_STRIDE + i / 4][i % 4];
    if (channel < INPUT_C) {
        return y;
    }
    return inverse_response_of(y) / RENDERED_EXPOSURES[i];
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn inverse_response(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = invocation_index(workgroup, workgroups, local);
    if (invocation >= geometry.invocations) {
        return;
    }
    let vector = invocation % OUTPUT_VECTORS;
    let pixel = invocation / OUTPUT_VECTORS;
    let channel = 4 * vector;
    output[geometry.output_offset + pixel * OUTPUT_STRIDE + vector] = vec4<f32>(
        channel_of(channel, pixel),
        channel_of(channel + 1, pixel),
        channel_of(channel + 2, pixel),
        channel_of(channel + 3, pixel),
    );
}

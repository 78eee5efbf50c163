// inverse_response: n channels of rendered pixel values → the same n channels, then R⁻¹(y_i)/e_i (eq. 22).
//
// One invocation computes four channels of one pixel.

@group(0) @binding(0) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> output: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> inverse_response_table: array<f32>;
@group(0) @binding(3) var<storage, read> rendered_exposures: array<f32>;

#paste dispatch
#paste inverse_response

fn channel_of(channel: i32, pixel: i32) -> f32 {
    if (channel >= OUTPUT_C) {
        return 0.0; // padding
    }
    let i = channel % INPUT_C;
    let y = input[INPUT_OFFSET + pixel * INPUT_STRIDE + i / 4][i % 4];
    if (channel < INPUT_C) {
        return y;
    }
    return inverse_response_of(y) / rendered_exposures[i];
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn inverse_response(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = invocation_index(workgroup, local);
    if (invocation >= INVOCATIONS) {
        return;
    }
    let vector = invocation % OUTPUT_VECTORS;
    let pixel = invocation / OUTPUT_VECTORS;
    let channel = 4 * vector;
    output[OUTPUT_OFFSET + pixel * OUTPUT_STRIDE + vector] = vec4<f32>(
        channel_of(channel, pixel),
        channel_of(channel + 1, pixel),
        channel_of(channel + 2, pixel),
        channel_of(channel + 3, pixel),
    );
}

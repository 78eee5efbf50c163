// features: the channels that a net sees of each pixel, with blocks of pixels folded into channels:
// out channel ((dt·by + dy)·bx + dx)·n + i is channel i of pixel (dt, dy, dx) of a block.
//
// One invocation computes four channels of one block.

@group(0) @binding(0) var<storage, read> measurement: array<f32>;
@group(0) @binding(1) var<storage, read> estimate: array<f32>;
@group(0) @binding(2) var<storage, read> logs: array<f32>;
@group(0) @binding(3) var<storage, read_write> output: array<OUTPUT_VECTOR>;
@group(0) @binding(4) var<storage, read> inverse_response_table: array<f32>;
@group(0) @binding(5) var<storage, read> exposures: array<f32>;
@group(0) @binding(6) var<uniform> schedule: vec4<u32>;

#paste dispatch
#paste inverse_response
#paste exposure
#paste tone

fn channel_of(channel: i32, t: i32, y: i32, x: i32) -> f32 {
    if (channel >= OUTPUT_C) {
        return 0.0; // padding
    }
    let in_block = channel / CHANNELS;
    let pixel_t = t * BLOCK_T + in_block / (BLOCK_Y * BLOCK_X);
    let pixel_y = y * BLOCK_Y + in_block / BLOCK_X % BLOCK_Y;
    let pixel_x = x * BLOCK_X + in_block % BLOCK_X;
    let pixel = (pixel_t * MEASUREMENT_Y + pixel_y) * MEASUREMENT_X + pixel_x;
    let measured = measurement[MEASUREMENT_OFFSET + pixel];
    switch FEATURES[channel % CHANNELS] {
        case LOG_IRRADIANCE: {
            if (LOGS_GIVEN) {
                let frame = LEAD + pixel_t + FRAME_OFFSETS[channel % CHANNELS];
                if (frame < 0 || frame >= LOGS_T) {
                    return 0.0; // outside of the window
                }
                return logs[LOGS_OFFSET + (frame * LOGS_Y + pixel_y) * LOGS_X + pixel_x];
            }
            return tone(inverse_response_of(measured) / exposure_of(pixel_t, pixel_y, pixel_x));
        }
        case LOG_ESTIMATE: { return tone(estimate[ESTIMATE_OFFSET + pixel]); }
        case IS_SATURATED: { return select(1.0, 0.0, measured < SATURATED); }
        case LOG_EXPOSURE: { return log2(exposure_of(pixel_t, pixel_y, pixel_x)); }
        default: { return measured; }
    }
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn features(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = invocation_index(workgroup, local);
    if (invocation >= INVOCATIONS) {
        return;
    }
    let vector = invocation % OUTPUT_VECTORS;
    let block = invocation / OUTPUT_VECTORS;
    let x = block % OUTPUT_X;
    let y = block / OUTPUT_X % OUTPUT_Y;
    let t = block / (OUTPUT_X * OUTPUT_Y);
    let channel = 4 * vector;
    output[OUTPUT_OFFSET + block * OUTPUT_STRIDE + vector] = output_vector(vec4<f32>(
        channel_of(channel, t, y, x),
        channel_of(channel + 1, t, y, x),
        channel_of(channel + 2, t, y, x),
        channel_of(channel + 3, t, y, x),
    ));
}

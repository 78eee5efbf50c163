// features: the channels that a net sees of each pixel, with blocks of pixels folded into channels:
// out channel ((dt·by + dy)·bx + dx)·n + i is channel i of pixel (dt, dy, dx) of a block.
//
// One invocation computes four channels of one block.

//!include common/dispatch.wgsl
//!include common/calibration.wgsl
//!include common/tone.wgsl

const SATURATED: f32 = 0.98; //!parameter
const BLOCK_T: i32 = 1; //!parameter
const BLOCK_Y: i32 = 1; //!parameter
const BLOCK_X: i32 = 1; //!parameter
const OUTPUT_C: i32 = 1; //!parameter
const OUTPUT_VECTORS: i32 = 1; //!parameter
const OUTPUT_STRIDE: i32 = 1; //!parameter

const LOG_IRRADIANCE = 1;
const LOG_ESTIMATE = 2;
const IS_SATURATED = 3;
const LOG_EXPOSURE = 4;
// Of each channel of a pixel, which of these it is, or 0 for the measurement itself, and how many frames later.
const CHANNELS: i32 = 1; //!parameter
const FEATURES = array<i32, 1>(1); //!parameter
const FRAME_OFFSETS = array<i32, 1>(0); //!parameter
// Whether log irradiance is an input, which other frames can be read from.
const LOGS_GIVEN: bool = false; //!parameter

struct Geometry {
    invocations: i32,
    // The output's first frame in the window.
    first_frame: i32,
    measurement_y: i32,
    measurement_x: i32,
    measurement_offset: i32,
    estimate_offset: i32,
    // Frames of the logs before the first block.
    lead: i32,
    logs_t: i32,
    logs_y: i32,
    logs_x: i32,
    logs_offset: i32,
    output_y: i32,
    output_x: i32,
    output_offset: i32,
}

@group(1) @binding(0) var<uniform> geometry: Geometry;
@group(1) @binding(1) var<storage, read> measurement: array<f32>;
@group(1) @binding(2) var<storage, read> estimate: array<f32>;
@group(1) @binding(3) var<storage, read> logs: array<f32>;
@group(1) @binding(4) var<storage, read_write> output: array<vec4<f32>>;

fn channel_of(channel: i32, t: i32, y: i32, x: i32) -> f32 {
    if (channel >= OUTPUT_C) {
        return 0.0; // padding
    }
    let in_block = channel / CHANNELS;
    let pixel_t = t * BLOCK_T + in_block / (BLOCK_Y * BLOCK_X);
    let pixel_y = y * BLOCK_Y + in_block / BLOCK_X % BLOCK_Y;
    let pixel_x = x * BLOCK_X + in_block % BLOCK_X;
    let pixel = (pixel_t * geometry.measurement_y + pixel_y) * geometry.measurement_x + pixel_x;
    let measured = measurement[geometry.measurement_offset + pixel];
    let in_window = geometry.first_frame + pixel_t;
    switch FEATURES[channel % CHANNELS] {
        case LOG_IRRADIANCE: {
            if (LOGS_GIVEN) {
                let frame = geometry.lead + pixel_t + FRAME_OFFSETS[channel % CHANNELS];
                if (frame < 0 || frame >= geometry.logs_t) {
                    return 0.0; // outside of the window
                }
                return logs[geometry.logs_offset + (frame * geometry.logs_y + pixel_y) * geometry.logs_x + pixel_x];
            }
            return tone(inverse_response_of(measured) / exposure_of(in_window, pixel_y, pixel_x));
        }
        case LOG_ESTIMATE: { return tone(estimate[geometry.estimate_offset + pixel]); }
        case IS_SATURATED: { return select(1.0, 0.0, measured < SATURATED); }
        case LOG_EXPOSURE: { return log2(exposure_of(in_window, pixel_y, pixel_x)); }
        default: { return measured; }
    }
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn features(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = invocation_index(workgroup, workgroups, local);
    if (invocation >= geometry.invocations) {
        return;
    }
    let vector = invocation % OUTPUT_VECTORS;
    let block = invocation / OUTPUT_VECTORS;
    let x = block % geometry.output_x;
    let y = block / geometry.output_x % geometry.output_y;
    let t = block / (geometry.output_x * geometry.output_y);
    let channel = 4 * vector;
    output[geometry.output_offset + block * OUTPUT_STRIDE + vector] = vec4<f32>(
        channel_of(channel, t, y, x),
        channel_of(channel + 1, t, y, x),
        channel_of(channel + 2, t, y, x),
        channel_of(channel + 3, t, y, x),
    );
}

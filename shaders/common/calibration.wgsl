// calibration: what is known of the camera, and the schedule time at which the window begins, which all steps share.

const PATTERN_PERIOD: i32 = 8; //!parameter
const PATTERN_ROWS: i32 = 2; //!parameter
const PATTERN_COLS: i32 = 4; //!parameter
const INVERSE_RESPONSE_INTERVALS: u32 = 1; //!parameter

// R⁻¹ at evenly spaced pixel values from 0 to 1.
@group(0) @binding(0) var<storage, read> inverse_response_table: array<f32>;
// Exposures of the pattern [phase, row, column].
@group(0) @binding(1) var<storage, read> exposures: array<f32>;
// x: the schedule time in the pattern's period.
@group(0) @binding(2) var<uniform> schedule: vec4<u32>;

// R⁻¹(y) in p·frames: linear between the table's nodes, the first node below 0, the last one from 1 on.
fn inverse_response_of(y: f32) -> f32 {
    let position = clamp(y, 0.0, 1.0) * f32(INVERSE_RESPONSE_INTERVALS);
    let index = min(u32(position), INVERSE_RESPONSE_INTERVALS - 1u);
    let below = inverse_response_table[index];
    let above = inverse_response_table[index + 1u];
    return below + (position - f32(index)) * (above - below);
}

// Exposure in frames of the read-out that covers pixel (y, x) in a frame of the window.
fn exposure_of(frame: i32, y: i32, x: i32) -> f32 {
    let phase = (i32(schedule.x) + frame) % PATTERN_PERIOD;
    return exposures[(phase * PATTERN_ROWS + y % PATTERN_ROWS) * PATTERN_COLS + x % PATTERN_COLS];
}

// box_estimate: the (1 2 1)ᵀ(1 2 1)-weighted mean of irradiance R⁻¹(y)/e over the 3×3 neighbours, borders mirrored,
// saturated pixels left out unless all nine are (design §4, box filter).
//
// One invocation computes one pixel.

//!include common/dispatch.wgsl
//!include common/calibration.wgsl

const SATURATED: f32 = 0.98; //!parameter

struct Geometry {
    invocations: i32,
    // The output's first frame in the window.
    first_frame: i32,
    measurement_offset: i32,
    output_y: i32,
    output_x: i32,
    output_offset: i32,
}

@group(1) @binding(0) var<uniform> geometry: Geometry;
@group(1) @binding(1) var<storage, read> measurement: array<f32>;
@group(1) @binding(2) var<storage, read_write> output: array<f32>;

// Position i of n, mirrored at the borders: −1 → 1 and n → n − 2; a size of 1 repeats.
fn mirrored(i: i32, n: i32) -> i32 {
    let inside = select(i, 2 * (n - 1) - i, i >= n);
    return min(abs(inside), n - 1);
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn box_estimate(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let pixel = invocation_index(workgroup, workgroups, local);
    if (pixel >= geometry.invocations) {
        return;
    }
    let height = geometry.output_y;
    let width = geometry.output_x;
    let x = pixel % width;
    let y = pixel / width % height;
    let t = pixel / (width * height);

    var sum = 0.0;
    var weight = 0.0;
    var sum_all = 0.0;
    for (var dy = -1; dy <= 1; dy++) {
        let near_y = mirrored(y + dy, height);
        for (var dx = -1; dx <= 1; dx++) {
            let near_x = mirrored(x + dx, width);
            let measured = measurement[geometry.measurement_offset + (t * height + near_y) * width + near_x];
            let w = f32((2 - abs(dy)) * (2 - abs(dx)));
            let exposure = exposure_of(geometry.first_frame + t, near_y, near_x);
            let weighted = w * (inverse_response_of(measured) / exposure);
            sum_all += weighted;
            if (measured < SATURATED) {
                sum += weighted;
                weight += w;
            }
        }
    }
    output[geometry.output_offset + pixel] = select(sum_all / 16.0, sum / max(weight, 1.0), weight > 0.0);
}

// box_estimate: the (1 2 1)ᵀ(1 2 1)-weighted mean of irradiance R⁻¹(y)/e over the 3×3 neighbours, borders mirrored,
// saturated pixels left out unless all nine are (design §4, box filter).
//
// One invocation computes one pixel.

@group(0) @binding(0) var<storage, read> measurement: array<f32>;
@group(0) @binding(1) var<storage, read_write> output: array<f32>;
@group(0) @binding(2) var<storage, read> inverse_response_table: array<f32>;
@group(0) @binding(3) var<storage, read> exposures: array<f32>;
@group(0) @binding(4) var<uniform> schedule: vec4<u32>;

#paste dispatch
#paste inverse_response
#paste exposure

// Position i of n, mirrored at the borders: −1 → 1 and n → n − 2; a size of 1 repeats.
fn mirrored(i: i32, n: i32) -> i32 {
    let inside = select(i, 2 * (n - 1) - i, i >= n);
    return min(abs(inside), n - 1);
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn box_estimate(
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

    var sum = 0.0;
    var weight = 0.0;
    var sum_all = 0.0;
    for (var dy = -1; dy <= 1; dy++) {
        let near_y = mirrored(y + dy, OUTPUT_Y);
        for (var dx = -1; dx <= 1; dx++) {
            let near_x = mirrored(x + dx, OUTPUT_X);
            let measured = measurement[MEASUREMENT_OFFSET + (t * OUTPUT_Y + near_y) * OUTPUT_X + near_x];
            let w = f32((2 - abs(dy)) * (2 - abs(dx)));
            let weighted = w * (inverse_response_of(measured) / exposure_of(t, near_y, near_x));
            sum_all += weighted;
            if (measured < SATURATED) {
                sum += weighted;
                weight += w;
            }
        }
    }
    output[OUTPUT_OFFSET + pixel] = select(sum_all / 16.0, sum / max(weight, 1.0), weight > 0.0);
}

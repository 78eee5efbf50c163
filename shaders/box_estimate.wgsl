// box_estimate: the (1 2 1)ᵀ(1 2 1)-weighted mean of irradiance R⁻¹(y)/e over the 3×3 neighbours, borders mirrored,
// saturated pixels left out unless all nine are (design §4, box filter).

//!include common/pixelwise.wgsl

const SATURATED: f32 = 0.98; //!parameter

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
    let place = place_of(pixel);

    var sum = 0.0;
    var weight = 0.0;
    var sum_all = 0.0;
    for (var dy = -1; dy <= 1; dy++) {
        let near_y = mirrored(place.y + dy, height);
        for (var dx = -1; dx <= 1; dx++) {
            let near_x = mirrored(place.x + dx, width);
            let measured = measurement[geometry.measurement_offset + (place.t * height + near_y) * width + near_x];
            let w = f32((2 - abs(dy)) * (2 - abs(dx)));
            let weighted = w * irradiance_of(measured, place.t, near_y, near_x);
            sum_all += weighted;
            if (measured < SATURATED) {
                sum += weighted;
                weight += w;
            }
        }
    }
    output[geometry.output_offset + pixel] = select(sum_all / 16.0, sum / max(weight, 1.0), weight > 0.0);
}

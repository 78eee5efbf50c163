// log_irradiance: l(R⁻¹(y)/e) of every pixel.
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
#paste tone

@compute @workgroup_size(WORKGROUP_SIZE)
fn log_irradiance(
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
    let measured = measurement[MEASUREMENT_OFFSET + pixel];
    output[OUTPUT_OFFSET + pixel] = tone(inverse_response_of(measured) / exposure_of(t, y, x));
}

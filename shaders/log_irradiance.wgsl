// log_irradiance: l(R⁻¹(y)/e) of every pixel.
//
// One invocation computes one pixel.

//!include common/dispatch.wgsl
//!include common/calibration.wgsl
//!include common/tone.wgsl

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

@compute @workgroup_size(WORKGROUP_SIZE)
fn log_irradiance(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let pixel = invocation_index(workgroup, workgroups, local);
    if (pixel >= geometry.invocations) {
        return;
    }
    let x = pixel % geometry.output_x;
    let y = pixel / geometry.output_x % geometry.output_y;
    let t = pixel / (geometry.output_x * geometry.output_y);
    let measured = measurement[geometry.measurement_offset + pixel];
    let exposure = exposure_of(geometry.first_frame + t, y, x);
    output[geometry.output_offset + pixel] = tone(inverse_response_of(measured) / exposure);
}

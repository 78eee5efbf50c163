// log_irradiance: l(R⁻¹(y)/e) of every pixel.

//!include common/pixelwise.wgsl
//!include common/tone.wgsl

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
    let place = place_of(pixel);
    let measured = measurement[geometry.measurement_offset + pixel];
    output[geometry.output_offset + pixel] = tone(irradiance_of(measured, place.t, place.y, place.x));
}

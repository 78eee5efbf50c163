// pixelwise: what kernels share that compute one value of each pixel from the measurement and the camera's tables.
//
// One invocation computes one pixel.

//!include common/dispatch.wgsl
//!include common/calibration.wgsl

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

struct Place {
    t: i32,
    y: i32,
    x: i32,
}

// Where the pixel lies that stands at `pixel` in the output.
fn place_of(pixel: i32) -> Place {
    let row = pixel / geometry.output_x;
    return Place(row / geometry.output_y, row % geometry.output_y, pixel % geometry.output_x);
}

// Irradiance R⁻¹(y)/e of what was measured at row y and column x of frame t.
fn irradiance_of(measured: f32, t: i32, y: i32, x: i32) -> f32 {
    return inverse_response_of(measured) / exposure_of(geometry.first_frame + t, y, x);
}

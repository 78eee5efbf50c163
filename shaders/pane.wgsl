// pane: a picture's texture in a rectangle of the screen.

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) at: vec2<f32>,
}

// Left, top, right and bottom in clip space.
@group(0) @binding(0) var<uniform> place: vec4<f32>;
@group(0) @binding(1) var picture: texture_2d<f32>;
@group(0) @binding(2) var sampling: sampler;

@vertex
fn corner(@builtin(vertex_index) index: u32) -> Corner {
    let at = vec2(f32(index & 1u), f32(index >> 1u));
    return Corner(vec4(mix(place.xy, place.zw, at), 0.0, 1.0), at);
}

@fragment
fn shown(corner: Corner) -> @location(0) vec4<f32> {
    return textureSample(picture, sampling, corner.at);
}

// Where the screen's texture encodes what it is given, as sRGB.
@fragment
fn shown_encoded(corner: Corner) -> @location(0) vec4<f32> {
    let colour = textureSample(picture, sampling, corner.at).rgb;
    let linear = select(pow((colour + 0.055) / 1.055, vec3(2.4)), colour / 12.92, colour <= vec3(0.04045));
    return vec4(linear, 1.0);
}

// pane: a picture's texture in a rectangle of the screen, and black around it.

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) at: vec2<f32>,
}

struct Place {
    // Left, top, right and bottom of the rectangle in clip space, and where they are in the picture, whose corners are
    // 0 and 1.
    screen: vec4<f32>,
    picture: vec4<f32>,
}

@group(0) @binding(0) var<uniform> place: Place;
@group(0) @binding(1) var picture: texture_2d<f32>;
@group(0) @binding(2) var sampling: sampler;

@vertex
fn corner(@builtin(vertex_index) index: u32) -> Corner {
    let at = vec2(f32(index & 1u), f32(index >> 1u));
    let position = mix(place.screen.xy, place.screen.zw, at);
    return Corner(vec4(position, 0.0, 1.0), mix(place.picture.xy, place.picture.zw, at));
}

fn colour(at: vec2<f32>) -> vec3<f32> {
    let sampled = textureSample(picture, sampling, at).rgb;
    return select(vec3(0.0), sampled, all(at >= vec2(0.0)) && all(at <= vec2(1.0)));
}

@fragment
fn shown(corner: Corner) -> @location(0) vec4<f32> {
    return vec4(colour(corner.at), 1.0);
}

// Where the screen's texture encodes what it is given, as sRGB.
@fragment
fn shown_encoded(corner: Corner) -> @location(0) vec4<f32> {
    let v = colour(corner.at);
    let linear = select(pow((v + 0.055) / 1.055, vec3(2.4)), v / 12.92, v <= vec3(0.04045));
    return vec4(linear, 1.0);
}

// Four feature channels of a pixel, stored as pairs of f16 in u32, which every adapter can read and write.

const STORED_LARGEST = 65504.0;

alias StoredVector = vec2<u32>;

fn stored_values(v: StoredVector) -> vec4<f32> {
    return vec4<f32>(unpack2x16float(v.x), unpack2x16float(v.y));
}

// What does not fit is reported elsewhere, and must stay finite here.
fn stored_vector(v: vec4<f32>) -> StoredVector {
    let c = clamp(v, vec4<f32>(-STORED_LARGEST), vec4<f32>(STORED_LARGEST));
    return vec2<u32>(pack2x16float(c.xy), pack2x16float(c.zw));
}

// As stored_f32.wgsl, read 64 bits at a time.

alias StoredVector = vec2<u64>;

fn stored_values(v: StoredVector) -> vec4<f32> {
    return bitcast<vec4<f32>>(vec4<u32>(u32(v.x), u32(v.x >> 32u), u32(v.y), u32(v.y >> 32u)));
}

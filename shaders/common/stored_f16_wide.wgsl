// As stored_f16.wgsl, read 64 bits at a time.

alias StoredVector = u64;

fn stored_values(v: StoredVector) -> vec4<f32> {
    return vec4<f32>(unpack2x16float(u32(v)), unpack2x16float(u32(v >> 32u)));
}

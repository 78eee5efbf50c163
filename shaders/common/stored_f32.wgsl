// Four feature channels of a pixel, stored as four f32.

alias StoredVector = vec4<f32>;

fn stored_values(v: StoredVector) -> vec4<f32> {
    return v;
}

fn stored_vector(v: vec4<f32>) -> StoredVector {
    return v;
}

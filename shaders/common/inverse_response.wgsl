// R⁻¹(y) in p·frames: linear between the table's nodes, the first node below 0, the last one from 1 on.
fn inverse_response_of(y: f32) -> f32 {
    let position = clamp(y, 0.0, 1.0) * f32(INVERSE_RESPONSE_INTERVALS);
    let index = min(u32(position), INVERSE_RESPONSE_INTERVALS - 1u);
    let below = inverse_response_table[index];
    let above = inverse_response_table[index + 1u];
    return below + (position - f32(index)) * (above - below);
}

// activation: what a convolution applies to sum and bias (weights-format/README.md).

const LEAKY_RELU = 1u;
const SIGMOID = 2u;
const SOFTPLUS = 3u;
// One of these, or 0 for none.
const ACTIVATION: u32 = 0; //!parameter
// Slope of LEAKY_RELU, floor of SOFTPLUS.
const ACTIVATION_PARAMETER: f32 = 0.0; //!parameter

// 1/(1 + e⁻ᵛ), without overflow.
fn sigmoid(v: vec4<f32>) -> vec4<f32> {
    let e = exp(-abs(v));
    return select(vec4<f32>(1.0), e, v < vec4<f32>()) / (1.0 + e);
}

// ln(1 + eᵛ), without overflow.
fn softplus(v: vec4<f32>) -> vec4<f32> {
    return max(v, vec4<f32>()) + log(1.0 + exp(-abs(v)));
}

fn activation(v: vec4<f32>) -> vec4<f32> {
    switch ACTIVATION {
        case LEAKY_RELU: { return select(v, ACTIVATION_PARAMETER * v, v < vec4<f32>()); }
        case SIGMOID: { return sigmoid(v); }
        case SOFTPLUS: { return softplus(v) + ACTIVATION_PARAMETER; }
        default: { return v; }
    }
}

// What follows the sum of a convolution (weights-format/README.md): v = activation(sum + bias), then
// v = v·scale + shift, then v = v + added.

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

// Result for the four channels of `vector`, of pixel number `pixel` of the output.
fn epilogue(sum: vec4<f32>, vector: i32, pixel: i32) -> vec4<f32> {
    var v = activation(sum + terms[vector]);
    if (NORM) {
        v = v * terms[WEIGHT_VECTORS + vector] + terms[2 * WEIGHT_VECTORS + vector];
    }
    if (ADD) {
        v += added[ADDED_OFFSET + pixel * ADDED_STRIDE + vector];
    }
    return v;
}

// Writes four channels of a pixel, unless they are padding.
fn store(sum: vec4<f32>, vector: i32, pixel: i32, inside: bool) {
    if (inside && vector < OUTPUT_VECTORS) {
        output[OUTPUT_OFFSET + pixel * OUTPUT_STRIDE + vector] = epilogue(sum, vector, pixel);
    }
}

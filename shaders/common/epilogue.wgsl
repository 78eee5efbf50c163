// What follows the sum of a convolution (weights-format/README.md): v = activation(sum + bias), then
// v = v·scale + shift, then v = v + added. The sum is in the units of the input and of the weights, and where the output
// is f16, it is stored in a unit too. Units are powers of two, which change no digit.
//
// Rows of terms: units of the sum, bias, scale, shift, and parts of the output's unit that 1 is.

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
    var v = activation(sum * terms[vector] + terms[TERM_VECTORS + vector]);
    if (NORM) {
        v = v * terms[2 * TERM_VECTORS + vector] + terms[3 * TERM_VECTORS + vector];
    }
    if (ADD) {
        v += added_values(added[ADDED_OFFSET + pixel * ADDED_STRIDE + vector]);
    }
    return v;
}

// Where the channels of input pixel (t, y, x) begin. Pixels of the padding are read from zeros behind the slot.
fn input_at(t: i32, y: i32, x: i32) -> i32 {
    let inside = y >= 0 && y < INPUT_Y && x >= 0 && x < INPUT_X;
    return select(INPUT_ZEROS, INPUT_OFFSET + ((t * INPUT_Y + y) * INPUT_X + x) * INPUT_STRIDE, inside);
}

// Writes four channels of a pixel, unless they are padding, and keeps the largest magnitude.
fn store(sum: vec4<f32>, vector: i32, pixel: i32, inside: bool, largest: ptr<function, f32>) {
    if (inside && vector < OUTPUT_VECTORS) {
        var v = epilogue(sum, vector, pixel);
        if (LIMITED) {
            let a = abs(v);
            *largest = max(*largest, max(max(a.x, a.y), max(a.z, a.w)));
            v *= terms[4 * TERM_VECTORS + vector];
        }
        output[OUTPUT_OFFSET + pixel * OUTPUT_STRIDE + vector] = output_vector(v);
    }
}

// Keeps a magnitude beyond what the output's format can hold. Magnitudes have the order of their bits.
fn report(largest: f32) {
    if (LIMITED && largest * terms[4 * TERM_VECTORS].x > LIMIT) {
        atomicMax(&overflow, bitcast<u32>(largest));
    }
}

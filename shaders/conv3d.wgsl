// conv3d: convolution with zero padding, then the epilogue (weights-format/README.md):
//
//     out[t, y, x, o] = epilogue(Σ weight[o, i, tap] · in[(t, y, x) · stride + tap − padding, i])
//
// One invocation computes a block: PIXELS neighbours along x, and VECTORS times four output channels. A line with
// $p stands for one line for each of the pixels, one with $j for one line for each of the vectors. Neighbouring
// invocations compute neighbouring channels: what they read of the weights and what they write is contiguous, and
// what they read of the input is the same.

@group(0) @binding(0) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> added: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> output: array<vec4<f32>>;
// Weights [tap][in channel][out channel] and terms [bias, scale, shift][out channel], zero for padding channels.
@group(0) @binding(3) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> terms: array<vec4<f32>>;

#paste dispatch
#paste epilogue

@compute @workgroup_size(WORKGROUP_SIZE)
fn conv3d(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = invocation_index(workgroup, local);
    if (invocation >= INVOCATIONS) {
        return;
    }
    // Vectors `group`, `group` + GROUPS, … of the output, from pixel (t, y, x) on.
    let group = invocation % GROUPS;
    let block = invocation / GROUPS;
    let x = block % BLOCKS_X * PIXELS;
    let y = block / BLOCKS_X % OUTPUT_Y;
    let t = block / (BLOCKS_X * OUTPUT_Y);

    var sum_$p_$j = vec4<f32>();
    for (var tap_t = 0; tap_t < KERNEL_T; tap_t++) {
        let in_t = t * STRIDE_T + tap_t - PADDING_T;
        if (in_t < 0 || in_t >= INPUT_T) {
            continue;
        }
        for (var tap_y = 0; tap_y < KERNEL_Y; tap_y++) {
            let in_y = y * STRIDE_Y + tap_y - PADDING_Y;
            if (in_y < 0 || in_y >= INPUT_Y) {
                continue;
            }
            let row = INPUT_OFFSET + (in_t * INPUT_Y + in_y) * INPUT_X * INPUT_STRIDE;
            for (var tap_x = 0; tap_x < KERNEL_X; tap_x += TAPS) {
                // Pixels of the padding are read from zeros behind the slot.
                let in_x_$q = x * STRIDE_X + $q * COLUMN_STEP + tap_x - PADDING_X;
                let inside_$q = in_x_$q >= 0 && in_x_$q < INPUT_X;
                let pixel_$q = select(INPUT_ZEROS, row + in_x_$q * INPUT_STRIDE, inside_$q);
                var weight = ((tap_t * KERNEL_Y + tap_y) * KERNEL_X + tap_x) * TAP_WEIGHTS + group;
                for (var vector = 0; vector < INPUT_VECTORS; vector++) {
                    #paste products
                }
            }
        }
    }

    let first = (t * OUTPUT_Y + y) * OUTPUT_X + x;
    store(sum_$p_$j, group + $j * GROUPS, first + $p, x + $p < OUTPUT_X);
}

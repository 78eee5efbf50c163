// conv_transpose3d: transposed convolution, then the epilogue (weights-format/README.md):
//
//     out[o] = epilogue(Σ weight[i, o, tap] · in[(o + padding − tap) / stride, i])
//
// over the taps for which the division is exact and inside of the input. Outputs q · stride + phase, for one phase
// along t, y and x, all use the same taps, so that they are a convolution of their own.
//
// One invocation computes a block: PIXELS inputs q along x, and VECTORS times four output channels, for one phase.
// Lines with $p and $j, and the order of invocations, are as in conv3d.wgsl.

@group(0) @binding(0) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> added: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> output: array<vec4<f32>>;
// Weights [tap][in channel][out channel] and terms [bias, scale, shift][out channel], zero for padding channels.
@group(0) @binding(3) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> terms: array<vec4<f32>>;

#paste dispatch
#paste epilogue

@compute @workgroup_size(WORKGROUP_SIZE)
fn conv_transpose3d(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = invocation_index(workgroup, local);
    if (invocation >= INVOCATIONS) {
        return;
    }
    // Vectors `group`, `group` + GROUPS, … of the output, from input (t, y, x) on.
    let group = invocation % GROUPS;
    let block = invocation / GROUPS;
    let x = block % BLOCKS_X * PIXELS;
    let y = block / BLOCKS_X % INPUT_Y;
    let t = block / (BLOCKS_X * INPUT_Y) % INPUT_T;
    let phase = block / (BLOCKS_X * INPUT_Y * INPUT_T);
    let phase_x = phase % STRIDE_X;
    let phase_y = phase / STRIDE_X % STRIDE_Y;
    let phase_t = phase / (STRIDE_X * STRIDE_Y);

    var sum_$p_$j = vec4<f32>();
    for (var tap_t = (phase_t + PADDING_T) % STRIDE_T; tap_t < KERNEL_T; tap_t += STRIDE_T) {
        let in_t = t + (phase_t + PADDING_T - tap_t) / STRIDE_T;
        if (in_t < 0 || in_t >= INPUT_T) {
            continue;
        }
        for (var tap_y = (phase_y + PADDING_Y) % STRIDE_Y; tap_y < KERNEL_Y; tap_y += STRIDE_Y) {
            let in_y = y + (phase_y + PADDING_Y - tap_y) / STRIDE_Y;
            if (in_y < 0 || in_y >= INPUT_Y) {
                continue;
            }
            let row = INPUT_OFFSET + (in_t * INPUT_Y + in_y) * INPUT_X * INPUT_STRIDE;
            for (var tap_x = (phase_x + PADDING_X) % STRIDE_X; tap_x < KERNEL_X; tap_x += STRIDE_X) {
                // Pixels of the padding are read from zeros behind the slot.
                let in_x_$q = x + $q + (phase_x + PADDING_X - tap_x) / STRIDE_X;
                let inside_$q = in_x_$q >= 0 && in_x_$q < INPUT_X;
                let pixel_$q = select(INPUT_ZEROS, row + in_x_$q * INPUT_STRIDE, inside_$q);
                var weight = ((tap_t * KERNEL_Y + tap_y) * KERNEL_X + tap_x) * TAP_WEIGHTS + group;
                for (var vector = 0; vector < INPUT_VECTORS; vector++) {
                    #paste products
                }
            }
        }
    }

    let first = ((t * STRIDE_T + phase_t) * OUTPUT_Y + y * STRIDE_Y + phase_y) * OUTPUT_X + x * STRIDE_X + phase_x;
    store(sum_$p_$j, group + $j * GROUPS, first + $p * STRIDE_X, x + $p < INPUT_X);
}

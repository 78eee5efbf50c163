// conv_transpose3d: transposed convolution, then the epilogue (weights-format/README.md):
//
//     out[o] = epilogue(Σ weight[i, o, tap] · in[(o + padding − tap) / stride, i])
//
// over the taps for which the division is exact and inside of the input. Outputs q · stride + phase, for one phase
// along t, y and x, all use the same taps, so that they are a convolution of their own.
//
// A team of LANES invocations computes the outputs of LANES · PIXELS inputs q of a frame, for one phase, and VECTORS
// times four output channels of them. Teams and repeated lines are as in conv3d.wgsl.

@group(0) @binding(0) var<storage, read> input: array<INPUT_VECTOR>;
@group(0) @binding(1) var<storage, read> added: array<ADDED_VECTOR>;
@group(0) @binding(2) var<storage, read_write> output: array<OUTPUT_VECTOR>;
// Weights (see common/products.wgsl) and terms (see common/epilogue.wgsl) of each output channel.
@group(0) @binding(3) var<storage, read> weights: array<WEIGHTS_VECTOR>;
@group(0) @binding(4) var<storage, read> terms: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> overflow: atomic<u32>;

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
    #paste team
    let t = block / BLOCKS % INPUT_T;
    let phase = block / (BLOCKS * INPUT_T);
    let phase_x = phase % STRIDE_X;
    let phase_y = phase / STRIDE_X % STRIDE_Y;
    let phase_t = phase / (STRIDE_X * STRIDE_Y);
    let first = block % BLOCKS * (PIXELS * LANES) + lane;
    let pixel_$p = first + $p * LANES;
    let y_$p = pixel_$p / INPUT_X;
    let x_$p = pixel_$p % INPUT_X;

    var sum_$p_$j = vec4<f32>();
    for (var tap_t = (phase_t + PADDING_T) % STRIDE_T; tap_t < KERNEL_T; tap_t += STRIDE_T) {
        let in_t = t + (phase_t + PADDING_T - tap_t) / STRIDE_T;
        if (in_t < 0 || in_t >= INPUT_T) {
            continue;
        }
        for (var tap_y = (phase_y + PADDING_Y) % STRIDE_Y; tap_y < KERNEL_Y; tap_y += STRIDE_Y) {
            let shift_y = (phase_y + PADDING_Y - tap_y) / STRIDE_Y;
            for (var tap_x = (phase_x + PADDING_X) % STRIDE_X; tap_x < KERNEL_X; tap_x += STRIDE_X) {
                let shift_x = (phase_x + PADDING_X - tap_x) / STRIDE_X;
                let at_$p = input_at(in_t, y_$p + shift_y, x_$p + shift_x);
                var weight = ((tap_t * KERNEL_Y + tap_y) * KERNEL_X + tap_x) * TAP_WEIGHTS + group * LANES + lane;
                for (var vector = 0; vector < INPUT_VECTORS; vector++) {
                    #paste products
                }
            }
        }
    }

    let out_t = t * STRIDE_T + phase_t;
    let out_$p = (out_t * OUTPUT_Y + y_$p * STRIDE_Y + phase_y) * OUTPUT_X + x_$p * STRIDE_X + phase_x;
    var largest = 0.0;
    store(sum_$p_$j, group + $j * GROUPS, out_$p, pixel_$p < FRAME, &largest);
    report(largest);
}

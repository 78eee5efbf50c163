// conv3d: convolution with zero padding, then the epilogue (weights-format/README.md):
//
//     out[t, y, x, o] = epilogue(Σ weight[o, i, tap] · in[(t, y, x) · stride + tap − padding, i])
//
// A team of LANES invocations computes LANES · PIXELS pixels of a frame, and VECTORS times four output channels of
// them. Lines with $p, $j, $i or $w are repeated for the parts of this block (see products.wgsl); what invocations of a
// team share, and how neighbours lie, is explained in common/team.wgsl.

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
fn conv3d(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = invocation_index(workgroup, local);
    if (invocation >= INVOCATIONS) {
        return;
    }
    #paste team
    let t = block / BLOCKS;
    let first = block % BLOCKS * (PIXELS * LANES) + lane;
    let pixel_$p = first + $p * LANES;
    let y_$p = pixel_$p / OUTPUT_X * STRIDE_Y - PADDING_Y;
    let x_$p = pixel_$p % OUTPUT_X * STRIDE_X - PADDING_X;

    var sum_$p_$j = vec4<f32>();
    for (var tap_t = 0; tap_t < KERNEL_T; tap_t++) {
        let in_t = t * STRIDE_T + tap_t - PADDING_T;
        if (in_t < 0 || in_t >= INPUT_T) {
            continue;
        }
        for (var tap_y = 0; tap_y < KERNEL_Y; tap_y++) {
            for (var tap_x = 0; tap_x < KERNEL_X; tap_x++) {
                let at_$p = input_at(in_t, y_$p + tap_y, x_$p + tap_x);
                var weight = ((tap_t * KERNEL_Y + tap_y) * KERNEL_X + tap_x) * TAP_WEIGHTS + group * LANES + lane;
                for (var vector = 0; vector < INPUT_VECTORS; vector++) {
                    #paste products
                }
            }
        }
    }

    var largest = 0.0;
    store(sum_$p_$j, group + $j * GROUPS, t * FRAME + pixel_$p, pixel_$p < FRAME, &largest);
    report(largest);
}

// conv3d: convolution with zero padding, then the epilogue (weights-format/README.md):
//
//     out[t, y, x, o] = epilogue(Σ weight[o, i, tap] · in[(t, y, x) · stride + tap − padding, i])
//
// How the work is divided is explained in common/convolution.wgsl. Blocks lie in the frames of the output.

//!include common/convolution.wgsl

@compute @workgroup_size(WORKGROUP_SIZE)
fn conv3d(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = invocation_index(workgroup, workgroups, local);
    if (invocation >= geometry.invocations) {
        return;
    }
    let team = team_of(invocation);
    let t = team.block / geometry.blocks;
    let pixels = pixels_of(team);
    var y: Pixels;
    var x: Pixels;
    for (var p = 0; p < PIXELS; p++) { //!static
        y[p] = pixels[p] / geometry.output_x * STRIDE_Y - PADDING_Y;
        x[p] = pixels[p] % geometry.output_x * STRIDE_X - PADDING_X;
    }

    var sums: Sums;
    for (var tap_t = 0; tap_t < KERNEL_T; tap_t++) {
        let in_t = t * STRIDE_T + tap_t - PADDING_T;
        if (in_t < 0 || in_t >= geometry.input_t) {
            continue;
        }
        for (var tap_y = 0; tap_y < KERNEL_Y; tap_y++) {
            for (var tap_x = 0; tap_x < KERNEL_X; tap_x++) {
                var at: Pixels;
                for (var p = 0; p < PIXELS; p++) { //!static
                    at[p] = input_at(in_t, y[p] + tap_y, x[p] + tap_x);
                }
                add_products(&sums, at, weights_at(team, tap_t, tap_y, tap_x));
            }
        }
    }

    var largest = 0.0;
    for (var p = 0; p < PIXELS; p++) { //!static
        let pixel = t * geometry.frame + pixels[p];
        for (var j = 0; j < VECTORS; j++) { //!static
            store(sums[p][j], team.group + j * GROUPS, pixel, pixels[p] < geometry.frame, &largest);
        }
    }
    report(largest);
}

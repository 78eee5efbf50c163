// conv_transpose3d: transposed convolution, then the epilogue (weights-format/README.md):
//
//     out[o] = epilogue(Σ weight[i, o, tap] · in[(o + padding − tap) / stride, i])
//
// over the taps for which the division is exact and inside of the input. Outputs q · stride + phase, for one phase
// along t, y and x, all use the same taps, so that they are a convolution of their own.
//
// How the work is divided is explained in common/convolution.wgsl. Blocks lie in the frames of the inputs q, for one phase.

//!include common/convolution.wgsl

@compute @workgroup_size(WORKGROUP_SIZE)
fn conv_transpose3d(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = invocation_index(workgroup, workgroups, local);
    if (invocation >= geometry.invocations) {
        return;
    }
    let team = team_of(invocation);
    let t = team.block / geometry.blocks % geometry.input_t;
    let phase = team.block / (geometry.blocks * geometry.input_t);
    let phase_x = phase % STRIDE_X;
    let phase_y = phase / STRIDE_X % STRIDE_Y;
    let phase_t = phase / (STRIDE_X * STRIDE_Y);
    let pixels = pixels_of(team);
    var y: Pixels;
    var x: Pixels;
    for (var p = 0; p < PIXELS; p++) { //!static
        y[p] = pixels[p] / geometry.input_x;
        x[p] = pixels[p] % geometry.input_x;
    }

    var sums: Sums;
    for (var tap_t = (phase_t + PADDING_T) % STRIDE_T; tap_t < KERNEL_T; tap_t += STRIDE_T) {
        let in_t = t + (phase_t + PADDING_T - tap_t) / STRIDE_T;
        if (in_t < 0 || in_t >= geometry.input_t) {
            continue;
        }
        for (var tap_y = (phase_y + PADDING_Y) % STRIDE_Y; tap_y < KERNEL_Y; tap_y += STRIDE_Y) {
            let shift_y = (phase_y + PADDING_Y - tap_y) / STRIDE_Y;
            for (var tap_x = (phase_x + PADDING_X) % STRIDE_X; tap_x < KERNEL_X; tap_x += STRIDE_X) {
                let shift_x = (phase_x + PADDING_X - tap_x) / STRIDE_X;
                var at: Pixels;
                for (var p = 0; p < PIXELS; p++) { //!static
                    at[p] = input_at(in_t, y[p] + shift_y, x[p] + shift_x);
                }
                add_products(&sums, at, weights_at(team, tap_t, tap_y, tap_x));
            }
        }
    }

    let out_t = t * STRIDE_T + phase_t;
    var largest = 0.0;
    for (var p = 0; p < PIXELS; p++) { //!static
        let out_y = out_t * geometry.output_y + y[p] * STRIDE_Y + phase_y;
        let pixel = out_y * geometry.output_x + x[p] * STRIDE_X + phase_x;
        for (var j = 0; j < VECTORS; j++) { //!static
            store(sums[p][j], team.group + j * GROUPS, pixel, pixels[p] < geometry.frame, &largest);
        }
    }
    report(largest);
}

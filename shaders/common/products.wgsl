// Adds the products of four input channels with the weights of TAPS taps along x, for the PIXELS · VECTORS · 4 sums of
// a block, and steps to the next four input channels. Layers of fewer than four input channels have fewer weights.
let column_$q = input[pixel_$q + vector];
let weight_0_$k_$j = weights[weight + $k * TAP_WEIGHTS + $j * GROUPS];
sum_$p_$j = fma(vec4<f32>(column_$c.x), weight_0_$k_$j, sum_$p_$j);
if (WEIGHT_ROWS > 1) {
    let weight_1_$k_$j = weights[weight + $k * TAP_WEIGHTS + WEIGHT_VECTORS + $j * GROUPS];
    sum_$p_$j = fma(vec4<f32>(column_$c.y), weight_1_$k_$j, sum_$p_$j);
}
if (WEIGHT_ROWS > 2) {
    let weight_2_$k_$j = weights[weight + $k * TAP_WEIGHTS + 2 * WEIGHT_VECTORS + $j * GROUPS];
    sum_$p_$j = fma(vec4<f32>(column_$c.z), weight_2_$k_$j, sum_$p_$j);
}
if (WEIGHT_ROWS > 3) {
    let weight_3_$k_$j = weights[weight + $k * TAP_WEIGHTS + 3 * WEIGHT_VECTORS + $j * GROUPS];
    sum_$p_$j = fma(vec4<f32>(column_$c.w), weight_3_$k_$j, sum_$p_$j);
}
weight += 4 * WEIGHT_VECTORS;

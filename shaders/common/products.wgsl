// Adds the products of four input channels of PIXELS pixels with the weights of VECTORS · 4 output channels, and steps
// to the next four input channels. Layers of fewer than four input channels have fewer weights.
let in_$p = input[pixel_$p + vector];
let weight_0_$j = weights[weight + $j * GROUPS];
sum_$p_$j += in_$p.x * weight_0_$j;
if (WEIGHT_ROWS > 1) {
    let weight_1_$j = weights[weight + WEIGHT_VECTORS + $j * GROUPS];
    sum_$p_$j += in_$p.y * weight_1_$j;
}
if (WEIGHT_ROWS > 2) {
    let weight_2_$j = weights[weight + 2 * WEIGHT_VECTORS + $j * GROUPS];
    sum_$p_$j += in_$p.z * weight_2_$j;
}
if (WEIGHT_ROWS > 3) {
    let weight_3_$j = weights[weight + 3 * WEIGHT_VECTORS + $j * GROUPS];
    sum_$p_$j += in_$p.w * weight_3_$j;
}
weight += 4 * WEIGHT_VECTORS;

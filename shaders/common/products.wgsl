// Adds the products of four input channels with the weights of one tap, for the PIXELS · VECTORS · 4 sums of a block,
// and steps to the next four input channels.
//
// Row $i of vector $j, the weights from input channel $i to four output channels, is number 4j + i of the team's rows.
// The weights lie as [tap][four input channels][load][group][lane]: row n is loaded by lane n % LANES in load
// n / LANES. $row is the row in the registers of the whole team, $x the name of component $i.
let loaded_$w = weights_values(weights[weight + $w * (GROUPS * LANES)]);
let column_$p = input_values(input[at_$p + vector]);
#each $j
let row_$i_$j = $row;
sum_$p_$j = fma(vec4<f32>(column_$p.$x), row_$i_$j, sum_$p_$j);
#end
weight += LOADS * GROUPS * LANES;

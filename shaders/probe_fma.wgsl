// Not a kernel: chains of multiply-adds in registers, to measure how many operations per second an adapter can do.
//
// A line with `$i` is repeated for each of several accumulators, and the line `#rounds` stands for rounds of one
// multiply-add per accumulator. The compiler knows neither x nor y, and all sums are written, so nothing can be left
// out.

struct Parameters {
    x: vec4<f32>,
    y: vec4<f32>,
    iterations: vec4<u32>,
}

@group(0) @binding(0) var<storage, read> parameters: Parameters;
@group(0) @binding(1) var<storage, read_write> output: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn probe_fma(@builtin(global_invocation_id) id: vec3<u32>) {
    let x = parameters.x;
    let y = parameters.y;
    var sum_$i = vec4<f32>(f32(id.x)) + vec4<f32>($i.0);
    for (var i = 0u; i < parameters.iterations.x; i++) {
        #rounds
    }
    var sum = vec4<f32>();
    sum += sum_$i;
    output[id.x] = sum;
}

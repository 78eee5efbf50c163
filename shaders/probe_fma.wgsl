// Not a kernel: chains of multiply-adds in registers, to measure how many operations per second an adapter can do.
//
// The compiler knows neither x nor y, and all sums are written, so nothing can be left out.

const WORKGROUP_SIZE: u32 = 256; //!parameter
const ACCUMULATORS: i32 = 1; //!parameter
// Multiply-adds on each accumulator in one turn of the loop.
const ROUNDS: i32 = 1; //!parameter

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
    var sums: array<vec4<f32>, ACCUMULATORS>;
    for (var i = 0; i < ACCUMULATORS; i++) { //!static
        sums[i] = vec4<f32>(f32(id.x)) + vec4<f32>(f32(i));
    }
    for (var turn = 0u; turn < parameters.iterations.x; turn++) {
        for (var round = 0; round < ROUNDS; round++) { //!static
            for (var i = 0; i < ACCUMULATORS; i++) { //!static
                sums[i] = fma(sums[i], x, y);
            }
        }
    }
    var sum = vec4<f32>();
    for (var i = 0; i < ACCUMULATORS; i++) { //!static
        sum += sums[i];
    }
    output[id.x] = sum;
}

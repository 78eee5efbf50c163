// Not a kernel: a copy from one buffer to another, to measure how many bytes per second an adapter moves.

const WORKGROUP_SIZE: u32 = 256; //!parameter

@group(0) @binding(0) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> output: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn probe_copy(@builtin(global_invocation_id) id: vec3<u32>) {
    output[id.x] = input[id.x];
}

// dispatch: which invocation this is. Workgroups are folded into two dimensions, since one dimension holds 65535 at
// most.

const WORKGROUP_SIZE: u32 = 64; //!parameter

fn invocation_index(workgroup: vec3<u32>, workgroups: vec3<u32>, local: u32) -> i32 {
    return i32((workgroup.y * workgroups.x + workgroup.x) * WORKGROUP_SIZE + local);
}

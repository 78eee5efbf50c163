// Which invocation this is. Workgroups are folded into two dimensions, since one dimension holds 65535 at most.
fn invocation_index(workgroup: vec3<u32>, local: u32) -> i32 {
    return i32((workgroup.y * WORKGROUPS_X + workgroup.x) * WORKGROUP_SIZE + local);
}

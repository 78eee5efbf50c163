//! What the operating system tells.

use sysinfo::System;

/// Bytes of memory that this process may use: the machine's, or what a container leaves of it.
pub fn memory() -> Option<u64> {
    let mut system = System::new();
    system.refresh_memory();
    let limit = system.cgroup_limits().map(|limits| limits.total_memory).filter(|&bytes| bytes > 0);
    let all = Some(system.total_memory()).filter(|&bytes| bytes > 0);
    all.map(|all| limit.map_or(all, |limit| limit.min(all)))
}

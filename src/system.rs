//! What the operating system tells.

use std::path::Path;

use sysinfo::System;

/// Bytes of a line of /proc/self/status, such as `VmRSS:`; nothing where the system has none (Linux has one).
pub fn status(line: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let text = status.lines().find_map(|text| text.strip_prefix(line))?;
    text.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kilobytes| 1024 * kilobytes)
}

/// Bytes of memory that this process may use: the machine's, or what a container leaves of it.
pub fn memory() -> Option<u64> {
    let mut system = System::new();
    system.refresh_memory();
    let limit = system.cgroup_limits().map(|limits| limits.total_memory).filter(|&bytes| bytes > 0);
    let all = Some(system.total_memory()).filter(|&bytes| bytes > 0);
    all.map(|all| limit.map_or(all, |limit| limit.min(all)))
}

/// Whether two names are of one file or folder, also through links. What is not there is the same as nothing.
pub fn is_same_file(a: &Path, b: &Path) -> bool {
    #[cfg(unix)]
    let identity = |path: &Path| {
        use std::os::unix::fs::MetadataExt;
        std::fs::metadata(path).ok().map(|meta| (meta.dev(), meta.ino()))
    };
    #[cfg(not(unix))]
    let identity = |path: &Path| std::fs::canonicalize(path).ok();
    identity(a).is_some_and(|a| Some(a) == identity(b))
}

//! What the operating system tells: memory, folders, time.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use sysinfo::System;

/// Version of this program, with the commit that it was made of where that is known.
pub fn version() -> &'static str {
    if env!("PIX2HDR_COMMIT").is_empty() {
        env!("CARGO_PKG_VERSION")
    } else {
        concat!(env!("CARGO_PKG_VERSION"), " (", env!("PIX2HDR_COMMIT"), ")")
    }
}

/// Bytes of a line of /proc/self/status, such as `VmRSS:`; nothing where the system has none (Linux has one).
pub fn status(line: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let text = status.lines().find_map(|text| text.strip_prefix(line))?;
    text.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kilobytes| 1024 * kilobytes)
}

/// Bytes of memory that this process may use: the machine's, or what a container, a control group or `ulimit -v` leaves
/// of it.
pub fn memory() -> Option<u64> {
    let mut system = System::new();
    system.refresh_memory();
    let all = Some(system.total_memory()).filter(|&bytes| bytes > 0);
    let read = |path: &str| fs::read_to_string(path).ok();
    let address_space = read("/proc/self/limits").and_then(|limits| address_space(&limits));
    let groups = read("/proc/self/cgroup").unwrap_or_default();
    let group = group_memory(&groups, |path| fs::read_to_string(Path::new("/sys/fs/cgroup").join(path)).ok());
    [all, address_space, group].into_iter().flatten().min()
}

/// What `ulimit -v` allows, of the text of /proc/self/limits.
fn address_space(limits: &str) -> Option<u64> {
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// The least memory that the control groups of /proc/self/cgroup and those above them allow, of version 1 and 2; `read`
/// reads one of their files. Within a container only the groups from its own root on can be seen.
fn group_memory(groups: &str, read: impl Fn(&Path) -> Option<String>) -> Option<u64> {
    let limits = groups.lines().filter_map(|line| {
        let [_, controllers, group] = line.splitn(3, ':').collect::<Vec<_>>().try_into().ok()?;
        let (root, file) = match controllers {
            "" => ("", "memory.max"),
            _ if controllers.split(',').any(|name| name == "memory") => ("memory", "memory.limit_in_bytes"),
            _ => return None,
        };
        let above = Path::new(group.trim_start_matches('/')).ancestors();
        let limit =
            |folder: &Path| read(&Path::new(root).join(folder).join(file))?.trim().parse::<u64>().ok();
        above.filter_map(limit).min()
    });
    limits.min()
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

/// The user's folder for what can be made again.
pub fn cache_folder() -> Option<PathBuf> {
    user_folder(["LOCALAPPDATA", "Library/Caches"], ["XDG_CACHE_HOME", ".cache"])
}

/// The user's folder for settings.
pub fn settings_folder() -> Option<PathBuf> {
    user_folder(["APPDATA", "Library/Application Support"], ["XDG_CONFIG_HOME", ".config"])
}

/// This program's part of one of the user's folders: a variable on Windows and a place at home on macOS; elsewhere a
/// variable, or a place at home where it is not set.
fn user_folder([windows, mac]: [&str; 2], [variable, place]: [&str; 2]) -> Option<PathBuf> {
    let of = |name: &str| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let at_home = |place: &str| of("HOME").map(|home| home.join(place));
    let folder = if cfg!(windows) {
        of(windows)
    } else if cfg!(target_os = "macos") {
        at_home(mac)
    } else {
        of(variable).or_else(|| at_home(place))
    };
    folder.map(|folder| folder.join("pix2hdr"))
}

/// How the speed of a piece of work is measured. The fastest trial counts, since other programs only ever make one slower.
#[derive(Clone, Copy, Debug)]
pub struct Trials {
    /// Time of a trial that counts: the work is repeated in it until it takes that long.
    pub long_enough: Duration,
    /// Trials before one is believed to be long enough.
    pub careful: usize,
    /// Trials at least.
    pub least: usize,
    /// How long trials are repeated.
    pub patience: Duration,
}

impl Trials {
    /// Repetitions of the work in one trial at most.
    const MOST: u32 = 1 << 24;

    /// How often per second a piece of work is done at best. `time` does it so many times, and says how long that took.
    pub fn rate<E>(&self, mut time: impl FnMut(u32) -> Result<Duration, E>) -> Result<f64, E> {
        let mut shortest = |least: usize, patience: Duration, times: u32| {
            let begun = Instant::now();
            let mut shortest = Duration::MAX;
            for trial in 0.. {
                if trial >= least && begun.elapsed() >= patience {
                    break;
                }
                shortest = shortest.min(time(times)?);
            }
            Ok::<_, E>(shortest)
        };
        let mut times = 1;
        while shortest(self.careful, Duration::ZERO, times)? < self.long_enough && times < Self::MOST {
            times *= 2;
        }
        Ok(f64::from(times) / shortest(self.least, self.patience, times)?.as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Limits are found in both versions of control groups, in groups above too; "max" and what is not there are none.
    #[test]
    fn limits_of_memory_are_found() {
        let of = |groups: &str, files: &[(&str, &str)]| {
            group_memory(groups, |path| {
                let found = files.iter().find(|(name, _)| Path::new(name) == path);
                found.map(|(_, text)| format!("{text}\n"))
            })
        };
        let two = [("a/b/memory.max", "max"), ("a/memory.max", "3000"), ("memory.max", "5000")];
        assert_eq!(of("0::/a/b", &two), Some(3000));
        assert_eq!(of("0::/", &two), Some(5000));
        assert_eq!(of("0::/a/b", &two[..1]), None);
        let one = [
            ("memory/x/memory.limit_in_bytes", "700"),
            ("memory/memory.limit_in_bytes", "9223372036854771712"),
        ];
        assert_eq!(of("5:cpu,memory:/x\n1:name=systemd:/y\n0::/", &one), Some(700));
        // A container's group has another name within it.
        assert_eq!(of("4:memory:/docker/1f\n", &one), Some(9_223_372_036_854_771_712));
        assert_eq!(of("3:cpuset:/x", &one), None);
        let limits = "Limit  Soft Limit  Hard Limit  Units\nMax address space  153600000  unlimited  bytes\n";
        assert_eq!(address_space(limits), Some(153_600_000));
        assert_eq!(address_space(&limits.replace("153600000", "unlimited")), None);
    }

    #[test]
    fn the_fastest_of_long_trials_counts() {
        let trials =
            Trials { long_enough: Duration::from_millis(10), careful: 2, least: 5, patience: Duration::ZERO };
        // A piece takes a millisecond, and something else disturbs all trials but one in three.
        let mut count = 0;
        let rate = trials.rate(|times| {
            count += 1;
            let disturbed = Duration::from_millis(if count % 3 == 0 { 0 } else { 7 });
            Ok::<_, ()>(Duration::from_millis(times.into()) + disturbed)
        });
        assert!((rate.unwrap() - 1000.0).abs() < 1e-6);
        assert_eq!(trials.rate(|_| Err("no clock")), Err("no clock"));
    }
}

//! Memory that a process may still take.

use std::path::{Component, Path, PathBuf};

/// Memory that this process can have without swapping, in bytes, where the system says so (Linux): what the machine has free, or what
/// control groups (containers, services) leave of their limits if that is less.
pub fn free_memory() -> Option<u64> {
    let read = |path: PathBuf| std::fs::read_to_string(path).ok();
    let machine = available(&read("/proc/meminfo".into())?)?;
    let groups = read("/proc/self/cgroup".into()).unwrap_or_default();
    let left = files(&groups)
        .into_iter()
        .filter_map(|[limit, used, stat]| left(&read(limit)?, &read(used)?, &read(stat).unwrap_or_default()));
    Some(left.fold(machine, u64::min))
}

/// `MemAvailable` of `/proc/meminfo`.
fn available(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

/// Files with limit, use and details of each control group that `/proc/self/cgroup` names and of those around it: any of them may have
/// a limit. In a container the paths may be the host's; then its own group is the root. Those that are not there do not limit.
fn files(groups: &str) -> Vec<[PathBuf; 3]> {
    let mut files = Vec::new();
    for line in groups.lines() {
        // `NUMBER:CONTROLLERS:PATH`; version 2 has no list of controllers.
        let mut parts = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (parts.next(), parts.next()) else { continue };
        let (root, names) = if controllers.is_empty() {
            ("/sys/fs/cgroup", ["memory.max", "memory.current", "memory.stat"])
        } else if controllers.split(',').any(|name| name == "memory") {
            ("/sys/fs/cgroup/memory", ["memory.limit_in_bytes", "memory.usage_in_bytes", "memory.stat"])
        } else {
            continue;
        };
        let inside = Path::new(path).components().filter(|part| matches!(part, Component::Normal(_)));
        let inside: PathBuf = inside.collect();
        for group in inside.ancestors() {
            files.push(names.map(|name| Path::new(root).join(group).join(name)));
        }
    }
    files
}

/// What a group's `limit` leaves beside what is `used`; pages of files that nobody has touched lately, which `stat` counts, make room.
/// `None`: it has no limit.
fn left(limit: &str, used: &str, stat: &str) -> Option<u64> {
    // Version 2 says `max`; version 1 writes a number beyond any machine.
    let limit: u64 = limit.trim().parse().ok()?;
    let used: u64 = used.trim().parse().ok()?;
    let count =
        |name: &str| stat.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok());
    // Version 1 counts a group alone, and with those inside it.
    let idle: u64 = count("total_inactive_file").or_else(|| count("inactive_file")).unwrap_or(0);
    Some(limit.saturating_sub(used.saturating_sub(idle)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_machine_has() {
        assert_eq!(available("MemTotal: 9 kB\nMemAvailable:   1234 kB\nBuffers: 1 kB\n"), Some(1234 << 10));
        for bad in ["", "MemAvailable: x kB", "MemAvailable: 1 MB", "MemAvailable: 99999999999999999 kB"] {
            assert_eq!(available(bad), None, "{bad}");
        }
    }

    #[test]
    fn what_a_group_leaves() {
        let stat = "anon 5\ninactive_file 40\nactive_file 7\n";
        assert_eq!(left("1000\n", "300\n", stat), Some(740));
        assert_eq!(left("1000\n", "300\n", ""), Some(700));
        assert_eq!(left("1000\n", "300\n", "inactive_file 1\ntotal_inactive_file 50\n"), Some(750));
        assert_eq!(left("1000\n", "2000\n", "inactive_file 10\n"), Some(0), "it is over its limit");
        assert_eq!(left("1000\n", "30\n", stat), Some(1000));
        assert_eq!(left("max\n", "300\n", stat), None);
        assert_eq!(left("1000\n", "", stat), None);
    }

    #[test]
    fn groups_and_those_around_them() {
        let limits = |groups| files(groups).into_iter().map(|[limit, ..]| limit).collect::<Vec<_>>();
        let paths = |paths: &[&str]| paths.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert_eq!(limits("0::/\n"), paths(&["/sys/fs/cgroup/memory.max"]));
        let service = ["a.slice/b.service/memory.max", "a.slice/memory.max", "memory.max"];
        let service = service.map(|path| format!("/sys/fs/cgroup/{path}"));
        assert_eq!(limits("0::/a.slice/b.service\n"), service.map(PathBuf::from));
        let first = [
            "/sys/fs/cgroup/memory/docker/memory.limit_in_bytes",
            "/sys/fs/cgroup/memory/memory.limit_in_bytes",
        ];
        assert_eq!(limits("5:cpu,cpuacct:/x\n4:hugetlb,memory:/docker\n1:name=systemd:/y\n"), paths(&first));
        // Of a process moved out of its namespace.
        assert_eq!(limits("0::/../other\n").last(), Some(&"/sys/fs/cgroup/memory.max".into()));
        assert!(
            limits("0::/../other\n").iter().all(|path| !path.components().any(|c| c == Component::ParentDir))
        );
        assert_eq!(limits("garbage\n\n"), paths(&[]));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_may_take_some() {
        let free = free_memory().expect("Linux says it");
        assert!(
            free > 0 && free <= available(&std::fs::read_to_string("/proc/meminfo").unwrap()).unwrap() * 2
        );
    }
}

//! What measurements were made on.

use crate::commands::cores;
use std::env::consts::{ARCH, OS};
use tessera_geometry::mutation;
use tessera_master::report::bytes;

/// What a report of times says of a build in which bugs can be planted: each look whether one is on takes time.
pub const BUGS_FOR_TESTS: &str = "this build has planted bugs for tests: times are not those of a release";

/// Name and value of what a reader must know of this machine and this build: version, build, processor, cores, memory, system.
pub fn machine() -> Vec<(String, String)> {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let unknown = || "unknown".to_owned();
    let build = if mutation::ARE_THERE {
        BUGS_FOR_TESTS
    } else if cfg!(debug_assertions) {
        "debug assertions and overflow checks on: times are longer than a release build's"
    } else {
        "release"
    };
    let cpu = field(&read("/proc/cpuinfo"), &["model name", "Hardware", "cpu model"]);
    // Windows says it to every process.
    let cpu = cpu.or_else(|| std::env::var("PROCESSOR_IDENTIFIER").ok());
    let memory = kibibytes(&read("/proc/meminfo")).map_or_else(unknown, bytes);
    let system = field(&read("/etc/os-release").replace('=', ":"), &["PRETTY_NAME"]);
    let kernel = read("/proc/sys/kernel/osrelease");
    let system = format!("{} {}", system.unwrap_or_else(|| OS.into()), kernel.trim());
    [
        ("Tessera", format!("{} for {ARCH}-{OS}", env!("CARGO_PKG_VERSION"))),
        ("Build", build.into()),
        ("Processor", cpu.unwrap_or_else(unknown)),
        ("Cores", cores().to_string()),
        ("Memory", memory),
        ("System", system.trim().into()),
    ]
    .map(|(name, value)| (name.into(), value))
    .into()
}

/// The value of the first line `name: value` with one of these names.
fn field(text: &str, names: &[&str]) -> Option<String> {
    let mut lines = text.lines().filter_map(|line| line.split_once(':'));
    let (_, value) = lines.find(|(name, _)| names.contains(&name.trim()))?;
    Some(value.trim().trim_matches('"').to_owned()).filter(|value| !value.is_empty())
}

/// `MemTotal` of `/proc/meminfo`, in bytes.
fn kibibytes(meminfo: &str) -> Option<u64> {
    field(meminfo, &["MemTotal"])?.strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_are_read_where_the_system_writes_them() {
        let cpuinfo =
            "processor\t: 0\nmodel name\t: Some CPU @ 2.00GHz\nprocessor\t: 1\nmodel name\t: Other\n";
        assert_eq!(field(cpuinfo, &["model name"]).as_deref(), Some("Some CPU @ 2.00GHz"));
        assert_eq!(kibibytes("MemTotal:       16384 kB\nMemFree: 1 kB\n"), Some(16 << 20));
        assert_eq!(kibibytes("MemTotal: 99999999999999999999 kB\n"), None);
        assert_eq!(kibibytes(""), None);
        assert!(machine().iter().all(|(name, value)| !name.is_empty() && !value.is_empty()));
    }
}

//! The most memory that a stretch of work held, as the system saw it.
//!
//! An allocator that counts would need `unsafe`; Linux keeps the peak of the resident set (`VmHWM`) anyway. It counts what malloc keeps
//! for later too, so that only a process that has done little before gives a true figure: `bench build` takes a new one for each
//! tree.

use std::fs;

/// Watches the resident set of this process.
pub struct PeakMeter {
    start: u64,
}

impl PeakMeter {
    /// From now on; `None` where the system does not tell.
    pub fn start() -> Option<Self> {
        // Lets the peak begin anew (proc_pid_clear_refs(5)).
        fs::write("/proc/self/clear_refs", "5").ok()?;
        Some(Self { start: status_bytes("VmRSS:")? })
    }

    /// Most bytes held at once beyond those at the start.
    pub fn peak(&self) -> Option<u64> {
        Some(process_peak()?.saturating_sub(self.start))
    }
}

/// Most bytes that this process ever held; `None` where the system does not tell.
pub fn process_peak() -> Option<u64> {
    status_bytes("VmHWM:")
}

/// A line of `/proc/self/status`, which counts in KiB.
fn status_bytes(key: &str) -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(key))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn memory_that_is_touched_counts() {
        let Some(meter) = PeakMeter::start() else {
            eprintln!("skipped: /proc/self/clear_refs cannot be written here");
            return;
        };
        const BYTES: u64 = 256 << 20;
        let touched = std::hint::black_box(vec![1u8; BYTES as usize]);
        drop(touched);
        let peak = meter.peak().expect("the system told before");
        // Other tests run in this process, and may free and take a little.
        assert!(peak > BYTES * 9 / 10 && peak < BYTES * 3, "{peak}");
    }
}

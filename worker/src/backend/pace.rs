//! Making a tile take longer than this machine needs for it: waits that can be stopped, and the CPU time that a slower core is worth.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Waits until `deadline`, parked; whether `stop` is still unset then. Whoever sets it unparks the thread.
pub(crate) fn wait_until(deadline: Instant, stop: &AtomicBool) -> bool {
    while !stop.load(Ordering::Relaxed) {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return true;
        }
        // It may wake for nothing.
        std::thread::park_timeout(left);
    }
    false
}

/// CPU time that the calling thread has had. A slower core is one that takes longer over the same work: what other processes take of this
/// machine meanwhile must not count, as it would in wall time where more workers than cores render.
#[cfg(unix)]
pub(crate) fn thread_cpu_time() -> Option<Duration> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Some(Duration::new(u64::try_from(time.tv_sec).ok()?, u32::try_from(time.tv_nsec).ok()?))
}

/// There is no such clock.
#[cfg(not(unix))]
pub(crate) fn thread_cpu_time() -> Option<Duration> {
    None
}

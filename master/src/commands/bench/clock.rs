//! CPU seconds: on a machine with other tenants, what they take is left out.

use crate::commands::CommandError;
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// CPU seconds of the calling thread.
pub fn thread_seconds() -> f64 {
    seconds(ClockId::ThreadCPUTime)
}

fn seconds(clock: ClockId) -> f64 {
    let time = clock_gettime(clock);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// What something took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Wall seconds.
    pub wall_s: f64,
    /// CPU seconds of all threads of the process.
    pub cpu_s: f64,
}

impl Cost {
    /// Of `work`, in a pool of so many threads.
    pub fn of<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<(T, Self), CommandError> {
        let pool =
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(CommandError::failed)?;
        let watch = Watch::start();
        let value = pool.install(work);
        Ok((value, watch.read()))
    }
}

/// Wall and CPU time since a moment.
#[derive(Clone, Copy)]
pub struct Watch {
    wall: Instant,
    cpu: f64,
}

impl Watch {
    pub fn start() -> Self {
        Self { wall: Instant::now(), cpu: seconds(ClockId::ProcessCPUTime) }
    }

    pub fn read(&self) -> Cost {
        Cost { wall_s: self.wall.elapsed().as_secs_f64(), cpu_s: seconds(ClockId::ProcessCPUTime) - self.cpu }
    }
}

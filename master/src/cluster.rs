//! Workers that have joined, and what they are asked for.

use crate::{FrameJob, FrameResult, Link, Progress};
use std::{ffi::OsString, path::PathBuf, time::Duration};
use tessera_pack::Pack;

/// Where workers come from.
pub enum Workers {
    /// Processes on this machine, started and ended with the cluster.
    Local(LocalWorkers),
    /// Connections that exist, see [`Link::in_memory`].
    Links(Vec<Link>),
}

/// Processes on this machine.
#[derive(Clone, Debug)]
pub struct LocalWorkers {
    /// The program, usually `std::env::current_exe()`.
    pub program: PathBuf,
    /// Arguments that make it call `tessera_worker::run_local`.
    pub args: Vec<OsString>,
    /// How many, >= 1.
    pub count: u32,
    /// Threads that each renders with; `None`: the machine's cores shared out evenly, at least one each.
    pub threads: Option<u32>,
}

/// How a cluster is started.
#[derive(Clone, Debug, Default)]
pub struct ClusterConfig {
    /// The arithmetic that every worker must have (`tessera_worker::NUMERIC_CLASS`); `None`: that of the first to join.
    pub numeric_class: Option<String>,
}

/// Workers that have joined. Dropping it ends local worker processes.
pub struct Cluster {}

impl Cluster {
    /// Starts or greets `workers` and returns when all have joined.
    ///
    /// Does not need the scene: call it before or while the pack is made.
    pub async fn start(workers: Workers, config: ClusterConfig) -> Result<Self, StartError> {
        let _ = (workers, config);
        Err(StartError::NoWorkers)
    }

    /// Gives `pack` to every worker and returns when all hold it, checked; later frames render it.
    pub async fn load(
        &mut self,
        pack: &Pack,
        progress: impl FnMut(Progress<'_>),
    ) -> Result<Duration, LoadError> {
        let _ = (pack, progress);
        Err(LoadError::AllLost { last: String::new() })
    }

    /// Renders one frame of the loaded pack. Workers lost on the way are replaced by the others.
    pub async fn render(
        &mut self,
        job: &FrameJob,
        progress: impl FnMut(Progress<'_>),
    ) -> Result<FrameResult, RenderError> {
        let _ = (job, progress);
        Err(RenderError::NoPack)
    }

    /// Dismisses the workers and waits until local processes have ended (they are killed after two seconds).
    pub async fn stop(self) {}
}

/// Why there is no cluster.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Nobody was asked.
    #[error("a cluster needs at least one worker")]
    NoWorkers,
    /// A worker process could not be started.
    #[error("cannot start worker process `{program}`: {source}")]
    Spawn {
        /// The program.
        program: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The socket, the certificates.
    #[error("cannot open the master's endpoint: {0}")]
    Endpoint(String),
    /// A worker ended, or was refused, before it had joined.
    #[error("{worker} did not join: {reason}")]
    Worker {
        /// Which.
        worker: String,
        /// Why.
        reason: String,
    },
}

/// Why a pack is not loaded.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// A worker said no; another pack, or a machine with more memory, may do.
    #[error("{worker} cannot hold the scene: {reason}")]
    Rejected {
        /// Which.
        worker: String,
        /// Why.
        reason: tessera_wire::PackRefusal,
    },
    /// No worker is left.
    #[error("all workers were lost while the scene was sent; the last: {last}")]
    AllLost {
        /// Name and reason of the last one.
        last: String,
    },
}

/// Why there is no image.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The job is out of range.
    #[error("{0}")]
    Job(#[from] tessera_wire::FrameError),
    /// `load` has not succeeded.
    #[error("no scene is loaded")]
    NoPack,
    /// No worker is left.
    #[error("all workers were lost after {done} of {total} tiles; the last: {last}")]
    AllLost {
        /// Tiles in the image.
        done: u32,
        /// Tiles of the frame.
        total: u32,
        /// Name and reason of the last one.
        last: String,
    },
}

//! Workers that have joined, and what they are asked for.

use crate::{Balance, FrameBuffer, Link};
use std::{ffi::OsString, path::PathBuf, time::Duration};
use tessera_geometry::LocalCamera;
use tessera_pack::{Pack, PackId};
use tessera_wire::{Features, PixelFormat, Rays};

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

/// One frame of the loaded pack.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameJob {
    /// The view, in the pack's local units.
    pub camera: LocalCamera,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Side of a tile.
    pub tile: u32,
    /// Samples a pixel.
    pub samples: u32,
    /// Reflections and refractions a path may take.
    pub depth: u32,
    /// Seed of the sampler.
    pub seed: u64,
    /// What is switched on.
    pub features: Features,
    /// What a pixel holds.
    pub format: PixelFormat,
    /// How tiles get to workers.
    pub balance: Balance,
}

/// What happens, as it happens; for progress bars and logs.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress<'a> {
    /// Pack bytes handed to the transport, over all workers.
    Sent {
        /// So far.
        bytes: u64,
        /// To be sent.
        total: u64,
    },
    /// Tiles in the image.
    Tiles {
        /// So far.
        done: u32,
        /// Of the frame.
        total: u32,
    },
    /// A worker is gone; the others go on.
    WorkerLost {
        /// Its name.
        name: &'a str,
        /// Why.
        reason: &'a str,
    },
}

/// A frame and how it came about.
#[derive(Clone, Debug)]
pub struct FrameResult {
    /// The image.
    pub image: FrameBuffer,
    /// The pack that was rendered.
    pub pack: PackId,
    /// The arithmetic that rendered it.
    pub numeric_class: String,
    /// Every worker that took part, in the order of joining.
    pub workers: Vec<WorkerReport>,
    /// Where the time went.
    pub timings: Timings,
    /// Bytes on the wire since the cluster started: handshake, pack, frames.
    pub traffic: Traffic,
    /// Rays of the image: each tile counted once, however often it was rendered.
    pub rays: Rays,
    /// Results that came twice or too late, and were dropped.
    pub dropped_tiles: u64,
}

/// A worker's part in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerReport {
    /// Its name.
    pub name: String,
    /// Tiles of the image that came from it.
    pub tiles: u32,
    /// Wall time that it spent rendering those tiles, by its own clock.
    pub render: Duration,
    /// Bytes that it returned for this frame: pixels and their headers, dropped ones included.
    pub bytes_returned: u64,
    /// Why it was lost, if it was.
    pub lost: Option<String>,
}

/// Where a frame's time went, by the master's clock. `frame` is `render` + `return_`; `send_scene` lies before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timings {
    /// From the pack's first offer to the last worker's word that it holds it.
    pub send_scene: Duration,
    /// From the frame's announcement to the last worker's word that its last tile is rendered.
    pub render: Duration,
    /// From then to the last byte of the image: what the network adds when rendering no longer hides it.
    pub return_: Duration,
    /// From the frame's announcement to the complete image.
    pub frame: Duration,
}

/// Bytes on the wire, both directions seen from the master.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Sent: messages with their prefixes, and raw bytes.
    pub sent: u64,
    /// Received, likewise.
    pub received: u64,
    /// UDP payload sent: with QUIC's headers, acknowledgements and repeats; 0 on in-memory links.
    pub udp_sent: u64,
    /// UDP payload received.
    pub udp_received: u64,
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

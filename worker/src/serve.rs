//! A worker's life: join, hold a pack, render what is assigned, go.

use tokio::io::{AsyncRead, AsyncWrite};

/// The worker's end of a connection: a control and a bulk pipe in each direction.
pub struct WorkerPipes {
    /// Control messages from the master.
    pub control_in: Box<dyn AsyncRead + Send + Unpin>,
    /// Control messages to the master.
    pub control_out: Box<dyn AsyncWrite + Send + Unpin>,
    /// Packs from the master.
    pub bulk_in: Box<dyn AsyncRead + Send + Unpin>,
    /// Tiles to the master.
    pub bulk_out: Box<dyn AsyncWrite + Send + Unpin>,
}

/// What a worker says of itself, and what it may use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerConfig {
    /// For people.
    pub name: String,
    /// Threads that render, >= 1.
    pub threads: u32,
    /// Bytes that a pack may take; `None`: what the system has free, as far as it says.
    pub memory: Option<u64>,
}

/// Why a worker ended before it was dismissed.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The connection broke.
    #[error("the connection to the master is lost: {0}")]
    Lost(String),
}

/// Serves the master behind `pipes` until it dismisses the worker.
pub async fn serve(pipes: WorkerPipes, config: WorkerConfig) -> Result<(), WorkerError> {
    let _ = (pipes, config);
    Err(WorkerError::Lost("not built yet".into()))
}

/// A local worker process: reads its [`tessera_wire::LocalTicket`] from standard input, serves, and ends when the master dismisses
/// it or standard input closes. Needs a tokio runtime with I/O and time. Print its error on stderr and exit with 1.
pub async fn run_local() -> Result<(), WorkerError> {
    Err(WorkerError::Lost("not built yet".into()))
}

//! Holds a pack, renders tiles and returns them in batches.
//!
//! [`run_local`] is a whole worker process that a master has started, [`serve_master`] one that joins a master anywhere, [`stay`] one that
//! comes back when it has lost it; [`serve`] is a worker on any four pipes (an in-memory link of the master's, for one). A worker never
//! parses a user's scene file: it receives a pack, and checks it.

mod backend;
mod cache;
mod coding;
mod join;
mod local;
mod memory;
mod net;
mod pipes;
mod receive;
mod recording;
mod render;
mod retry;
mod serve;
pub mod session;

pub use backend::gpu;
pub use backend::{
    Adapter, Backend, BackendChoice, BackendConfig, BackendError, PackFault, ReplayConfig, adapters,
};
pub use cache::PackCache;
pub use join::{JoinError, serve_master};
pub use local::{run_local, serve_ticket};
pub use memory::free_memory;
pub use net::{Closer, Connected, connect};
pub use recording::{Recording, RecordingError, RecordingFile};
pub use retry::{RetryConfig, stay};
pub use serve::{Parting, Stop, WorkerConfig, WorkerError, WorkerPipes, serve};
pub use tessera_kdtree::Kernel;
pub use tessera_whitted::NUMERIC_CLASS;

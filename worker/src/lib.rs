//! Holds a pack, renders tiles and returns them in batches.
//!
//! [`run_local`] is a whole worker process; [`serve`] is a worker on any four pipes (an in-memory link of the
//! master's, for one). A worker never parses a user's scene file: it receives a pack, and checks it.

mod backend;
mod cache;
mod local;
mod net;
mod pipes;
mod receive;
mod render;
mod serve;
pub mod session;

pub use cache::PackCache;
pub use local::{run_local, serve_ticket};
pub use serve::{WorkerConfig, WorkerError, WorkerPipes, serve};
pub use tessera_whitted::NUMERIC_CLASS;

//! Holds a pack, renders tiles and returns them in batches.
//!
//! [`run_local`] is a whole worker process; [`serve`] is a worker on any four pipes (an in-memory link of the master's, for one).
//! A worker never parses a user's scene file: it receives a pack, and checks it.

mod serve;
pub mod session;

pub use serve::{WorkerConfig, WorkerError, WorkerPipes, run_local, serve};
pub use tessera_whitted::NUMERIC_CLASS;

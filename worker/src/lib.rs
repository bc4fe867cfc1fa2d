//! Holds a pack, renders tiles and returns them in batches.

mod serve;

pub use serve::{WorkerConfig, WorkerError, WorkerPipes, run_local, serve};
pub use tessera_whitted::NUMERIC_CLASS;

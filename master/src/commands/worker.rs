//! `tessera worker`: one local worker process, started by a master.

use super::CommandError;

pub fn run() -> Result<(), CommandError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|e| CommandError::Failed(format!("cannot start the network threads: {e}")))?;
    let result = runtime.block_on(tessera_worker::run_local()).map_err(CommandError::failed);
    // Standard input is read by a thread that would keep the runtime until the master closes it.
    runtime.shutdown_background();
    result
}

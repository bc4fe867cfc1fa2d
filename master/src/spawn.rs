//! Worker processes on this machine.

use crate::cluster::{LocalWorkers, StartError};
use std::{fmt, io, net::SocketAddr, process::Stdio, sync::Arc, thread::available_parallelism};
use tessera_wire::{JoinString, LocalTicket, codec};
use tokio::{
    io::AsyncWriteExt,
    process::{Child, ChildStdin, Command},
};

/// A way that is not the straight one: given the master's address, the address at which to join, of a relay for one.
#[derive(Clone)]
pub struct Detour(Arc<dyn Fn(SocketAddr) -> io::Result<SocketAddr> + Send + Sync>);

impl Detour {
    /// The way that `find` finds; it is asked once, when the master listens and before any worker is started.
    pub fn new(find: impl Fn(SocketAddr) -> io::Result<SocketAddr> + Send + Sync + 'static) -> Self {
        Self(Arc::new(find))
    }

    /// Where to join.
    pub(crate) fn find(&self, master: SocketAddr) -> io::Result<SocketAddr> {
        (self.0)(master)
    }
}

impl fmt::Debug for Detour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Detour")
    }
}

/// What each worker needs that joins by one of `joins`, by the name `local-0` and so on. `threads` as in [`LocalWorkers`].
pub(crate) fn tickets(
    joins: impl ExactSizeIterator<Item = JoinString>,
    threads: Option<u32>,
) -> Vec<LocalTicket> {
    let sharers = joins.len() as u32;
    let threads = threads.unwrap_or_else(|| fair_share(sharers));
    let ticket = |(index, join)| LocalTicket { join, name: format!("local-{index}"), threads, sharers };
    joins.enumerate().map(ticket).collect()
}

/// Starts a process for each ticket and hands it over through standard input, which must then be kept open:
/// its end is the worker's. Dropping a child kills it.
pub(crate) async fn spawn(
    workers: &LocalWorkers,
    tickets: &[LocalTicket],
) -> Result<Vec<(Child, ChildStdin)>, StartError> {
    let program = workers.program.display().to_string();
    let failed = |source| StartError::Spawn { program: program.clone(), source };
    let mut started = Vec::new();
    for (index, ticket) in tickets.iter().enumerate() {
        let mut command = Command::new(&workers.program);
        let own = workers.args_of.get(index).map_or(&[][..], Vec::as_slice);
        command.args(&workers.args).args(own).stdin(Stdio::piped()).stdout(Stdio::null()).kill_on_drop(true);
        // A terminal sends Ctrl-C to a whole process group. It is the master's to act on: workers that died of it
        // on their own would look lost.
        #[cfg(unix)]
        command.process_group(0);
        let mut child = command.spawn().map_err(failed)?;
        let bytes = codec::encode(ticket).map_err(|e| StartError::Endpoint(e.to_string()))?;
        let Some(mut stdin) = child.stdin.take() else {
            return Err(StartError::Endpoint("a child process without standard input".into()));
        };
        // A process that has ended already is noticed, with its status, by whoever waits for it.
        if let Err(e) = stdin.write_all(&bytes).await {
            tracing::debug!("{} does not read its ticket: {e}", ticket.name);
        }
        started.push((child, stdin));
    }
    Ok(started)
}

/// The machine's cores shared out, at least one each.
fn fair_share(workers: u32) -> u32 {
    let cores = available_parallelism().map_or(1, |n| n.get() as u32);
    (cores / workers.max(1)).max(1)
}

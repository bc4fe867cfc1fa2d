//! A worker process that a master has started on its own machine.

use crate::{
    Backend, Stop, WorkerConfig, WorkerError, free_memory,
    join::{JoinError, serve_master},
};
use std::{io::Read, time::Duration};
use tessera_trust::Identity;
use tessera_wire::{
    LocalTicket,
    codec::{self, Message, PREFIX_BYTES},
};
use tokio::{
    sync::{oneshot, watch},
    time::timeout,
};

/// A local worker process: reads its [`LocalTicket`] from standard input, serves, and ends when the master
/// dismisses it or standard input closes. Needs a tokio runtime with I/O and time. Print its error on stderr
/// and exit with 1.
pub async fn run_local(backend: Backend) -> Result<(), WorkerError> {
    let (ticket, master_gone) = read_ticket().await?;
    let (ask, asked) = watch::channel(Stop::No);
    let ask = async {
        tokio::select! {
            () = async { terminated().await; ask.send_replace(Stop::Drain); terminated().await } => {}
            _ = master_gone => {}
        }
        ask.send_replace(Stop::Now);
        std::future::pending().await
    };
    tokio::select! {
        served = serve_ticket(ticket, backend, asked) => served,
        () = ask => Ok(()),
    }
}

/// Joins the master that wrote `ticket` and serves it until it dismisses the worker, or until `stop` asks the worker to leave.
pub async fn serve_ticket(
    ticket: LocalTicket,
    backend: Backend,
    stop: watch::Receiver<Stop>,
) -> Result<(), WorkerError> {
    let own = Identity::new().map_err(|e| JoinError::Setup(e.to_string()))?;
    // Each of them holds a pack of its own, and none has one yet.
    let memory = free_memory().map(|bytes| bytes / u64::from(ticket.sharers.max(1)));
    let config = WorkerConfig { name: ticket.name, threads: ticket.threads, backend, memory, cache: None };
    serve_master(&ticket.join, &own, config, stop).await.map(|_| ())
}

/// The ticket, and a receiver that is ready once standard input has ended: the master is gone, however it
/// went.
async fn read_ticket() -> Result<(LocalTicket, oneshot::Receiver<()>), WorkerError> {
    let (ticket, received) = oneshot::channel();
    let (gone, master_gone) = oneshot::channel();
    // A thread of its own: a runtime would wait for its blocking tasks, and this read may last as long as the
    // process.
    let watch = move || {
        let mut input = std::io::stdin().lock();
        let _ = ticket.send(parse_ticket(&mut input));
        let mut scratch = [0; 64];
        while matches!(input.read(&mut scratch), Ok(1..)) {}
        let _ = gone.send(());
    };
    std::thread::Builder::new()
        .name("stdin".into())
        .spawn(watch)
        .map_err(|e| WorkerError::Threads(e.to_string()))?;
    /// The master writes it at once; a person at a terminal should not wait for ever.
    const PATIENCE: Duration = Duration::from_secs(10);
    match timeout(PATIENCE, received).await {
        Ok(Ok(Ok(ticket))) => Ok((ticket, master_gone)),
        Ok(Ok(Err(reason))) => Err(WorkerError::Ticket(reason)),
        Ok(Err(_)) | Err(_) => Err(WorkerError::Ticket("nothing came".into())),
    }
}

fn parse_ticket(input: &mut impl Read) -> Result<LocalTicket, String> {
    let mut prefix = [0; PREFIX_BYTES];
    input.read_exact(&mut prefix).map_err(|e| e.to_string())?;
    let length = codec::body_length(prefix, LocalTicket::LIMIT).map_err(|e| e.to_string())?;
    let mut body = vec![0; length];
    input.read_exact(&mut body).map_err(|e| e.to_string())?;
    codec::decode(&body).map_err(|e| e.to_string())
}

/// Ready when the process is asked to end: it then leaves in peace.
#[cfg(unix)]
async fn terminated() {
    match tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
        Ok(mut signal) => {
            signal.recv().await;
        }
        Err(_) => std::future::pending().await,
    }
}

#[cfg(not(unix))]
async fn terminated() {
    std::future::pending().await
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_wire::{Fingerprint, JoinString, Token};

    #[test]
    fn a_ticket_is_read_and_what_is_none_is_not() {
        let (fingerprint, token) = (Fingerprint([1; 32]), Token([2; 16]));
        let join = JoinString { host: "127.0.0.1".into(), port: 1, fingerprint, token };
        let ticket = LocalTicket { join, name: "w".into(), threads: 1, sharers: 1 };
        let bytes = codec::encode(&ticket).unwrap();
        assert_eq!(parse_ticket(&mut &bytes[..]), Ok(ticket));
        assert!(parse_ticket(&mut &bytes[..bytes.len() - 1]).is_err());
        assert!(parse_ticket(&mut &b"hello\n"[..]).is_err());
        assert!(parse_ticket(&mut &b""[..]).is_err());
    }
}

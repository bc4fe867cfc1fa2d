//! Joining a master by its join string.

use crate::{
    Parting, Stop, WorkerConfig, WorkerError,
    net::{Closer, connect},
    serve::{Served, serve_until},
};
use std::time::Duration;
use tessera_trust::Identity;
use tessera_wire::{AbortCode, JoinString};
use tokio::{sync::watch, time::sleep};

/// Why there is no connection to a master.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JoinError {
    /// The host's name has no address now.
    #[error("cannot find the master's host `{host}`: {reason}")]
    Unknown {
        /// The name.
        host: String,
        /// What the system says.
        reason: String,
    },
    /// Nobody answers, or the connection broke at once.
    #[error("no master at {address}: {reason}; is it running, and does the network let UDP through?")]
    Unreachable {
        /// Where.
        address: String,
        /// Why.
        reason: String,
    },
    /// The master is busy with other joiners.
    #[error("the master at {address} is busy with other joiners; try again")]
    Busy {
        /// Where.
        address: String,
    },
    /// Its certificate is another than the join string names.
    #[error(
        "the master at {address} is not the one that the join string is of: if it was started again, use the join string that it has \
         printed since"
    )]
    OtherMaster {
        /// Where.
        address: String,
    },
    /// It speaks another protocol.
    #[error("what answers at {address} is no tessera master; check the address in the join string")]
    NotTessera {
        /// Where.
        address: String,
    },
    /// This side cannot open a socket, or set up encryption.
    #[error("cannot connect: {0}")]
    Setup(String),
}

impl JoinError {
    /// Whether another attempt may succeed with nothing changed on this side.
    pub fn may_pass(&self) -> bool {
        matches!(self, Self::Unknown { .. } | Self::Unreachable { .. } | Self::Busy { .. })
    }
}

/// Joins the master of `join` as `own` and serves it until it dismisses the worker, or until `stop` asks the worker to leave. A connection
/// that breaks before the master has let the worker in is a [`JoinError`].
///
/// To the master a worker is its identity: who comes back with the same one takes the place of the connection before.
pub async fn serve_master(
    join: &JoinString,
    own: &Identity,
    config: WorkerConfig,
    stop: watch::Receiver<Stop>,
) -> Result<Parting, WorkerError> {
    let overdue = overdue(stop.clone());
    tokio::select! {
        served = serve_one(join, own, config, stop) => served,
        () = overdue => Ok(Parting::Left),
    }
}

async fn serve_one(
    join: &JoinString,
    own: &Identity,
    config: WorkerConfig,
    mut stop: watch::Receiver<Stop>,
) -> Result<Parting, WorkerError> {
    let connection = tokio::select! {
        connection = connect(join, own) => connection?,
        Ok(_) = stop.wait_for(|stop| *stop != Stop::No) => return Ok(Parting::Left),
    };
    tracing::info!("{} is connected to {}", config.name, join.address());
    let closer = connection.closer;
    let Served { was_welcomed, outcome } = serve_until(connection.pipes, config, join.token, stop).await;
    let outcome = outcome.map_err(|e| if was_welcomed { e } else { not_let_in(e, &closer, join) });
    if matches!(outcome, Ok(Parting::Left)) {
        closer.see_off().await;
    }
    closer.close(matches!(outcome, Err(WorkerError::Aborted { .. }))).await;
    outcome
}

/// What it means that a connection has ended with `error` before the master let the worker in.
fn not_let_in(error: WorkerError, closer: &Closer, join: &JoinString) -> WorkerError {
    let unreachable = |reason| JoinError::Unreachable { address: join.address(), reason };
    match error {
        WorkerError::Lost(reason) => closer.failure(join).unwrap_or_else(|| unreachable(reason)).into(),
        WorkerError::Aborted { code: AbortCode::Timeout, detail } => unreachable(detail).into(),
        WorkerError::Aborted { code: AbortCode::Busy, .. } => {
            JoinError::Busy { address: join.address() }.into()
        }
        other => other,
    }
}

/// Ready when the worker was asked to leave at once and has had a second for what it says last.
async fn overdue(mut stop: watch::Receiver<Stop>) {
    const FAREWELL: Duration = Duration::from_secs(1);
    if stop.wait_for(|stop| *stop == Stop::Now).await.is_err() {
        // Nobody can ask any more.
        return std::future::pending().await;
    }
    sleep(FAREWELL).await;
}

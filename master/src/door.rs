//! The door of a master: connections are made, greeted, and let in or refused, without the cluster being asked.
//!
//! Whoever has not shown a valid token costs a bounded amount: [`limits::STRANGERS`] connections at a time, each with a window of
//! [`limits::STRANGER_WINDOW_BYTES`], one `Hello` of [`limits::HELLO_BYTES`], and [`limits::HANDSHAKE_TIMEOUT`].

use crate::{
    admission::{Admission, Admitted},
    line::Input,
    net,
    transport::{Link, Pipes, write_message},
};
use quinn::{Connection, ConnectionError, Endpoint, Incoming, RecvStream, SendStream, VarInt};
use rustls::pki_types::CertificateDer;
use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use tessera_wire::{
    AbortCode, Fingerprint, Hello, Refusal, ToWorker,
    codec::{self, PREFIX_BYTES},
    limits, plain_text,
};
use tokio::{
    io::AsyncWriteExt,
    sync::{mpsc, oneshot},
    task::JoinSet,
    time::{Instant, timeout, timeout_at},
};

/// How long a peer may take to read why it is refused.
const FAREWELL: Duration = Duration::from_secs(1);

/// What the door knows, and whom it tells.
pub(crate) struct Door {
    pub(crate) endpoint: Endpoint,
    /// Asked for a moment at a time.
    pub(crate) admission: Mutex<Admission>,
    /// Since when the admission counts.
    pub(crate) begun: Instant,
    /// Workers go here.
    pub(crate) tell: mpsc::Sender<Input>,
}

/// A peer that was let in and not answered yet.
pub(crate) struct Guest {
    pub(crate) admitted: Admitted,
    /// Its certificate's.
    pub(crate) identity: Fingerprint,
    pub(crate) hello: Hello,
    pub(crate) link: Link,
}

/// Opens to whoever comes, until the endpoint is closed.
pub(crate) async fn keep(door: Arc<Door>) {
    let mut greetings = JoinSet::new();
    // Dropping one ends its greeting. Those of greetings that are over lie about until they are the oldest.
    let mut pending: VecDeque<oneshot::Sender<()>> = VecDeque::new();
    loop {
        tokio::select! {
            incoming = door.endpoint.accept() => {
                let Some(incoming) = incoming else { return };
                pending.retain(|greeting| !greeting.is_closed());
                let is_proven = incoming.remote_address_validated() || !incoming.may_retry();
                if pending.len() >= limits::STRANGERS_UNPROVEN && !is_proven {
                    // It fails only for an address that is proven.
                    let _ = incoming.retry();
                    continue;
                }
                if pending.len() >= limits::STRANGERS {
                    pending.pop_front();
                }
                let (keep, evicted) = oneshot::channel();
                pending.push_back(keep);
                greetings.spawn(receive(door.clone(), incoming, evicted));
            }
            Some(_) = greetings.join_next() => {}
        }
    }
}

/// Sees one connection through the door.
async fn receive(door: Arc<Door>, incoming: Incoming, evicted: oneshot::Receiver<()>) {
    let peer = incoming.remote_address();
    let reason = tokio::select! {
        result = greet(&door, incoming) => match result {
            Ok(guest) => {
                let _ = door.tell.send(Input::Guest(Box::new(guest))).await;
                return;
            }
            Err(reason) => reason,
        },
        _ = evicted => "too many connections are being made, and this one was the oldest".into(),
    };
    tracing::info!("{peer} was not let in: {}", plain_text(&reason));
}

/// Closes a connection whose greeting is dropped before its end.
struct Closing(Option<Connection>);

impl Drop for Closing {
    fn drop(&mut self) {
        if let Some(connection) = &self.0 {
            // Nothing happens if it is closed already.
            connection.close(VarInt::from_u32(AbortCode::Busy.number()), b"");
        }
    }
}

/// The peer once it is let in; else it has been told why not, and this says it for the log.
async fn greet(door: &Door, incoming: Incoming) -> Result<Guest, String> {
    let peer = incoming.remote_address().to_string();
    let deadline = Instant::now() + limits::HANDSHAKE_TIMEOUT;
    let late = |what: &str| format!("{what} in {} s", limits::HANDSHAKE_TIMEOUT.as_secs());
    let connection = match timeout_at(deadline, incoming.into_future()).await {
        Ok(connection) => connection.map_err(|e| e.to_string())?,
        Err(_) => return Err(late("no handshake")),
    };
    let mut closing = Closing(Some(connection.clone()));
    let heard = timeout_at(deadline, hear(&connection)).await;
    let Ok(heard) = heard else {
        connection.close(VarInt::from_u32(AbortCode::Timeout.number()), b"no Hello came in time");
        return Err(late("no `Hello`"));
    };
    let (control_out, control_in, hello) = heard.map_err(|e| e.to_string())?;
    let identity = identity(&connection).ok_or("no certificate")?;
    let judged = hello.and_then(|hello| {
        let mut admission = door.admission.lock().unwrap_or_else(PoisonError::into_inner);
        let admitted = admission.admit(&hello, identity, door.begun.elapsed())?;
        Ok((hello, admitted))
    });
    let (hello, admitted) = match judged {
        Ok(judged) => judged,
        Err(refusal) => {
            let reason = refusal.to_string();
            refuse(&connection, control_out, refusal).await;
            return Err(reason);
        }
    };
    net::admit(&connection);
    let Ok(opened) = timeout_at(deadline, open_bulk(&connection)).await else {
        connection.close(VarInt::from_u32(AbortCode::Timeout.number()), b"no bulk pipe was opened in time");
        return Err(late("no bulk pipe"));
    };
    let (bulk_out, bulk_in) = opened?;
    let pipes = Pipes {
        control_in: Box::new(control_in),
        control_out: Box::new(control_out),
        bulk_in: Box::new(bulk_in),
        bulk_out: Box::new(bulk_out),
    };
    closing.0 = None;
    Ok(Guest { admitted, identity, hello, link: Link { pipes, peer, connection: Some(connection) } })
}

/// The control pipe that the peer opens, and its first message.
async fn hear(
    connection: &Connection,
) -> Result<(SendStream, RecvStream, Result<Hello, Refusal>), ConnectionError> {
    let (control_out, mut control_in) = connection.accept_bi().await?;
    let malformed = |detail: String| Refusal::Malformed { detail };
    let hello = async {
        let mut prefix = [0; PREFIX_BYTES];
        control_in.read_exact(&mut prefix).await.map_err(|e| malformed(e.to_string()))?;
        let length = codec::body_length(prefix, limits::HELLO_BYTES).map_err(|e| malformed(e.to_string()))?;
        let mut body = vec![0; length];
        control_in.read_exact(&mut body).await.map_err(|e| malformed(e.to_string()))?;
        codec::decode_hello(&body)
    };
    let hello = hello.await;
    Ok((control_out, control_in, hello))
}

/// Tells a peer why it is not let in, and closes once it has heard.
async fn refuse(connection: &Connection, mut control: SendStream, refusal: Refusal) {
    if let Ok(bytes) = codec::encode(&ToWorker::Refuse(refusal)) {
        // A peer that is gone need not be told.
        let _ = control.write_all(&bytes).await;
        let _ = control.finish();
        let _ = timeout(FAREWELL, connection.closed()).await;
    }
    connection.close(VarInt::from_u32(AbortCode::Refused.number()), b"");
}

/// Tells a peer that was let in why it may not stay, and closes.
pub(crate) async fn turn_away(guest: Guest, refusal: Refusal) {
    let Link { mut pipes, connection, .. } = guest.link;
    let told = async {
        let _ = write_message(&mut pipes.control_out, &ToWorker::Refuse(refusal)).await;
        let _ = pipes.control_out.shutdown().await;
        if let Some(connection) = &connection {
            connection.closed().await;
        }
    };
    let _ = timeout(FAREWELL, told).await;
    if let Some(connection) = connection {
        connection.close(VarInt::from_u32(AbortCode::Refused.number()), b"");
    }
}

/// Both bulk pipes.
async fn open_bulk(connection: &Connection) -> Result<(SendStream, RecvStream), String> {
    let mut bulk_out = connection.open_uni().await.map_err(|e| e.to_string())?;
    bulk_out.write_all(&codec::BULK_TAG).await.map_err(|e| e.to_string())?;
    let mut bulk_in = connection.accept_uni().await.map_err(|e| e.to_string())?;
    let mut tag = [0; codec::BULK_TAG.len()];
    bulk_in.read_exact(&mut tag).await.map_err(|e| e.to_string())?;
    if tag == codec::BULK_TAG {
        Ok((bulk_out, bulk_in))
    } else {
        connection.close(VarInt::from_u32(AbortCode::Malformed.number()), b"not a bulk pipe");
        Err("its bulk pipe begins with something else".into())
    }
}

/// Of the certificate whose key the peer has proven to have.
fn identity(connection: &Connection) -> Option<Fingerprint> {
    let chain = connection.peer_identity()?.downcast::<Vec<CertificateDer>>().ok()?;
    Some(tessera_trust::fingerprint(chain.first()?))
}

#[cfg(test)]
mod tests;

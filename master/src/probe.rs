//! What a link carries, with the transport that frames have: a master without work, which returns what it is told and counts what it is sent.

use crate::net;
use quinn::{Connection, Endpoint, RecvStream, SendStream};
use std::net::{Ipv4Addr, SocketAddr};
use tessera_trust::Identity;
use tessera_wire::{JoinString, Token, codec};
use tokio::{sync::watch, task::JoinSet};

/// A master for measurements on this machine, on loopback: whoever comes is let in. `tessera_worker::connect` joins it; control bytes
/// come back as they are, and bulk bytes are counted; the first to come is sent some. Dropping it ends all connections.
pub struct LinkProbe {
    endpoint: Endpoint,
    join: JoinString,
    received: watch::Receiver<u64>,
    /// Bytes that the first peer is to have been sent.
    sent: watch::Sender<u64>,
    _tasks: JoinSet<()>,
}

/// Why a link cannot be measured.
#[derive(Debug, thiserror::Error)]
pub enum ProbeError {
    /// The socket, the certificates.
    #[error("cannot open the probe's endpoint: {0}")]
    Endpoint(String),
}

impl LinkProbe {
    /// Opens it. Needs a tokio runtime with I/O and time.
    pub fn open() -> Result<Self, ProbeError> {
        let failed = |error: &dyn std::fmt::Display| ProbeError::Endpoint(error.to_string());
        let own = Identity::new().map_err(|e| failed(&e))?;
        let endpoint = net::listen((Ipv4Addr::LOCALHOST, 0).into(), &own).map_err(|e| failed(&e))?;
        let bound = endpoint.local_addr().map_err(|e| failed(&e))?;
        let join = JoinString {
            host: bound.ip().to_string(),
            port: bound.port(),
            fingerprint: own.fingerprint(),
            token: Token::default(),
        };
        let (count, received) = watch::channel(0);
        let mut tasks = JoinSet::new();
        let (sent, wanted) = watch::channel(0);
        tasks.spawn(keep(endpoint.clone(), count, wanted));
        Ok(Self { endpoint, join, received, sent, _tasks: tasks })
    }

    /// Its address.
    pub fn address(&self) -> SocketAddr {
        (Ipv4Addr::LOCALHOST, self.join.port).into()
    }

    /// How to join it at `address`, which leads to its own.
    pub fn join_at(&self, address: SocketAddr) -> JoinString {
        JoinString { host: address.ip().to_string(), port: address.port(), ..self.join.clone() }
    }

    /// Sends the first peer so many bytes more, over its bulk pipe.
    pub fn send(&self, bytes: u64) {
        self.sent.send_modify(|total| *total += bytes);
    }

    /// Bulk bytes of all peers so far.
    pub fn received(&self) -> u64 {
        *self.received.borrow()
    }

    /// Returns once so many bulk bytes have come in all, or the endpoint is gone.
    pub async fn until_received(&mut self, bytes: u64) {
        let _ = self.received.wait_for(|&received| received >= bytes).await;
    }
}

impl Drop for LinkProbe {
    fn drop(&mut self) {
        self.endpoint.close(0u32.into(), b"");
    }
}

async fn keep(endpoint: Endpoint, count: watch::Sender<u64>, wanted: watch::Receiver<u64>) {
    let mut peers = JoinSet::new();
    let mut first = Some(wanted);
    loop {
        tokio::select! {
            incoming = endpoint.accept() => {
                let Some(incoming) = incoming else { return };
                let (count, wanted) = (count.clone(), first.take());
                peers.spawn(async move {
                    if let Ok(connection) = incoming.await {
                        serve(connection, &count, wanted).await;
                    }
                });
            }
            Some(_) = peers.join_next() => {}
        }
    }
}

/// Sees one peer through; its streams end with it.
async fn serve(connection: Connection, count: &watch::Sender<u64>, wanted: Option<watch::Receiver<u64>>) {
    net::admit(&connection);
    let echo = async {
        let Ok((mut control_out, mut control_in)) = connection.accept_bi().await else { return };
        let mut bytes = [0; 1024];
        while let Ok(Some(length)) = control_in.read(&mut bytes).await {
            if control_out.write_all(&bytes[..length]).await.is_err() {
                return;
            }
        }
    };
    let sink = async {
        if let Ok(bulk_in) = connection.accept_uni().await {
            swallow(bulk_in, count).await;
        }
    };
    let source = async {
        if let (Some(wanted), Ok(bulk_out)) = (wanted, connection.open_uni().await) {
            pour(bulk_out, wanted).await;
        }
    };
    tokio::join!(echo, sink, source);
}

/// Writes the tag, and as many bytes as are wanted.
async fn pour(mut bulk: SendStream, mut wanted: watch::Receiver<u64>) {
    let bytes = vec![0; 1 << 20];
    let mut sent = 0;
    let mut result = bulk.write_all(&codec::BULK_TAG).await;
    while result.is_ok() {
        let Ok(left) = wanted.wait_for(|&total| total > sent).await.map(|total| *total - sent) else {
            return;
        };
        let piece = left.min(bytes.len() as u64);
        result = bulk.write_all(&bytes[..piece as usize]).await;
        sent += piece;
    }
}

/// Counts what comes behind the tag.
async fn swallow(mut bulk: RecvStream, count: &watch::Sender<u64>) {
    let mut tag = [0; codec::BULK_TAG.len()];
    if bulk.read_exact(&mut tag).await.is_err() {
        return;
    }
    let mut bytes = vec![0; 64 << 10];
    while let Ok(Some(length)) = bulk.read(&mut bytes).await {
        count.send_modify(|total| *total += length as u64);
    }
}

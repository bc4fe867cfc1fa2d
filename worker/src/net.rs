//! QUIC, the joiner's side: of a worker, and of a client, whose connection is made the same way.

use crate::{
    WorkerPipes,
    join::JoinError,
    pipes::{Reader, Writer},
};
use quinn::{
    AckFrequencyConfig, ClientConfig, Connection, ConnectionError, Endpoint, EndpointConfig, IdleTimeout,
    MtuDiscoveryConfig, RecvStream, TransportConfig, TransportErrorCode, VarInt, congestion::CubicConfig,
    crypto::rustls::QuicClientConfig,
};
use std::{
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, ready},
    time::Duration,
};
use tessera_trust::{Identity, OTHER_PROTOCOL_ALERT, WRONG_MASTER_ALERT};
use tessera_wire::{AbortCode, JoinString, codec, limits, plain_text};
use tokio::{
    io::{AsyncRead, ReadBuf},
    net::lookup_host,
    time::timeout,
};

/// A connection to the master of a join string; nothing was said yet.
pub struct Connected {
    /// To speak over.
    pub pipes: WorkerPipes,
    /// To end it.
    pub closer: Closer,
}

/// What ends a connection.
pub struct Closer {
    endpoint: Endpoint,
    connection: Connection,
}

impl Closer {
    /// What the connection's end means, if it has ended, to one that was not let in.
    pub(crate) fn failure(&self, join: &JoinString) -> Option<JoinError> {
        self.connection.close_reason().map(|reason| broken(reason, join))
    }

    /// Waits until the master has read everything and closes, for two seconds at most: pixels of a few tiles at 1 Mbit/s.
    pub(crate) async fn see_off(&self) {
        const PATIENCE: Duration = Duration::from_secs(2);
        let _ = timeout(PATIENCE, self.connection.closed()).await;
    }

    /// Closes the connection once the last messages are out. `spoke_last`: the master has yet to read what was said last, and closes
    /// then; waits a second for it.
    pub async fn close(self, spoke_last: bool) {
        /// How long the master may take.
        const FAREWELL: Duration = Duration::from_secs(1);
        if spoke_last {
            let _ = timeout(FAREWELL, self.connection.closed()).await;
        }
        self.connection.close(VarInt::from_u32(AbortCode::Done.number()), b"");
        let _ = timeout(FAREWELL, self.endpoint.wait_idle()).await;
    }
}

/// Connects to the master that `join` names, showing `own`. The master says nothing before it has read a `Hello` with the token.
///
/// The host is looked up each time; its addresses are tried one after the other.
pub async fn connect(join: &JoinString, own: &Identity) -> Result<Connected, JoinError> {
    /// Addresses of one name that are tried.
    const ADDRESSES: usize = 4;
    let unreachable = |reason: String| JoinError::Unreachable { address: join.address(), reason };
    let found = timeout(limits::HANDSHAKE_TIMEOUT, lookup_host((join.host.as_str(), join.port))).await;
    let addresses: Vec<_> = match found {
        Ok(Ok(addresses)) => addresses.take(ADDRESSES).collect(),
        Ok(Err(e)) => return Err(JoinError::Unknown { host: join.host.clone(), reason: e.to_string() }),
        Err(_) => return Err(JoinError::Unknown { host: join.host.clone(), reason: "no answer".into() }),
    };
    let tls =
        tessera_trust::joiner_config(own, join.fingerprint).map_err(|e| JoinError::Setup(e.to_string()))?;
    let quic = QuicClientConfig::try_from(tls).map_err(|e| JoinError::Setup(e.to_string()))?;
    let mut config = ClientConfig::new(Arc::new(quic));
    config.transport_config(Arc::new(transport()));
    let mut failures = Vec::new();
    for address in addresses {
        let attempt = connect_to(address, config.clone(), join);
        match timeout(limits::HANDSHAKE_TIMEOUT, attempt).await {
            Ok(Ok(connected)) => return Ok(connected),
            Ok(Err(error)) => failures.push(error),
            Err(_) => failures.push(unreachable("no answer in time".into())),
        }
    }
    Err(worst(failures).unwrap_or_else(|| unreachable("the name has no address".into())))
}

/// Of the failures with the addresses of one name the first that no other attempt mends; else the last.
fn worst(mut failures: Vec<JoinError>) -> Option<JoinError> {
    match failures.iter().position(|failure| !failure.may_pass()) {
        Some(first) => Some(failures.swap_remove(first)),
        None => failures.pop(),
    }
}

async fn connect_to(
    address: SocketAddr,
    config: ClientConfig,
    join: &JoinString,
) -> Result<Connected, JoinError> {
    let broken = |error: ConnectionError| broken(error, join);
    let endpoint = endpoint(address).map_err(JoinError::Setup)?;
    let connecting = endpoint
        .connect_with(config, address, codec::SERVER_NAME)
        .map_err(|e| JoinError::Unreachable { address: join.address(), reason: e.to_string() })?;
    let connection = connecting.await.map_err(broken)?;
    let (control_out, control_in) = connection.open_bi().await.map_err(broken)?;
    let mut bulk_out: Writer = Box::new(connection.open_uni().await.map_err(broken)?);
    let sent = tokio::io::AsyncWriteExt::write_all(&mut bulk_out, &codec::BULK_TAG).await;
    sent.map_err(|e| JoinError::Unreachable { address: join.address(), reason: e.to_string() })?;
    let pipes = WorkerPipes {
        control_in: Box::new(control_in),
        control_out: Box::new(control_out),
        bulk_in: late_bulk(connection.clone()),
        bulk_out,
    };
    Ok(Connected { pipes, closer: Closer { endpoint, connection } })
}

/// What the end of a connection means before `Welcome`.
fn broken(error: ConnectionError, join: &JoinString) -> JoinError {
    let address = join.address();
    match error {
        ConnectionError::TransportError(e) if e.code == TransportErrorCode::crypto(WRONG_MASTER_ALERT) => {
            JoinError::OtherMaster { address }
        }
        ConnectionError::ConnectionClosed(close)
            if close.error_code == TransportErrorCode::crypto(OTHER_PROTOCOL_ALERT) =>
        {
            JoinError::NotTessera { address }
        }
        ConnectionError::VersionMismatch => JoinError::NotTessera { address },
        ConnectionError::ConnectionClosed(close)
            if close.error_code == TransportErrorCode::CONNECTION_REFUSED =>
        {
            JoinError::Busy { address }
        }
        ConnectionError::ApplicationClosed(close)
            if close.error_code == VarInt::from_u32(AbortCode::Busy.number()) =>
        {
            JoinError::Busy { address }
        }
        ConnectionError::TimedOut => JoinError::Unreachable { address, reason: "no answer".into() },
        // The peer may have written part of it, and anybody may be the peer.
        other => JoinError::Unreachable { address, reason: plain_text(&other.to_string()) },
    }
}

/// The master's bulk stream, which it opens only once it has let the joiner in: looked for at the first read.
fn late_bulk(connection: Connection) -> Reader {
    let opening = async move {
        let mut stream = connection.accept_uni().await?;
        let mut tag = [0; codec::BULK_TAG.len()];
        stream.read_exact(&mut tag).await.map_err(io::Error::other)?;
        if tag == codec::BULK_TAG {
            Ok(stream)
        } else {
            Err(io::Error::new(io::ErrorKind::InvalidData, "it does not speak this protocol"))
        }
    };
    Box::new(LateBulk::Opening(Box::pin(opening)))
}

enum LateBulk {
    Opening(Pin<Box<dyn Future<Output = io::Result<RecvStream>> + Send>>),
    Open(RecvStream),
}

impl AsyncRead for LateBulk {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if let Self::Opening(opening) = &mut *self {
            *self = Self::Open(ready!(opening.as_mut().poll(cx))?);
        }
        match &mut *self {
            Self::Open(stream) => AsyncRead::poll_read(Pin::new(stream), cx, buffer),
            Self::Opening(_) => Poll::Pending,
        }
    }
}

/// A socket of the master's address family with the buffers that the transport wants.
fn endpoint(master: SocketAddr) -> Result<Endpoint, String> {
    let any: SocketAddr = match master {
        SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
        SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
    };
    let socket = UdpSocket::bind(any).map_err(|e| format!("no UDP socket: {e}"))?;
    let state = quinn::udp::UdpSocketState::new((&socket).into()).map_err(|e| e.to_string())?;
    // The system may give less; the master says so once for both ends.
    let _ = state.set_send_buffer_size((&socket).into(), limits::SOCKET_BUFFER_BYTES);
    let _ = state.set_recv_buffer_size((&socket).into(), limits::SOCKET_BUFFER_BYTES);
    let runtime = Arc::new(quinn::TokioRuntime);
    let mut config = EndpointConfig::default();
    config.max_udp_payload_size(limits::UDP_PAYLOAD_BYTES).map_err(|e| e.to_string())?;
    Endpoint::new(config, None, socket, runtime).map_err(|e| e.to_string())
}

/// Bytes that a joiner sends before it has heard of their arrival: a worker's share of a picture at once. By default they are 14,720, two packets
/// over loopback; the first of each batch then waited for a delayed acknowledgement, and a tile of 64 KiB took 29 ms there.
const INITIAL_WINDOW_BYTES: u64 = 1 << 20;

/// How long the master may hold an acknowledgement back. By default that is 25 ms, which a sender that waits for room, and the loss of the last
/// packets, then wait for.
const ACK_DELAY: Duration = Duration::from_millis(2);

/// QUIC's settings on this side; the numbers and their reasons are in [`limits`]. The master has the mirror
/// image, but for the congestion control.
///
/// Workers send batches, many workers at once: Cubic with a large initial window. Milliseconds as `tessera bench link` measures them, on two
/// busy cores, and what the links alone would take:
///
/// | | defaults | this | BBR | alone |
/// |---|---|---|---|---|
/// | a tile of 64 KiB: `loopback`, `wired`, `wan` | 29, 29, 74 | 0.6, 1.3, 26 | 0.9, 1.4, 26 | -, 0.7, 25 |
/// | 256 KiB from each of 16: `loopback`, `wired`, `phone` | 127, 129, 218 | 16, 47, 211 | 25, 95, 273 | -, 35, 171 |
///
/// BBR is the better one for a long transfer of one worker where packets are lost: 90 of 96 Mbit/s over `wan`, and Cubic 15.
fn transport() -> TransportConfig {
    let mut discovery = MtuDiscoveryConfig::default();
    discovery.upper_bound(limits::UDP_PAYLOAD_BYTES);
    let mut congestion = CubicConfig::default();
    congestion.initial_window(INITIAL_WINDOW_BYTES);
    let mut acknowledgements = AckFrequencyConfig::default();
    acknowledgements.max_ack_delay(Some(ACK_DELAY));
    let mut transport = TransportConfig::default();
    transport
        .mtu_discovery_config(Some(discovery))
        .max_idle_timeout(IdleTimeout::try_from(limits::IDLE_TIMEOUT).ok())
        .keep_alive_interval(Some(limits::KEEP_ALIVE))
        .max_concurrent_bidi_streams(VarInt::from_u32(0))
        .max_concurrent_uni_streams(VarInt::from_u32(1))
        .stream_receive_window(VarInt::from_u32(limits::STREAM_WINDOW_BYTES))
        .receive_window(VarInt::from_u32(limits::CONNECTION_WINDOW_BYTES))
        .send_window(limits::CONNECTION_WINDOW_BYTES.into())
        .congestion_controller_factory(Arc::new(congestion))
        .ack_frequency_config(Some(acknowledgements))
        .datagram_receive_buffer_size(None);
    transport
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_that_stays_is_told_rather_than_one_that_may_pass() {
        let address = |number: u32| format!("m:{number}");
        let silent = |number| JoinError::Unreachable { address: address(number), reason: "no answer".into() };
        let other = |number| JoinError::OtherMaster { address: address(number) };
        assert_eq!(worst(vec![silent(1), other(2), other(3), silent(4)]), Some(other(2)));
        assert_eq!(worst(vec![silent(1), silent(2)]), Some(silent(2)));
        assert_eq!(worst(Vec::new()), None);
    }

    #[test]
    fn what_a_stranger_says_reaches_no_terminal() {
        let join = JoinString {
            host: "m".into(),
            port: 1,
            fingerprint: tessera_wire::Fingerprint([0; 32]),
            token: tessera_wire::Token::default(),
        };
        let close = quinn::ApplicationClose {
            error_code: VarInt::from_u32(77),
            reason: b"\x1b[2Jforged\nline".to_vec().into(),
        };
        let error = broken(ConnectionError::ApplicationClosed(close.clone()), &join);
        assert!(error.to_string().contains("[2Jforgedline") && !error.to_string().contains(char::is_control));
        let lost = quinn::ReadError::ConnectionLost(ConnectionError::ApplicationClosed(close));
        let text = crate::pipes::reason(&io::Error::from(lost));
        assert!(text.contains("[2Jforgedline") && !text.contains(char::is_control), "{text}");
    }

    #[test]
    fn the_transport_is_what_the_limits_say() {
        let text = format!("{:?}", transport());
        for part in [
            "max_idle_timeout: Some(5000)",
            "keep_alive_interval: Some(1s)",
            "max_concurrent_bidi_streams: 0",
            "max_concurrent_uni_streams: 1",
            "stream_receive_window: 8388608",
            "receive_window: 16777216",
            "send_window: 16777216",
            "datagram_receive_buffer_size: None",
            "max_ack_delay: Some(2ms)",
            "upper_bound: 8972",
        ] {
            assert!(text.contains(part), "`{part}` is not in {text}");
        }
    }
}

//! QUIC, the master's side.

use quinn::{
    AckFrequencyConfig, Connection, Endpoint, EndpointConfig, IdleTimeout, MtuDiscoveryConfig, ServerConfig,
    TransportConfig, VarInt, congestion::BbrConfig, crypto::rustls::QuicServerConfig,
};
use std::{
    io,
    net::{IpAddr, SocketAddr, UdpSocket},
    sync::Arc,
    time::Duration,
};
use tessera_trust::Identity;
use tessera_wire::limits;

/// Why a master cannot listen.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ListenError {
    /// The address is taken, or not this machine's.
    #[error("cannot listen on {address} (UDP): {source}; choose another address or port")]
    Bind {
        /// Where.
        address: SocketAddr,
        /// What the system says.
        source: io::Error,
    },
    /// Nothing that a user can mend.
    #[error("cannot open the master's endpoint: {0}")]
    Setup(String),
}

/// Opens the socket at `address`. It shows `own` to whoever comes.
pub(crate) fn listen(address: SocketAddr, own: &Identity) -> Result<Endpoint, ListenError> {
    let setup = |error: &dyn std::fmt::Display| ListenError::Setup(error.to_string());
    let socket = UdpSocket::bind(address).map_err(|source| ListenError::Bind { address, source })?;
    let given = enlarge_buffers(&socket).map_err(|e| setup(&e))?;
    if given.are_small() {
        tracing::info!(
            wanted = limits::SOCKET_BUFFER_BYTES,
            send = given.send,
            receive = given.receive,
            "the system gives UDP sockets smaller buffers than wanted; a busy machine may then send packets twice; \
             on Linux raise net.core.rmem_max and net.core.wmem_max"
        );
    }
    let tls = tessera_trust::master_config(own).map_err(|e| setup(&e))?;
    let quic = QuicServerConfig::try_from(tls).map_err(|e| setup(&e))?;
    let mut config = ServerConfig::with_crypto(Arc::new(quic));
    config
        .transport_config(Arc::new(transport()))
        .max_incoming(limits::INCOMING)
        .incoming_buffer_size(limits::STRANGER_WINDOW_BYTES.into())
        .incoming_buffer_size_total(u64::from(limits::STRANGER_WINDOW_BYTES) * limits::INCOMING as u64);
    let mut endpoint = EndpointConfig::default();
    endpoint.max_udp_payload_size(limits::UDP_PAYLOAD_BYTES).map_err(|e| setup(&e))?;
    Endpoint::new(endpoint, Some(config), socket, Arc::new(quinn::TokioRuntime)).map_err(|e| setup(&e))
}

/// Kernel buffers of a UDP socket, in bytes, as far as the system says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UdpBuffers {
    /// For what is sent.
    pub send: Option<usize>,
    /// For what is received.
    pub receive: Option<usize>,
}

impl UdpBuffers {
    /// What the transport asks for, in each direction.
    pub const WANTED: usize = limits::SOCKET_BUFFER_BYTES;

    /// What this system gives to a socket that asks for [`UdpBuffers::WANTED`].
    pub fn of_this_system() -> io::Result<Self> {
        enlarge_buffers(&UdpSocket::bind((std::net::Ipv4Addr::LOCALHOST, 0))?)
    }

    /// Whether a busy machine may lose packets for want of room, which are then sent twice.
    pub fn are_small(&self) -> bool {
        self.send.min(self.receive).is_none_or(|bytes| bytes < Self::WANTED)
    }
}

/// Asks for the buffers that the transport wants; what the system gives.
fn enlarge_buffers(socket: &UdpSocket) -> io::Result<UdpBuffers> {
    let state = quinn::udp::UdpSocketState::new(socket.into())?;
    // A system may refuse; what counts is what it gives. Linux reports twice what it gives to data, and gives less
    // than was asked for where its limit is lower.
    let _ = state.set_send_buffer_size(socket.into(), UdpBuffers::WANTED);
    let _ = state.set_recv_buffer_size(socket.into(), UdpBuffers::WANTED);
    let (send, receive) = (state.send_buffer_size(socket.into()), state.recv_buffer_size(socket.into()));
    Ok(UdpBuffers { send: send.ok(), receive: receive.ok() })
}

/// Lets the peer send as fast as it likes: it has shown a valid token.
pub(crate) fn admit(connection: &Connection) {
    connection.set_receive_window(VarInt::from_u32(limits::CONNECTION_WINDOW_BYTES));
}

/// An address at which others reach a socket bound to `bound`: itself, or, when it is bound to all of the machine's addresses, the one
/// that packets to far away leave from.
pub(crate) fn reachable(bound: IpAddr) -> IpAddr {
    if !bound.is_unspecified() {
        return bound;
    }
    // Nothing is sent: connecting a UDP socket only chooses a route. The addresses are reserved for documentation (RFC 5737, 3849).
    let route = |from: &str, to: &str| {
        let socket = UdpSocket::bind(from).ok()?;
        socket.connect(to).ok()?;
        Some(socket.local_addr().ok()?.ip()).filter(|ip| !ip.is_unspecified())
    };
    let v4 = || route("0.0.0.0:0", "192.0.2.1:9");
    let found = if bound.is_ipv6() { route("[::]:0", "[2001:db8::1]:9").or_else(v4) } else { v4() };
    found.unwrap_or(if bound.is_ipv6() {
        std::net::Ipv6Addr::LOCALHOST.into()
    } else {
        std::net::Ipv4Addr::LOCALHOST.into()
    })
}

/// How long a joiner may hold an acknowledgement back. By default that is 25 ms, which a master that waits for room, and the loss of the last
/// packets, then wait for.
const ACK_DELAY: Duration = Duration::from_millis(2);

/// QUIC's settings on this side; the numbers and their reasons are in [`limits`]. The joiner has the mirror
/// image, but for the congestion control. Who has not been let in yet has a small window: it is raised by [`admit`].
///
/// A master sends packs, long and to few at a time: BBR brings 81 of 96 Mbit/s over the emulated `wan` and 156 of 189 over `wifi-ac`, of which
/// one packet of a thousand is lost, where Cubic brings 50 and 105 (`tessera bench link`, `down`). Over `lan100` both bring 90 of 98.
fn transport() -> TransportConfig {
    let mut discovery = MtuDiscoveryConfig::default();
    discovery.upper_bound(limits::UDP_PAYLOAD_BYTES);
    let mut acknowledgements = AckFrequencyConfig::default();
    acknowledgements.max_ack_delay(Some(ACK_DELAY));
    let mut transport = TransportConfig::default();
    transport
        .mtu_discovery_config(Some(discovery))
        .max_idle_timeout(IdleTimeout::try_from(limits::IDLE_TIMEOUT).ok())
        .keep_alive_interval(Some(limits::KEEP_ALIVE))
        .max_concurrent_bidi_streams(VarInt::from_u32(1))
        .max_concurrent_uni_streams(VarInt::from_u32(1))
        .stream_receive_window(VarInt::from_u32(limits::STREAM_WINDOW_BYTES))
        .receive_window(VarInt::from_u32(limits::STRANGER_WINDOW_BYTES))
        .send_window(limits::CONNECTION_WINDOW_BYTES.into())
        .congestion_controller_factory(Arc::new(BbrConfig::default()))
        .ack_frequency_config(Some(acknowledgements))
        .datagram_receive_buffer_size(None);
    transport
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transport_is_what_the_limits_say() {
        let text = format!("{:?}", transport());
        for part in [
            "max_idle_timeout: Some(5000)",
            "keep_alive_interval: Some(1s)",
            "max_concurrent_bidi_streams: 1",
            "max_concurrent_uni_streams: 1",
            "stream_receive_window: 8388608",
            "receive_window: 16384",
            "send_window: 16777216",
            "datagram_receive_buffer_size: None",
            "max_ack_delay: Some(2ms)",
            "upper_bound: 8972",
        ] {
            assert!(text.contains(part), "`{part}` is not in {text}");
        }
    }

    #[test]
    fn an_address_that_others_can_use() {
        for text in ["127.0.0.1", "::1", "192.0.2.7"] {
            let ip: IpAddr = text.parse().unwrap();
            assert_eq!(reachable(ip), ip);
        }
        for text in ["0.0.0.0", "::"] {
            assert!(!reachable(text.parse().unwrap()).is_unspecified(), "{text}");
        }
    }

    #[tokio::test]
    async fn a_port_that_is_taken_is_named() {
        let own = Identity::new().unwrap();
        let first = listen("127.0.0.1:0".parse().unwrap(), &own).unwrap();
        let address = first.local_addr().unwrap();
        let message = listen(address, &own).unwrap_err().to_string();
        assert!(
            message.contains(&address.to_string()) && message.contains("another address or port"),
            "{message}"
        );
    }
}

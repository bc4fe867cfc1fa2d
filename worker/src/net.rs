//! QUIC, the worker's side.

use crate::{WorkerError, WorkerPipes};
use quinn::{
    ClientConfig, Connection, Endpoint, EndpointConfig, IdleTimeout, MtuDiscoveryConfig, TransportConfig,
    VarInt, crypto::rustls::QuicClientConfig,
};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use std::{
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
    sync::Arc,
    time::Duration,
};
use tessera_wire::{AbortCode, LocalTicket, codec, limits};
use tokio::time::timeout;

/// A connection to a master that has taken the worker's certificate; nothing was said yet.
pub(crate) struct Connected {
    pub(crate) pipes: WorkerPipes,
    pub(crate) closer: Closer,
}

/// What ends a connection.
pub(crate) struct Closer {
    endpoint: Endpoint,
    connection: Connection,
}

impl Closer {
    /// Lets the last messages out, then closes.
    pub(crate) async fn close(self, in_peace: bool) {
        /// How long the master may take to close after this side's last message.
        const FAREWELL: Duration = Duration::from_secs(1);
        if !in_peace {
            let _ = timeout(FAREWELL, self.connection.closed()).await;
        }
        self.connection.close(VarInt::from_u32(AbortCode::Done.number()), b"");
        let _ = timeout(FAREWELL, self.endpoint.wait_idle()).await;
    }
}

/// Connects to the master of `ticket`, both sides showing their certificates.
pub(crate) async fn connect(ticket: &LocalTicket) -> Result<Connected, WorkerError> {
    let failed = |reason: String| WorkerError::Connect { address: ticket.address.clone(), reason };
    let try_connect = async {
        let address: SocketAddr = ticket.address.parse().map_err(|_| "not an address".to_string())?;
        let endpoint = endpoint(address)?;
        let connecting = endpoint
            .connect_with(client_config(ticket)?, address, codec::SERVER_NAME)
            .map_err(|e| e.to_string())?;
        let connection = connecting.await.map_err(|e| e.to_string())?;
        // The handshake ends on this side before the master has judged the certificate: its first stream is
        // the proof that it has.
        let (control_out, control_in) = connection.open_bi().await.map_err(|e| e.to_string())?;
        let mut bulk_out = connection.open_uni().await.map_err(|e| e.to_string())?;
        bulk_out.write_all(&codec::BULK_TAG).await.map_err(|e| e.to_string())?;
        let mut bulk_in = connection.accept_uni().await.map_err(|e| e.to_string())?;
        let mut tag = [0; codec::BULK_TAG.len()];
        bulk_in.read_exact(&mut tag).await.map_err(|e| e.to_string())?;
        if tag != codec::BULK_TAG {
            return Err("it does not speak this protocol".to_string());
        }
        let pipes = WorkerPipes {
            control_in: Box::new(control_in),
            control_out: Box::new(control_out),
            bulk_in: Box::new(bulk_in),
            bulk_out: Box::new(bulk_out),
        };
        Ok(Connected { pipes, closer: Closer { endpoint, connection } })
    };
    match timeout(limits::HANDSHAKE_TIMEOUT, try_connect).await {
        Ok(result) => result.map_err(failed),
        Err(_) => Err(failed("no answer in time".into())),
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

fn client_config(ticket: &LocalTicket) -> Result<ClientConfig, String> {
    let mut roots = rustls::RootCertStore::empty();
    roots.add(CertificateDer::from(ticket.authority.clone())).map_err(|e| e.to_string())?;
    let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(ticket.key.clone()));
    let chain = vec![CertificateDer::from(ticket.certificate.clone())];
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut tls = rustls::ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(|e| e.to_string())?
        .with_root_certificates(roots)
        .with_client_auth_cert(chain, key)
        .map_err(|e| e.to_string())?;
    tls.alpn_protocols = vec![codec::ALPN.to_vec()];
    let quic = QuicClientConfig::try_from(tls).map_err(|e| e.to_string())?;
    let mut config = ClientConfig::new(Arc::new(quic));
    config.transport_config(Arc::new(transport()));
    Ok(config)
}

/// QUIC's settings on this side; the numbers and their reasons are in [`limits`]. The master has the mirror
/// image.
fn transport() -> TransportConfig {
    let mut discovery = MtuDiscoveryConfig::default();
    discovery.upper_bound(limits::UDP_PAYLOAD_BYTES);
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
            "max_concurrent_bidi_streams: 0",
            "max_concurrent_uni_streams: 1",
            "stream_receive_window: 8388608",
            "receive_window: 16777216",
            "send_window: 16777216",
            "datagram_receive_buffer_size: None",
            "upper_bound: 8972",
        ] {
            assert!(text.contains(part), "`{part}` is not in {text}");
        }
    }
}

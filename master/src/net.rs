//! QUIC with mutual TLS, the master's side.

use crate::transport::{Link, Pipes};
use quinn::{
    Endpoint, EndpointConfig, IdleTimeout, Incoming, MtuDiscoveryConfig, ServerConfig, TransportConfig,
    VarInt, crypto::rustls::QuicServerConfig,
};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use rustls::{
    RootCertStore,
    pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer},
    server::WebPkiClientVerifier,
};
use std::{
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    sync::Arc,
};
use tessera_wire::{codec, limits};
use tokio::time::timeout;

/// A throw-away certificate authority: it lives as long as the cluster and signs one certificate for the
/// master and one for each worker. Its key is never written anywhere.
pub(crate) struct Authority {
    issuer: Issuer<'static, KeyPair>,
    certificate: CertificateDer<'static>,
}

/// A certificate and its key.
pub(crate) struct Identity {
    pub(crate) certificate: CertificateDer<'static>,
    /// PKCS#8.
    pub(crate) key: Vec<u8>,
}

impl Authority {
    /// A new one.
    pub(crate) fn new() -> Result<Self, rcgen::Error> {
        let mut params = CertificateParams::default();
        params.distinguished_name.push(DnType::CommonName, "tessera cluster");
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        let key = KeyPair::generate()?;
        let certificate = params.self_signed(&key)?.der().clone();
        Ok(Self { issuer: Issuer::new(params, key), certificate })
    }

    /// What workers trust.
    pub(crate) fn certificate(&self) -> &CertificateDer<'static> {
        &self.certificate
    }

    /// An identity for a worker.
    pub(crate) fn worker(&self, name: &str) -> Result<Identity, rcgen::Error> {
        self.issue(name, ExtendedKeyUsagePurpose::ClientAuth)
    }

    fn issue(&self, name: &str, usage: ExtendedKeyUsagePurpose) -> Result<Identity, rcgen::Error> {
        let mut params = CertificateParams::new([name.to_string()])?;
        params.distinguished_name.push(DnType::CommonName, name);
        params.extended_key_usages = vec![usage];
        let key = KeyPair::generate()?;
        let certificate = params.signed_by(&key, &self.issuer)?.der().clone();
        Ok(Identity { certificate, key: key.serialize_der() })
    }

    fn server_config(&self) -> Result<ServerConfig, Box<dyn std::error::Error + Send + Sync>> {
        let own = self.issue(codec::SERVER_NAME, ExtendedKeyUsagePurpose::ServerAuth)?;
        let mut roots = RootCertStore::empty();
        roots.add(self.certificate.clone())?;
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let verifier =
            WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider.clone()).build()?;
        let mut tls = rustls::ServerConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&rustls::version::TLS13])?
            .with_client_cert_verifier(verifier)
            .with_single_cert(
                vec![own.certificate],
                PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(own.key)),
            )?;
        tls.alpn_protocols = vec![codec::ALPN.to_vec()];
        let mut config = ServerConfig::with_crypto(Arc::new(QuicServerConfig::try_from(tls)?));
        config.transport_config(Arc::new(transport()));
        Ok(config)
    }
}

/// A socket on loopback, any port, that takes only workers with a certificate of `authority`.
pub(crate) fn listen(authority: &Authority) -> Result<Endpoint, Box<dyn std::error::Error + Send + Sync>> {
    let socket = UdpSocket::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)))?;
    let state = quinn::udp::UdpSocketState::new((&socket).into())?;
    // A system may refuse; what counts is what it gives. Linux reports twice what it gives to data, and gives less
    // than was asked for where its limit is lower.
    let _ = state.set_send_buffer_size((&socket).into(), limits::SOCKET_BUFFER_BYTES);
    let _ = state.set_recv_buffer_size((&socket).into(), limits::SOCKET_BUFFER_BYTES);
    let given =
        state.send_buffer_size((&socket).into()).ok().min(state.recv_buffer_size((&socket).into()).ok());
    if given.is_none_or(|bytes| bytes < limits::SOCKET_BUFFER_BYTES) {
        tracing::info!(
            wanted = limits::SOCKET_BUFFER_BYTES,
            given,
            "the system gives UDP sockets smaller buffers than wanted; a busy machine may then send packets twice; \
             on Linux raise net.core.rmem_max and net.core.wmem_max"
        );
    }
    let config = authority.server_config()?;
    let runtime = Arc::new(quinn::TokioRuntime);
    let mut endpoint = EndpointConfig::default();
    endpoint.max_udp_payload_size(limits::UDP_PAYLOAD_BYTES)?;
    Ok(Endpoint::new(endpoint, Some(config), socket, runtime)?)
}

/// Completes a connection: the certificate that the worker has shown, and the link.
pub(crate) async fn accept(incoming: Incoming) -> Result<(CertificateDer<'static>, Link), String> {
    let peer = incoming.remote_address().to_string();
    let complete = async {
        let connection = incoming.await.map_err(|e| e.to_string())?;
        let identity = connection.peer_identity().and_then(|any| any.downcast::<Vec<CertificateDer>>().ok());
        let certificate = identity.and_then(|chain| chain.first().cloned()).ok_or("no certificate")?;
        // Tells the worker that its certificate is accepted.
        let mut bulk_out = connection.open_uni().await.map_err(|e| e.to_string())?;
        bulk_out.write_all(&codec::BULK_TAG).await.map_err(|e| e.to_string())?;
        let mut bulk_in = connection.accept_uni().await.map_err(|e| e.to_string())?;
        let mut tag = [0; codec::BULK_TAG.len()];
        bulk_in.read_exact(&mut tag).await.map_err(|e| e.to_string())?;
        if tag != codec::BULK_TAG {
            return Err("it does not speak this protocol".to_string());
        }
        let (control_out, control_in) = connection.accept_bi().await.map_err(|e| e.to_string())?;
        let pipes = Pipes {
            control_in: Box::new(control_in),
            control_out: Box::new(control_out),
            bulk_in: Box::new(bulk_in),
            bulk_out: Box::new(bulk_out),
        };
        Ok((certificate, Link { pipes, peer: peer.clone(), connection: Some(connection) }))
    };
    match timeout(limits::HANDSHAKE_TIMEOUT, complete).await {
        Ok(result) => result.map_err(|reason| format!("{peer}: {reason}")),
        Err(_) => Err(format!("{peer}: the handshake was not completed in time")),
    }
}

/// QUIC's settings on this side; the numbers and their reasons are in [`limits`]. The worker has the mirror
/// image.
fn transport() -> TransportConfig {
    let mut discovery = MtuDiscoveryConfig::default();
    discovery.upper_bound(limits::UDP_PAYLOAD_BYTES);
    let mut transport = TransportConfig::default();
    transport
        .mtu_discovery_config(Some(discovery))
        .max_idle_timeout(IdleTimeout::try_from(limits::IDLE_TIMEOUT).ok())
        .keep_alive_interval(Some(limits::KEEP_ALIVE))
        .max_concurrent_bidi_streams(VarInt::from_u32(1))
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
            "max_concurrent_bidi_streams: 1",
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

    /// Connects with what `identity` shows, and says whether the master took it.
    async fn is_accepted(authority: &Authority, identity: Option<Identity>) -> bool {
        let endpoint = listen(authority).unwrap();
        let address = endpoint.local_addr().unwrap();
        let mut roots = RootCertStore::empty();
        roots.add(authority.certificate().clone()).unwrap();
        let builder =
            rustls::ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
                .with_protocol_versions(&[&rustls::version::TLS13])
                .unwrap()
                .with_root_certificates(roots);
        let mut tls = match identity {
            Some(Identity { certificate, key }) => {
                let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key));
                builder.with_client_auth_cert(vec![certificate], key).unwrap()
            }
            None => builder.with_no_client_auth(),
        };
        tls.alpn_protocols = vec![codec::ALPN.to_vec()];
        let quic = quinn::crypto::rustls::QuicClientConfig::try_from(tls).unwrap();
        let client = Endpoint::client(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).unwrap();
        let connecting = client
            .connect_with(quinn::ClientConfig::new(Arc::new(quic)), address, codec::SERVER_NAME)
            .unwrap();
        // What a worker does: the streams, and the first byte of each.
        let connect = async {
            let connection = connecting.await.map_err(|e| e.to_string())?;
            let (mut control, _) = connection.open_bi().await.map_err(|e| e.to_string())?;
            let mut bulk = connection.open_uni().await.map_err(|e| e.to_string())?;
            bulk.write_all(&codec::BULK_TAG).await.map_err(|e| e.to_string())?;
            control.write_all(&[0]).await.map_err(|e| e.to_string())?;
            connection.accept_uni().await.map_err(|e| e.to_string())?;
            Ok::<_, String>((connection, control, bulk))
        };
        let incoming = endpoint.accept().await.unwrap();
        let (connected, accepted) = tokio::join!(connect, accept(incoming));
        assert_eq!(connected.is_ok(), accepted.is_ok(), "both ends agree");
        accepted.is_ok()
    }

    #[tokio::test]
    async fn only_workers_with_a_certificate_of_this_authority_are_taken() {
        let authority = Authority::new().unwrap();
        assert!(is_accepted(&authority, Some(authority.worker("w").unwrap())).await);
        assert!(!is_accepted(&authority, None).await, "without a certificate");
        let other = Authority::new().unwrap();
        assert!(!is_accepted(&authority, Some(other.worker("w").unwrap())).await, "another authority");
        let server = authority.issue("w", ExtendedKeyUsagePurpose::ServerAuth).unwrap();
        assert!(!is_accepted(&authority, Some(server)).await, "a certificate for another purpose");
    }
}

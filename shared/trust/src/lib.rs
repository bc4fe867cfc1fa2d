//! Who is who between machines. Every process makes a self-signed certificate when it starts and forgets it when it ends; nobody
//! signs for anybody else.
//!
//! A joiner knows its master by the fingerprint in the join string. The master takes any certificate at the handshake and knows a
//! joiner by the fingerprint of it once a valid token has come; the handshake's signature proves that the key is the peer's. TLS 1.3
//! only, and no resumption: each connection proves its identity anew.

mod verify;

use rcgen::{CertificateParams, DnType, KeyPair};
use ring::digest::{SHA256, digest};
use rustls::{
    ClientConfig, ServerConfig,
    client::Resumption,
    crypto::CryptoProvider,
    pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer},
    server::NoServerSessionStorage,
};
use std::sync::Arc;
use tessera_wire::{Fingerprint, Token, codec};
use verify::{AnyJoiner, PinnedMaster};

/// A certificate and its key (ECDSA on P-256). The key is never written anywhere.
pub struct Identity {
    certificate: CertificateDer<'static>,
    /// PKCS#8.
    key: PrivatePkcs8KeyDer<'static>,
}

/// The system gives no random numbers, or the cryptographic library refuses its own work: nothing that a user can mend.
#[derive(Debug, thiserror::Error)]
#[error("cannot set up encryption: {0}")]
pub struct TrustError(String);

/// The TLS alert that a joiner sends a master whose certificate is not the pinned one: `access_denied` (RFC 8446, section 6).
pub const WRONG_MASTER_ALERT: u8 = 49;

/// The TLS alert that a peer sends who speaks another protocol: `no_application_protocol` (RFC 7301, section 3.2).
pub const OTHER_PROTOCOL_ALERT: u8 = 120;

impl Identity {
    /// A new one.
    pub fn new() -> Result<Self, TrustError> {
        let mut params = CertificateParams::new([codec::SERVER_NAME.to_string()]).map_err(failed)?;
        params.distinguished_name.push(DnType::CommonName, codec::SERVER_NAME);
        let pair = KeyPair::generate().map_err(failed)?;
        let certificate = params.self_signed(&pair).map_err(failed)?.der().clone();
        Ok(Self { certificate, key: PrivatePkcs8KeyDer::from(pair.serialize_der()) })
    }

    /// What others know it by.
    pub fn fingerprint(&self) -> Fingerprint {
        fingerprint(&self.certificate)
    }

    fn key(&self) -> PrivateKeyDer<'static> {
        PrivateKeyDer::Pkcs8(self.key.clone_key())
    }
}

impl std::fmt::Debug for Identity {
    /// Without the key.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Identity").field(&self.fingerprint()).finish()
    }
}

/// SHA-256 of a certificate.
pub fn fingerprint(certificate: &CertificateDer<'_>) -> Fingerprint {
    let mut bytes = [0; 32];
    bytes.copy_from_slice(digest(&SHA256, certificate).as_ref());
    Fingerprint(bytes)
}

/// A token that nobody can guess.
pub fn new_token() -> Result<Token, TrustError> {
    let mut token = Token::default();
    provider().secure_random.fill(&mut token.0).map_err(|_| TrustError("no random numbers".into()))?;
    Ok(token)
}

/// TLS of a master: shows `own`, wants a certificate of each joiner, and leaves it to the token whether that one may join.
pub fn master_config(own: &Identity) -> Result<ServerConfig, TrustError> {
    let provider = provider();
    let mut tls = ServerConfig::builder_with_provider(provider.clone())
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(failed)?
        .with_client_cert_verifier(Arc::new(AnyJoiner::new(provider)))
        .with_single_cert(vec![own.certificate.clone()], own.key())
        .map_err(failed)?;
    tls.alpn_protocols = vec![codec::ALPN.to_vec()];
    tls.session_storage = Arc::new(NoServerSessionStorage {});
    tls.send_tls13_tickets = 0;
    Ok(tls)
}

/// TLS of a joiner: shows `own`, and goes on only with the master that has the certificate with fingerprint `master`.
pub fn joiner_config(own: &Identity, master: Fingerprint) -> Result<ClientConfig, TrustError> {
    let provider = provider();
    let mut tls = ClientConfig::builder_with_provider(provider.clone())
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(failed)?
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(PinnedMaster::new(master, provider)))
        .with_client_auth_cert(vec![own.certificate.clone()], own.key())
        .map_err(failed)?;
    tls.alpn_protocols = vec![codec::ALPN.to_vec()];
    tls.resumption = Resumption::disabled();
    Ok(tls)
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(rustls::crypto::ring::default_provider())
}

fn failed(error: impl std::fmt::Display) -> TrustError {
    TrustError(error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustls::pki_types::ServerName;
    use rustls::sign::{CertifiedKey, SingleCertAndKey};
    use rustls::{ClientConnection, ServerConnection};

    #[test]
    fn identities_and_tokens_differ() {
        let (a, b) = (Identity::new().unwrap(), Identity::new().unwrap());
        assert_ne!(a.fingerprint(), b.fingerprint());
        assert_ne!(new_token().unwrap(), new_token().unwrap());
        // FIPS 180-2, appendix B.1.
        let abc = fingerprint(&CertificateDer::from(b"abc".to_vec())).to_string();
        assert_eq!(abc, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    /// A whole handshake in memory: what the master then knows of the joiner.
    fn handshake(client: ClientConfig, server: ServerConfig) -> Result<Fingerprint, rustls::Error> {
        let name = ServerName::try_from(codec::SERVER_NAME).unwrap();
        let mut client = ClientConnection::new(Arc::new(client), name).unwrap();
        let mut server = ServerConnection::new(Arc::new(server)).unwrap();
        while client.is_handshaking() || server.is_handshaking() || client.wants_write() {
            let mut bytes = Vec::new();
            client.write_tls(&mut bytes).unwrap();
            server.read_tls(&mut &bytes[..]).unwrap();
            server.process_new_packets()?;
            bytes.clear();
            server.write_tls(&mut bytes).unwrap();
            client.read_tls(&mut &bytes[..]).unwrap();
            client.process_new_packets()?;
        }
        Ok(fingerprint(&server.peer_certificates().unwrap()[0]))
    }

    #[test]
    fn each_side_knows_the_other_by_its_fingerprint() {
        let (master, joiner) = (Identity::new().unwrap(), Identity::new().unwrap());
        let server = || master_config(&master).unwrap();
        let client = |pin| joiner_config(&joiner, pin).unwrap();
        assert_eq!(handshake(client(master.fingerprint()), server()), Ok(joiner.fingerprint()));
        let wrong = handshake(client(joiner.fingerprint()), server()).unwrap_err();
        assert!(matches!(wrong, rustls::Error::InvalidCertificate(_)), "{wrong:?}");
    }

    #[test]
    fn a_certificate_without_its_key_proves_nothing() {
        let (master, joiner, thief) =
            (Identity::new().unwrap(), Identity::new().unwrap(), Identity::new().unwrap());
        // What rustls would not let happen by mistake: the certificate of one, signatures of another.
        let stolen = |of: &Identity| {
            let key = provider().key_provider.load_private_key(thief.key()).unwrap();
            Arc::new(SingleCertAndKey::from(CertifiedKey::new(vec![of.certificate.clone()], key)))
        };
        let bad_signature = |result: Result<Fingerprint, rustls::Error>| {
            assert_eq!(result, Err(rustls::CertificateError::BadSignature.into()));
        };
        let mut client = joiner_config(&thief, master.fingerprint()).unwrap();
        client.client_auth_cert_resolver = stolen(&joiner);
        bad_signature(handshake(client, master_config(&master).unwrap()));
        let mut server = master_config(&thief).unwrap();
        server.cert_resolver = stolen(&master);
        bad_signature(handshake(joiner_config(&joiner, master.fingerprint()).unwrap(), server));
    }

    #[test]
    fn another_protocol_and_a_joiner_without_a_certificate_are_turned_away() {
        let (master, joiner) = (Identity::new().unwrap(), Identity::new().unwrap());
        let mut other = joiner_config(&joiner, master.fingerprint()).unwrap();
        other.alpn_protocols = vec![b"h3".to_vec()];
        let refused = handshake(other, master_config(&master).unwrap()).unwrap_err();
        assert_eq!(refused, rustls::Error::NoApplicationProtocol);
        let mut nobody = ClientConfig::builder_with_provider(provider())
            .with_protocol_versions(&[&rustls::version::TLS13])
            .unwrap()
            .dangerous()
            .with_custom_certificate_verifier(Arc::new(PinnedMaster::new(master.fingerprint(), provider())))
            .with_no_client_auth();
        nobody.alpn_protocols = vec![codec::ALPN.to_vec()];
        let refused = handshake(nobody, master_config(&master).unwrap()).unwrap_err();
        assert_eq!(refused, rustls::Error::NoCertificatesPresented);
    }
}

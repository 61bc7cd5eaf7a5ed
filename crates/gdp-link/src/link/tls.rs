//! TLS 1.3 between entities, with raw P-256 public keys (RFC 7250).
//!
//! Each side presents the public key that its name is derived from, and proves possession of the
//! private key. There are no certificates to parse, no authority and no resumption. Certificates of
//! the control plane decide at a higher layer which names may communicate.

use std::sync::Arc;
use std::time::Duration;

use quinn::congestion::CubicConfig;
use quinn::crypto::rustls::{QuicClientConfig, QuicServerConfig};
use quinn::{AckFrequencyConfig, ClientConfig, IdleTimeout, ServerConfig, TransportConfig, VarInt};
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::client::{AlwaysResolvesClientRawPublicKeys, Resumption};
use rustls::crypto::aws_lc_rs::{self, sign::any_ecdsa_type};
use rustls::crypto::{WebPkiSupportedAlgorithms, verify_tls13_signature_with_raw_key};
use rustls::pki_types::{
    CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, ServerName, SubjectPublicKeyInfoDer, UnixTime,
};
use rustls::server::danger::{ClientCertVerified, ClientCertVerifier};
use rustls::server::{AlwaysResolvesServerRawPublicKeys, NoServerSessionStorage};
use rustls::sign::CertifiedKey;
use rustls::version::TLS13;
use rustls::{CertificateError, DigitallySignedStruct, DistinguishedName, Error, PeerMisbehaved, SignatureScheme};

use crate::link::error::LinkError;
use crate::link::timing::{IDLE_TIMEOUT, KEEP_ALIVE, MAX_STREAMS};
use crate::link::version::Versions;
use gdp_core::identity::{SigningKey, VerifyKey};
use gdp_proto::control::MAX_MESSAGE;

/// The server name that a client passes to rustls. It is not sent.
pub const SERVER_NAME: &str = "gdp";

/// DER of a SubjectPublicKeyInfo for an uncompressed P-256 point, up to the 0x04 that begins the
/// point (RFC 5480).
const SPKI_PREFIX: [u8; 27] = [
    0x30, 0x59, 0x30, 0x13, 0x06, 0x07, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x02, 0x01, 0x06, 0x08, 0x2a, 0x86, 0x48, 0xce,
    0x3d, 0x03, 0x01, 0x07, 0x03, 0x42, 0x00, 0x04,
];

/// Path MTU of the QUIC packets of a connection, in bytes.
#[derive(Clone, Copy, Debug)]
pub struct QuicMtu {
    pub initial: u16,
    /// Upper bound of path MTU discovery, in bytes.
    pub discover_up_to: Option<u16>,
}

/// The QUIC configurations of an entity. Each connection has a path MTU of its own.
pub struct QuicConfigs {
    client: ClientConfig,
    server: ServerConfig,
}

impl QuicConfigs {
    /// Returns the configurations for an entity with this key that speaks these versions.
    /// `migration`: peers may change their addresses within a connection.
    pub fn new(key: &SigningKey, versions: Versions, migration: bool) -> Result<Self, LinkError> {
        let (client, mut server) = tls_configs(key, versions)?;
        server.migration(migration);
        Ok(Self { client, server })
    }

    pub fn client(&self, mtu: QuicMtu) -> ClientConfig {
        let (mut client, mut transport) = (self.client.clone(), transport(mtu));
        // The packets of one side keep both alive, and the answers tell the dialler of the peer.
        transport.keep_alive_interval(Some(KEEP_ALIVE));
        client.transport_config(Arc::new(transport));
        client
    }

    pub fn server(&self, mtu: QuicMtu) -> ServerConfig {
        let mut server = self.server.clone();
        server.transport_config(Arc::new(transport(mtu)));
        server
    }
}

fn tls_configs(key: &SigningKey, versions: Versions) -> Result<(ClientConfig, ServerConfig), LinkError> {
    let provider = Arc::new(aws_lc_rs::default_provider());
    let verifier = Arc::new(RawKeyVerifier(provider.signature_verification_algorithms));
    let certified = Arc::new(certified_key(key)?);

    let mut client = rustls::ClientConfig::builder_with_provider(provider.clone())
        .with_protocol_versions(&[&TLS13])
        .map_err(tls_error)?
        .dangerous()
        .with_custom_certificate_verifier(verifier.clone())
        .with_client_cert_resolver(Arc::new(AlwaysResolvesClientRawPublicKeys::new(certified.clone())));
    client.alpn_protocols = versions.offered();
    client.resumption = Resumption::disabled();
    client.enable_sni = false;

    let mut server = rustls::ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&TLS13])
        .map_err(tls_error)?
        .with_client_cert_verifier(verifier)
        .with_cert_resolver(Arc::new(AlwaysResolvesServerRawPublicKeys::new(certified)));
    server.alpn_protocols = versions.offered();
    server.session_storage = Arc::new(NoServerSessionStorage {});
    server.send_tls13_tickets = 0;

    let client = ClientConfig::new(Arc::new(QuicClientConfig::try_from(client).map_err(setup_error)?));
    let server = ServerConfig::with_crypto(Arc::new(QuicServerConfig::try_from(server).map_err(setup_error)?));
    Ok((client, server))
}

/// Returns the key that a peer proved to possess, from the identity that quinn reports.
pub fn peer_key(connection: &quinn::Connection) -> Result<VerifyKey, LinkError> {
    let shown = connection.peer_identity().and_then(|any| any.downcast::<Vec<CertificateDer<'static>>>().ok());
    let Some([spki]) = shown.as_deref().map(Vec::as_slice) else {
        return Err(LinkError::Handshake("the peer showed no key".into()));
    };
    parse_spki(spki).map_err(tls_error)
}

fn certified_key(key: &SigningKey) -> Result<CertifiedKey, LinkError> {
    let pkcs8 = key.pkcs8_der();
    let der = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(pkcs8.as_slice()));
    // Borrowed: `load_private_key` of the provider takes a copy of the key and does not clear it.
    let signer = any_ecdsa_type(&der).map_err(tls_error)?;
    let spki = signer.public_key().ok_or_else(|| LinkError::Handshake("the key has no public half".into()))?;
    let shown = CertificateDer::from(spki.as_ref().to_vec());
    Ok(CertifiedKey::new(vec![shown], signer))
}

/// Bytes in flight before the first acknowledgement. Quinn counts probes of the MTU, up to 12 kB,
/// and holds back the close of a link while they fill the window. A refused peer would then learn
/// no reason.
const INITIAL_WINDOW: u64 = 64 * 1024;

/// Returns the transport parameters. Streams and windows limit a peer's data in this side's memory
/// to about half a megabyte.
fn transport(mtu: QuicMtu) -> TransportConfig {
    let message = MAX_MESSAGE as u32 + 1024;
    let mut transport = TransportConfig::default();
    // An acknowledgement that waits for company would wake the thread once more.
    let mut acknowledgements = AckFrequencyConfig::default();
    acknowledgements.ack_eliciting_threshold(VarInt::from_u32(0));
    let mut congestion = CubicConfig::default();
    congestion.initial_window(INITIAL_WINDOW);
    transport
        .congestion_controller_factory(Arc::new(congestion))
        .ack_frequency_config(Some(acknowledgements))
        .max_idle_timeout(Some(IdleTimeout::from(VarInt::from_u32(IDLE_TIMEOUT.as_millis() as u32))))
        .max_concurrent_bidi_streams(VarInt::from_u32(MAX_STREAMS))
        .max_concurrent_uni_streams(VarInt::from_u32(0))
        .datagram_receive_buffer_size(None)
        .stream_receive_window(VarInt::from_u32(message))
        .receive_window(VarInt::from_u32(8 * message))
        .send_window(8 * u64::from(message))
        .initial_rtt(Duration::from_millis(50))
        .initial_mtu(mtu.initial)
        .mtu_discovery_config(mtu.discover_up_to.map(|upper_bound| {
            let mut discovery = quinn::MtuDiscoveryConfig::default();
            discovery.upper_bound(upper_bound);
            discovery
        }));
    transport
}

fn parse_spki(der: &[u8]) -> Result<VerifyKey, Error> {
    let bad = || Error::InvalidCertificate(CertificateError::BadEncoding);
    let point = der.strip_prefix(&SPKI_PREFIX).filter(|point| point.len() == 64).ok_or_else(bad)?;
    let mut compressed = [0; 33];
    compressed[0] = 2 | (point[63] & 1);
    compressed[1..].copy_from_slice(&point[..32]);
    VerifyKey::from_bytes(&compressed).map_err(|_| bad())
}

/// Accepts any P-256 key with which the peer has signed the handshake.
#[derive(Debug)]
struct RawKeyVerifier(WebPkiSupportedAlgorithms);

impl RawKeyVerifier {
    fn check_key(shown: &CertificateDer<'_>, others: &[CertificateDer<'_>]) -> Result<(), Error> {
        if !others.is_empty() {
            return Err(Error::InvalidCertificate(CertificateError::BadEncoding));
        }
        parse_spki(shown).map(drop)
    }

    fn check_signature(
        &self,
        message: &[u8],
        shown: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        if signed.scheme != SignatureScheme::ECDSA_NISTP256_SHA256 {
            return Err(PeerMisbehaved::SignedHandshakeWithUnadvertisedSigScheme.into());
        }
        verify_tls13_signature_with_raw_key(message, &SubjectPublicKeyInfoDer::from(shown.as_ref()), signed, &self.0)
    }
}

fn no_tls12() -> Error {
    Error::PeerIncompatible(rustls::PeerIncompatible::Tls13RequiredForQuic)
}

impl ServerCertVerifier for RawKeyVerifier {
    fn verify_server_cert(
        &self,
        shown: &CertificateDer<'_>,
        others: &[CertificateDer<'_>],
        _name: &ServerName<'_>,
        _ocsp: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        Self::check_key(shown, others).map(|()| ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _shown: &CertificateDer<'_>,
        _signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Err(no_tls12())
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        shown: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        self.check_signature(message, shown, signed)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        vec![SignatureScheme::ECDSA_NISTP256_SHA256]
    }

    fn requires_raw_public_keys(&self) -> bool {
        true
    }
}

impl ClientCertVerifier for RawKeyVerifier {
    fn root_hint_subjects(&self) -> &[DistinguishedName] {
        &[]
    }

    fn verify_client_cert(
        &self,
        shown: &CertificateDer<'_>,
        others: &[CertificateDer<'_>],
        _now: UnixTime,
    ) -> Result<ClientCertVerified, Error> {
        Self::check_key(shown, others).map(|()| ClientCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _shown: &CertificateDer<'_>,
        _signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Err(no_tls12())
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        shown: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        self.check_signature(message, shown, signed)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        vec![SignatureScheme::ECDSA_NISTP256_SHA256]
    }

    fn requires_raw_public_keys(&self) -> bool {
        true
    }
}

fn tls_error(error: Error) -> LinkError {
    LinkError::Handshake(error.to_string())
}

fn setup_error(error: quinn::crypto::rustls::NoInitialCipherSuite) -> LinkError {
    LinkError::Handshake(error.to_string())
}

#[cfg(test)]
#[path = "../../tests/unit/link/tls.rs"]
mod tests;

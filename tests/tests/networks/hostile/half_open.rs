//! A stranger with many addresses opens QUIC handshakes over UDP and proves its addresses on
//! request. It ignores all other packets, so it completes none of its handshakes.
//!
//! ```text
//!  stranger 10.8.0.2, 10.66.0.0/16 ──── 10.8.0.1 switch 10.7.0.1 ──── 10.7.0.2 robot
//! ```

use std::fmt;
use std::io::{self, IoSliceMut};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context as TaskContext, Poll};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp::unstable::{Node, NodeConfig};
use gdp_core::identity::Identity;
use gdp_tests::Tools;
use gdp_tests::fabric::{Authority, Switch};
use gdp_tests::netns::{End, Namespace, veth};
use gdp_tests::wait::{TIMEOUT, wait_for};
use quinn::udp::{RecvMeta, Transmit};
use quinn::{AsyncUdpSocket, ClientConfig, Connecting, Endpoint, EndpointConfig, Runtime, TokioRuntime, UdpPoller};
use rustls::client::AlwaysResolvesClientRawPublicKeys;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use rustls::sign::CertifiedKey;
use rustls::{DigitallySignedStruct, SignatureScheme};
use serde_json::{Value, json};

use crate::inside::{Inside, ROOT};

/// Handshakes of the stranger, and of each of its addresses.
const HANDSHAKES: usize = 10_000;
const OF_ONE: usize = 20;

/// Limit of the daemon's growth in KiB during the attack.
const MEMORY: u64 = 64 << 10;

/// Endpoints that attach while the stranger continues.
const ENDPOINTS: usize = 3;

#[test]
fn ten_thousand_handshakes_that_are_not_finished_take_little_memory_and_stop_nobody() -> Result<()> {
    let tools = Tools::beside_this_test()?;
    let [switch, stranger, robot] = ["switch", "stranger", "robot"].map(Namespace::create);
    let (switch, stranger, robot) = (switch?, stranger?, robot?);
    let end = |namespace, interface, number| End { namespace, interface, mac: [2, 0, 0, 0, 0, number] };
    veth(&end(&stranger, "e0", 1), &end(&switch, "l0", 2), 1500)?;
    veth(&end(&robot, "e0", 3), &end(&switch, "r0", 4), 1500)?;
    for (at, command) in [
        (&stranger, "addr add 10.8.0.2/24 dev e0"),
        // All these addresses belong to the stranger.
        (&stranger, "route add local 10.66.0.0/16 dev lo"),
        (&switch, "addr add 10.8.0.1/24 dev l0"),
        (&switch, "route add 10.66.0.0/16 via 10.8.0.2"),
        (&switch, "addr add 10.7.0.1/24 dev r0"),
        (&robot, "addr add 10.7.0.2/24 dev e0"),
        (&robot, "route add default via 10.7.0.1"),
    ] {
        at.ip(&command.split(' ').collect::<Vec<_>>())?;
    }
    let files = tempfile::tempdir()?;
    let names = Authority { tools: &tools, folder: files.path() }.switches(1)?;
    let config = json!({
        "interfaces": [], "udp": "0.0.0.0:31415", "data_plane": "xdp", "bpffs": null, "rib": true, "fib_capacity": 1024,
    });
    let daemon = Switch::start(&tools, &switch, files.path(), ("s1", &names[0]), config)?;
    let status = || daemon.ctl(&tools, &["status"]);
    wait_for("the daemon to answer", TIMEOUT, || Ok(status().ok())).with_context(|| daemon.process.report())?;
    let attach = || -> Result<Duration> {
        let (inside, began) = (Inside::new(&robot, ROOT)?, Instant::now());
        let config = NodeConfig::new(Identity::generate("proxy")?, "udp://10.7.0.1:31415".parse()?);
        let connect = async move { tokio::time::timeout(TIMEOUT, Node::connect(config)).await };
        let node = inside.run(connect)?.context("no link")??;
        let took = began.elapsed();
        inside.runtime.block_on(node.close());
        Ok(took)
    };
    println!("attached in {:?} while all is quiet", attach()?);

    let before = super::resident_of(daemon.process.pid())?;
    let inside = Inside::new(&stranger, ROOT)?;
    let half_open = inside.run(async { open("10.8.0.1:31415".parse()?) })??;
    let (mut most, mut attached) = (0, Vec::new());
    for _ in 0..ENDPOINTS {
        let took = attach().with_context(|| {
            format!("{}\n{}", status().map(|s| s["handshakes"].clone()).unwrap_or_default(), daemon.process.report())
        })?;
        attached.push(took);
        most = most.max(super::resident_of(daemon.process.pid())?);
    }
    let enough = |counts: &Value| counts["challenged"].as_u64() >= Some(HANDSHAKES as u64 / 2);
    let counts = wait_for("the daemon to have turned most away", TIMEOUT, || {
        most = most.max(super::resident_of(daemon.process.pid())?);
        Ok(Some(status()?["handshakes"].clone()).filter(enough))
    })
    .with_context(|| format!("{}", status().unwrap_or_default()["handshakes"]))?;
    let grown = most.saturating_sub(before);
    println!(
        "{HANDSHAKES} handshakes from {} addresses: {counts}; {grown} KiB more; attached in {attached:?}",
        half_open.len()
    );
    ensure!(counts["displaced"].as_u64() > Some(0), "places were taken only: {counts}");
    ensure!(grown < MEMORY, "the daemon grew by {grown} KiB");
    Ok(())
}

/// Opens handshakes from many addresses. They continue until the returned value is dropped.
fn open(to: SocketAddr) -> Result<Vec<(Endpoint, Vec<Connecting>)>> {
    let config = client()?;
    (0..HANDSHAKES / OF_ONE)
        .map(|i| {
            let from = Ipv4Addr::new(10, 66, (i >> 8) as u8, i as u8);
            let socket = TokioRuntime.wrap_udp_socket(UdpSocket::bind((from, 0))?)?;
            let socket = Arc::new(HardOfHearing(socket));
            let mut quic = EndpointConfig::default();
            quic.grease_quic_bit(false);
            let endpoint = Endpoint::new_with_abstract_socket(quic, None, socket, Arc::new(TokioRuntime))?;
            let connect = |_| Ok(endpoint.connect_with(config.clone(), to, "gdp")?);
            let connecting = (0..OF_ONE).map(connect).collect::<Result<_>>()?;
            Ok((endpoint, connecting))
        })
        .collect()
}

/// Returns a client configuration with which a handshake begins like an endpoint's.
fn client() -> Result<ClientConfig> {
    let provider = Arc::new(rustls::crypto::aws_lc_rs::default_provider());
    let key = rcgen::KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256)?;
    let signer = provider.key_provider.load_private_key(PrivateKeyDer::Pkcs8(key.serialize_der().into()))?;
    let shown = CertificateDer::from(signer.public_key().context("a public key")?.as_ref().to_vec());
    let resolver = AlwaysResolvesClientRawPublicKeys::new(Arc::new(CertifiedKey::new(vec![shown], signer)));
    let mut tls = rustls::ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])?
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(Nobody))
        .with_client_cert_resolver(Arc::new(resolver));
    tls.alpn_protocols = vec![b"gdp/1".to_vec()];
    Ok(ClientConfig::new(Arc::new(quinn::crypto::rustls::QuicClientConfig::try_from(tls)?)))
}

/// A verifier that fails: the client must not see a server's answer.
#[derive(Debug)]
struct Nobody;

impl ServerCertVerifier for Nobody {
    fn verify_server_cert(
        &self,
        _: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        Err(rustls::Error::General("heard of a server".into()))
    }

    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        Err(rustls::Error::General("heard of a server".into()))
    }

    fn verify_tls13_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        Err(rustls::Error::General("heard of a server".into()))
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        vec![SignatureScheme::ECDSA_NISTP256_SHA256]
    }

    fn requires_raw_public_keys(&self) -> bool {
        true
    }
}

/// A socket that receives nothing but requests to prove its address.
struct HardOfHearing(Arc<dyn AsyncUdpSocket>);

impl fmt::Debug for HardOfHearing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl AsyncUdpSocket for HardOfHearing {
    fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
        self.0.clone().create_io_poller()
    }

    fn try_send(&self, transmit: &Transmit) -> io::Result<()> {
        self.0.try_send(transmit)
    }

    fn poll_recv(
        &self,
        cx: &mut TaskContext,
        bufs: &mut [IoSliceMut<'_>],
        meta: &mut [RecvMeta],
    ) -> Poll<io::Result<usize>> {
        let received = self.0.poll_recv(cx, bufs, meta);
        if let Poll::Ready(Ok(count)) = received {
            // A Retry packet (RFC 9000 §17.2.5).
            let is_retry = |buffer: &[u8]| buffer[0] & 0xf0 == 0xf0;
            let unheard = bufs.iter().zip(&mut meta[..count]).filter(|(buffer, _)| !is_retry(buffer));
            unheard.for_each(|(_, meta)| meta.len = 0);
        }
        received
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.0.local_addr()
    }
}

//! Tests of links over UDP on loopback, with honest and hostile peers.
//!
//! No root. `tests/tests/networks/link.rs` tests Ethernet.

use gdp_wire::hop;
use serde_json::json;
use std::collections::HashSet;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use gdp_wire::{Counter, FrameType, Header, Name, forward, replay};
use quinn::VarInt;
use zerocopy::{FromBytes, IntoBytes};

use super::*;
use crate::port::{InFrame, OutFrame, Port, PortConfig, RecvBatch};
use gdp_core::cbor::Value;
use gdp_core::identity::Identity;
use gdp_proto::control;
use gdp_proto::control::{EntityRequest, RefusalCode};

#[tokio::test]
async fn both_sides_prove_their_names_and_share_keys() {
    let (switch, endpoint) = (identity("switch"), identity("proxy"));
    let (listener, dialler) = (listen(&switch), open(&endpoint));
    let (client, server) = link(&dialler, &listener).await;

    assert_eq!(client.peer().name, switch.name());
    assert_eq!(client.peer().key, switch.key().verify_key());
    assert_eq!(client.peer().role, Role::Switch);
    assert_eq!(server.peer().name, endpoint.name());
    assert_eq!(server.peer().proof, endpoint.proof());
    assert_eq!(server.peer().role, Role::Endpoint);
    assert_eq!(server.addr(), LinkAddr::Udp(dialler.udp_addr().unwrap()));

    let pace = Some(Pace::negotiated(liveness::MIN_INTERVAL));
    assert_eq!((client.negotiated_pace(), server.negotiated_pace()), (pace, pace));

    let (at_client, at_server) = (client.entry(0), server.entry(0));
    assert_eq!((at_client.id, at_client.peer_id), (at_server.peer_id, at_server.id));
    for (from, to, other_way) in [(&at_client, &at_server, &at_client), (&at_server, &at_client, &at_server)] {
        let mut header = Header::data(switch.name(), endpoint.name(), 0);
        hop::stamp(&mut header, from, 1);
        let window = replay::empty();
        assert_eq!(forward::accept(&header, Header::LEN, to, &window), Ok(FrameType::Data));
        assert_eq!(forward::accept(&header, Header::LEN, to, &window), Err(Counter::Replayed));
        assert_ne!(from.tx_keys[0], from.rx_keys[0]);
        header.set_link_id(other_way.id);
        assert_eq!(forward::accept(&header, Header::LEN, other_way, &window), Err(Counter::BadTag), "reflected");
    }
}

#[tokio::test]
async fn every_link_has_keys_and_ids_of_its_own() {
    let (listener, dialler) = (listen(&identity("switch")), open(&identity("proxy")));
    let mut seen = HashSet::new();
    for _ in 0..4 {
        let (client, server) = link(&dialler, &listener).await;
        let entry = server.entry(0);
        for key in [entry.rx_keys, entry.tx_keys].concat() {
            assert!(seen.insert(key));
        }
        assert!(seen.insert([entry.id.into(), 0]), "an id used again at once");
        drop(client);
        server.closed().await;
    }
}

#[tokio::test]
async fn another_peer_than_expected_is_refused() {
    let (switch, other) = (identity("switch"), identity("switch"));
    let (listener, dialler) = (listen(&switch), open(&identity("proxy")));
    let error = dialler.dial(addr_of(&listener), Some(other.name())).await.unwrap_err();
    assert!(
        matches!(error, LinkError::WrongPeer { expected, found } if expected == other.name() && found == switch.name())
    );
}

#[tokio::test]
async fn peers_without_a_p256_key_are_refused() {
    let switch = identity("switch");
    let listener = listen(&switch);
    let address = listener.udp_addr().unwrap();
    for (what, key) in
        [("no key", None), ("Ed25519", Some(&rcgen::PKCS_ED25519)), ("P-384", Some(&rcgen::PKCS_ECDSA_P384_SHA384))]
    {
        let endpoint = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
        let config = foreign_client(key, what != "no key", Versions::SPOKEN.offered());
        let connecting = endpoint.connect_with(config, address, "gdp").unwrap();
        // The client may consider itself connected until the server has verified its key.
        if let Ok(connection) = connecting.await {
            connection.closed().await;
        }
        assert!(accept(&listener).await.is_err(), "{what}");
    }
    // An X.509 certificate with a valid key is not a raw public key.
    let endpoint = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
    let config = foreign_client(Some(&rcgen::PKCS_ECDSA_P256_SHA256), false, Versions::SPOKEN.offered());
    assert!(endpoint.connect_with(config, address, "gdp").unwrap().await.is_err());
    assert!(accept(&listener).await.is_err());

    let dialler = open(&identity("proxy"));
    link(&dialler, &listener).await;
}

/// A release far ahead may not even name the versions that it refuses.
#[tokio::test]
async fn peers_that_offer_no_known_version_are_told_what_is_spoken_here() {
    let listener = listen(&identity("switch"));
    let endpoint = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
    let config = foreign_client(Some(&rcgen::PKCS_ECDSA_P256_SHA256), true, vec![b"gdp/9".to_vec()]);
    let connecting = endpoint.connect_with(config, listener.udp_addr().unwrap(), "gdp").unwrap();
    let told = close_reason(&connecting.await.unwrap_err());
    let refused = accept(&listener).await.unwrap_err().to_string();
    for reason in [told, refused] {
        assert!(reason.contains("no version in common") && reason.contains("gdp/2"), "{reason}");
    }
}

#[tokio::test]
async fn garbage_neither_stops_a_port_nor_reaches_it_as_data() {
    let listener = listen(&identity("switch"));
    let stranger = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut state = 1u64;
    for length in (0..1400usize).step_by(3) {
        let mut datagram: Vec<u8> = (0..length).map(|_| random(&mut state)).collect();
        if let Some(first) = datagram.first_mut() {
            *first |= if length % 2 == 0 { 0x40 } else { 0xc0 };
        }
        stranger.send_to(&datagram, listener.udp_addr().unwrap()).unwrap();
    }
    let dialler = open(&identity("proxy"));
    link(&dialler, &listener).await;
    assert_eq!(listener.data().try_recv_batch(&mut RecvBatch::new(1500)).unwrap(), 0);
}

/// 127.0.0.2 opens connections and sends nothing; 127.0.0.1 gets its link at once.
#[tokio::test]
async fn silent_peers_hold_up_nobody_else() {
    let listener = listen(&identity("switch"));
    let address = listener.udp_addr().unwrap();
    let client = QuicConfigs::new(identity("proxy").key(), Versions::SPOKEN, true).unwrap().client(MTU);
    let endpoint = quinn::Endpoint::client("127.0.0.2:0".parse().unwrap()).unwrap();
    let mut silent = Vec::new();
    for _ in 0..16 {
        silent.push(endpoint.connect_with(client.clone(), address, SERVER_NAME).unwrap().await.unwrap());
    }
    let beyond = endpoint.connect_with(client.clone(), address, SERVER_NAME).unwrap();
    assert!(tokio::time::timeout(Duration::from_millis(300), beyond).await.is_err(), "more than its share");

    let dialler = open(&identity("proxy"));
    link(&dialler, &listener).await;
    assert!(silent.iter().all(|connection| connection.close_reason().is_none()), "it waited for their end");
    let mut timed_out = 0;
    for connection in silent {
        let quinn::ConnectionError::ApplicationClosed(close) = connection.closed().await else { continue };
        assert_eq!(close.error_code, CloseCode::Timeout.into());
        timed_out += 1;
    }
    assert!(timed_out > 0, "all were reset");
    let refused = accept(&listener).await.unwrap_err();
    assert!(matches!(refused, LinkError::Timeout { .. }), "{refused}");
}

#[tokio::test]
async fn hellos_are_bounded_and_checked() {
    let listener = listen(&identity("switch"));
    let client = QuicConfigs::new(identity("proxy").key(), Versions::SPOKEN, true).unwrap().client(MTU);
    let endpoint = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
    let said = |key: &str, value: serde_json::Value| {
        let mut hello = json!({
            "role": "Endpoint", "digest": null, "link_id": 1, "lane": 0, "mtu": 1500, "zero_checksum": false,
            "host": null, "frames_at": null, "run": null, "papers": null,
        });
        hello[key] = value;
        let Ok(Value::Map(mut fields)) = Value::serialized(&hello) else { panic!("a map") };
        let digest = fields.iter_mut().find(|(field, _)| field.as_text() == Some("digest")).unwrap();
        digest.1 = Value::Bytes(vec![0; 32]);
        control::encode(&Value::Map(fields)).unwrap()
    };
    for (hello, expected) in [
        (vec![0xff; 4], "exceeds the limit of 65536"),
        (vec![0, 0, 0xff, 0], "65280 bytes where at most 13312 are expected"),
        (vec![0, 0, 8, 0], "ends too early"),
        (vec![0, 0, 0, 3, 1, 2, 3], "not a control message"),
        (vec![0, 0, 0, 9, 1], "ends too early"),
        (said("link_id", 0.into()), "0 is no link id"),
        (said("lane", 4.into()), "4 is no number of a link"),
        (said("mtu", 511.into()), "an MTU of 511 bytes, not 512 to 65631"),
        (said("role", "Broker".into()), "Broker is of a later release"),
    ] {
        let told = async || {
            let connecting = endpoint.connect_with(client.clone(), listener.udp_addr().unwrap(), SERVER_NAME).unwrap();
            let connection = connecting.await.unwrap();
            let (mut send, _recv) = connection.open_bi().await.unwrap();
            send.write_all(&hello).await.unwrap();
            send.finish().unwrap();
            let told = connection.closed().await;
            accept(&listener).await.unwrap_err();
            told
        };
        let (code, reason) = closed(told).await;
        assert_eq!(code, CloseCode::Malformed, "{reason}");
        assert!(reason.contains(expected), "{reason} does not contain {expected}");
    }
}

#[tokio::test]
async fn requests_go_both_ways_and_beside_each_other() {
    let (listener, dialler) = (listen(&identity("switch")), open(&identity("proxy")));
    let (client, server) = link(&dialler, &listener).await;
    let (echo_client, echo_server) = (client.clone(), server.clone());
    tokio::spawn(async move { answer_all(&echo_client).await });
    tokio::spawn(async move { answer_all(&echo_server).await });
    let asks = (0..100).map(|i| {
        let asker = if i % 2 == 0 { client.clone() } else { server.clone() };
        tokio::spawn(async move { asker.request(&query()).await })
    });
    for ask in asks.collect::<Vec<_>>() {
        assert!(matches!(ask.await.unwrap(), Ok(Response::Done)));
    }
}

#[tokio::test]
async fn bad_requests_are_refused_and_harm_no_others() {
    let (listener, dialler) = (listen(&identity("switch")), open(&identity("proxy")));
    let (client, server) = link(&dialler, &listener).await;
    tokio::spawn(async move { answer_all(&server).await });

    for bytes in [&[0, 1, 0, 1][..], &[0xff; 4], &[0, 0, 0, 2, 0x81, 0x81], &[0, 0, 0, 1, 0]] {
        let (mut send, mut recv) = client.0.connection.open_bi().await.unwrap();
        send.write_all(bytes).await.unwrap();
        let answer = streams::read_message(&mut recv, 65536).await.unwrap();
        let Response::Refused(refusal) = control::decode(&answer).unwrap() else { panic!("accepted") };
        assert_eq!(refusal.code, RefusalCode::Malformed, "{refusal}");
    }
    // Kinds of requests that a later release may add.
    for (later, kind) in [(json!({"Teleport": {"to": 7}}), "Teleport"), (json!({"Entity": {"Fly\n": {}}}), "Fly\\n")] {
        let (mut send, mut recv) = client.0.connection.open_bi().await.unwrap();
        send.write_all(&control::encode(&later).unwrap()).await.unwrap();
        let answer = streams::read_message(&mut recv, 65536).await.unwrap();
        let Response::Refused(refusal) = control::decode(&answer).unwrap() else { panic!("accepted") };
        assert_eq!(refusal.code, RefusalCode::Unsupported, "{refusal}");
        assert!(refusal.reason.starts_with(&format!("{kind} is of a later release")), "{refusal}");
    }
    // Half a request, an empty stream and an abandoned one.
    let mut open = Vec::new();
    for bytes in [&[0, 0, 0, 9, 1, 2][..], &[0], &[]] {
        let (mut send, recv) = client.0.connection.open_bi().await.unwrap();
        send.write_all(bytes).await.unwrap();
        open.push((send, recv));
    }
    open.iter_mut().for_each(|(send, _)| drop(send.reset(VarInt::from_u32(1))));
    assert!(matches!(client.request(&query()).await, Ok(Response::Done)));
}

#[tokio::test]
async fn an_unanswered_request_is_an_error_not_a_wait() {
    let (listener, dialler) = (listen(&identity("switch")), open(&identity("proxy")));
    let (client, server) = link(&dialler, &listener).await;
    let ask = client.clone();
    let ask = tokio::spawn(async move { ask.request(&query()).await });
    drop(server.accept_request().await.unwrap());
    assert!(ask.await.unwrap().is_err());

    let reason = tokio::spawn({
        let client = client.clone();
        async move { client.closed().await }
    });
    server.close("maintenance\u{7}");
    assert_eq!(reason.await.unwrap(), "closed by the peer: maintenance\\u{7}");
    assert!(client.request(&query()).await.is_err());
    assert!(client.accept_request().await.is_none());
}

#[tokio::test]
async fn data_frames_pass_beside_quic() {
    let (listener, dialler) = (listen(&identity("switch")), open(&identity("proxy")));
    let (client, server) = link(&dialler, &listener).await;
    let (out, input) = (client.entry(0), server.entry(0));
    let payload = [7; 100];
    let headers: Vec<Header> = (0..200u32)
        .map(|i| {
            let mut header = Header::data(client.peer().name, server.peer().name, payload.len() as u16);
            hop::stamp(&mut header, &out, i.into());
            header
        })
        .collect();
    let frames = headers.iter().map(|header| OutFrame { to: client.addr(), head: header.as_bytes(), body: &payload });
    assert_eq!(dialler.data().send_batch(frames).sent, 200);

    let socket = listener.data();
    let received = tokio::task::spawn_blocking(move || {
        let window = replay::empty();
        let (mut batch, mut count, deadline) = (RecvBatch::new(1500), 0, Instant::now() + Duration::from_secs(20));
        while count < 200 && Instant::now() < deadline {
            socket.wait_readable(Duration::from_millis(100)).unwrap();
            socket.try_recv_batch(&mut batch).unwrap();
            for InFrame { bytes: frame, .. } in batch.frames() {
                let header = Header::read_from_prefix(frame).expect("a header").0;
                assert_eq!(forward::accept(&header, frame.len(), &input, &window), Ok(FrameType::Data));
                assert_eq!(header.link_counter(), count);
                assert_eq!(frame[Header::LEN..], payload);
                count += 1;
            }
        }
        count
    });
    assert_eq!(received.await.unwrap(), 200);

    let elsewhere = LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] };
    let lost = dialler.data().send_batch([OutFrame { to: elsewhere, head: &[0x20], body: &[] }]);
    assert_eq!((lost.sent, lost.lost, dialler.data().send_drops()), (0, 1, 1));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn keys_are_replaced_on_both_sides_while_frames_cross() {
    let (listener, dialler) = (listen_by(OFTEN), open_by(OFTEN));
    let (client, server) = link(&dialler, &listener).await;
    let ends = [End::new(&client), End::new(&server)];
    let first = (0..2).map(|i| ends[i].frame()).collect::<Vec<_>>();
    let (deadline, mut in_time) = (Instant::now() + Duration::from_secs(60), 0);
    while ends.iter().any(|end| end.link.key_generations().0 < 5 || end.link.key_generations().1 < 5) {
        assert!(Instant::now() < deadline, "{:?} {:?}", client.key_generations(), server.key_generations());
        for (from, to) in [(0, 1), (1, 0)] {
            let made = Instant::now();
            let header = ends[from].frame();
            let taken = ends[to].take(&header);
            // Only if the scheduler has not delayed this thread.
            if made.elapsed() < OFTEN.overlap / 2 {
                assert_eq!(taken, Ok(FrameType::Data), "{:?}", ends[from].link.key_generations());
                in_time += 1;
            }
        }
        tokio::task::yield_now().await;
    }
    assert!(in_time > 10, "{in_time}");
    for (from, to) in [(0, 1), (1, 0)] {
        assert_eq!(ends[to].take(&first[from]), Err(Counter::BadTag), "it was recorded under the first key");
    }
}

/// As with a peer whose daemon died and whose kernel continues to forward with the installed keys.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_peer_that_does_not_answer_keeps_its_keys_and_takes_what_comes() {
    let (listener, dialler) = (listen_by(OFTEN), open_by(OFTEN));
    let (client, server) = link(&dialler, &listener).await;
    let (end, silent) = (End::new(&client), server.entry(0));
    let window = replay::empty();
    let until = Instant::now() + OFTEN.overlap * 4 + Duration::from_secs(2);
    while Instant::now() < until {
        assert_eq!(forward::accept(&end.frame(), Header::LEN, &silent, &window), Ok(FrameType::Data));
        tokio::task::yield_now().await;
    }
    assert_eq!(client.key_generations(), (0, 1), "it has moved once, and asks");
    // A peer that runs `keep_keys` answers, and the client continues.
    let _end = End::new(&server);
    let deadline = Instant::now() + Duration::from_secs(60);
    while client.key_generations().1 < 3 {
        assert!(Instant::now() < deadline);
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

const OFTEN: RekeySchedule =
    RekeySchedule { interval: Duration::from_millis(20), frames: u64::MAX, overlap: Duration::from_millis(100) };

/// One end of a link, with the link table and replay window of a data plane.
struct End {
    link: Link,
    entry: Arc<StdMutex<LinkEntry>>,
    sent: Arc<AtomicU64>,
    window: Box<replay::Window>,
    task: JoinHandle<()>,
}

impl End {
    fn new(link: &Link) -> Self {
        let (entry, sent) = (Arc::new(StdMutex::new(link.entry(0))), Arc::new(AtomicU64::new(0)));
        let (table, counted, kept) = (entry.clone(), sent.clone(), link.clone());
        let task = tokio::spawn(async move {
            let put = |keys: &LinkKeys| {
                keys.put(&mut table.lock());
                true
            };
            kept.keep_keys(|| counted.load(Ordering::Relaxed), put).await;
        });
        Self { link: link.clone(), entry, sent, window: Box::new(replay::empty()), task }
    }

    fn frame(&self) -> Header {
        let mut header = Header::data(Name::from_bytes([1; 32]), Name::from_bytes([2; 32]), 0);
        hop::stamp(&mut header, &self.entry.lock(), self.sent.fetch_add(1, Ordering::Relaxed) + 1);
        header
    }

    fn take(&self, header: &Header) -> Result<FrameType, Counter> {
        forward::accept(header, Header::LEN, &self.entry.lock(), &*self.window)
    }
}

impl Drop for End {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn listen_by(rekey: RekeySchedule) -> Port {
    let config = PortConfig { rekey, ..PortConfig::switch(identity("switch"), LinkIds::new()) };
    Port::udp("127.0.0.1:0".parse().unwrap(), &config).unwrap()
}

fn open_by(rekey: RekeySchedule) -> Port {
    let config = PortConfig { rekey, ..PortConfig::endpoint(identity("proxy")) };
    Port::udp("127.0.0.1:0".parse().unwrap(), &config).unwrap()
}

const MTU: QuicMtu = QuicMtu { initial: 1200, discover_up_to: None };

fn identity(kind: &str) -> Identity {
    Identity::generate(kind).unwrap()
}

fn listen(identity: &Identity) -> Port {
    Port::udp("127.0.0.1:0".parse().unwrap(), &PortConfig::switch(identity.clone(), LinkIds::new())).unwrap()
}

fn open(identity: &Identity) -> Port {
    Port::udp("127.0.0.1:0".parse().unwrap(), &PortConfig::endpoint(identity.clone())).unwrap()
}

fn addr_of(port: &Port) -> LinkAddr {
    LinkAddr::Udp(port.udp_addr().unwrap())
}

/// Makes a link and returns both ends.
async fn link(dialler: &Port, listener: &Port) -> (Link, Link) {
    let (client, server) = tokio::join!(dialler.dial(addr_of(listener), None), accept(listener));
    (client.unwrap(), server.unwrap())
}

async fn accept(listener: &Port) -> Result<Link, LinkError> {
    tokio::time::timeout(Duration::from_secs(10), listener.accept()).await.expect("a handshake in time").unwrap()
}

/// Returns the code and the reason with which the other side closes a connection. On a busy machine
/// QUIC may report a stateless reset instead (see `still_lost` of a node). Then it tries again.
async fn closed(attempt: impl AsyncFn() -> quinn::ConnectionError) -> (CloseCode, String) {
    for _ in 0..10 {
        match attempt().await {
            quinn::ConnectionError::ApplicationClosed(close) => return code_and_reason(&close),
            error => assert_eq!(error, quinn::ConnectionError::Reset),
        }
    }
    panic!("ten resets");
}

fn code_and_reason(close: &quinn::ApplicationClose) -> (CloseCode, String) {
    let codes = [
        CloseCode::Ended,
        CloseCode::Version,
        CloseCode::Malformed,
        CloseCode::WrongPeer,
        CloseCode::Timeout,
        CloseCode::Full,
        CloseCode::NotAdmitted,
        CloseCode::KeyInUse,
    ];
    let code = codes.into_iter().find(|code| VarInt::from(*code) == close.error_code).expect("a known code");
    (code, String::from_utf8(close.reason.to_vec()).unwrap())
}

async fn answer_all(link: &Link) {
    while let Some((_, responder)) = link.accept_request().await {
        responder.respond(Response::Done).await.unwrap();
    }
}

fn query() -> Request {
    Request::Entity(EntityRequest::Query { prefix: "75e".parse().unwrap(), after: None })
}

fn random(state: &mut u64) -> u8 {
    *state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    (*state >> 56) as u8
}

/// Returns the configuration of a foreign client: without a key, or with a raw key or certificate
/// of the given kind.
fn foreign_client(
    key: Option<&'static rcgen::SignatureAlgorithm>,
    raw: bool,
    protocols: Vec<Vec<u8>>,
) -> quinn::ClientConfig {
    use rustls::client::{AlwaysResolvesClientRawPublicKeys, danger::*};
    use rustls::pki_types::*;

    #[derive(Debug)]
    struct AnyServer;
    impl ServerCertVerifier for AnyServer {
        fn verify_server_cert(
            &self,
            _: &CertificateDer<'_>,
            _: &[CertificateDer<'_>],
            _: &ServerName<'_>,
            _: &[u8],
            _: UnixTime,
        ) -> Result<ServerCertVerified, rustls::Error> {
            Ok(ServerCertVerified::assertion())
        }
        fn verify_tls12_signature(
            &self,
            _: &[u8],
            _: &CertificateDer<'_>,
            _: &rustls::DigitallySignedStruct,
        ) -> Result<HandshakeSignatureValid, rustls::Error> {
            Ok(HandshakeSignatureValid::assertion())
        }
        fn verify_tls13_signature(
            &self,
            _: &[u8],
            _: &CertificateDer<'_>,
            _: &rustls::DigitallySignedStruct,
        ) -> Result<HandshakeSignatureValid, rustls::Error> {
            Ok(HandshakeSignatureValid::assertion())
        }
        fn supported_verify_schemes(&self) -> Vec<rustls::SignatureScheme> {
            vec![rustls::SignatureScheme::ECDSA_NISTP256_SHA256]
        }
        fn requires_raw_public_keys(&self) -> bool {
            true
        }
    }

    let provider = std::sync::Arc::new(rustls::crypto::aws_lc_rs::default_provider());
    let builder = rustls::ClientConfig::builder_with_provider(provider.clone())
        .with_protocol_versions(&[&rustls::version::TLS13])
        .unwrap()
        .dangerous()
        .with_custom_certificate_verifier(std::sync::Arc::new(AnyServer));
    let mut tls = match key {
        None => builder.with_no_client_auth(),
        Some(algorithm) => {
            let pair = rcgen::KeyPair::generate_for(algorithm).unwrap();
            let der = PrivateKeyDer::Pkcs8(pair.serialize_der().into());
            if raw {
                let signer = provider.key_provider.load_private_key(der).unwrap();
                let spki = signer.public_key().unwrap().as_ref().to_vec();
                let certified = rustls::sign::CertifiedKey::new(vec![CertificateDer::from(spki)], signer);
                let resolver = AlwaysResolvesClientRawPublicKeys::new(std::sync::Arc::new(certified));
                builder.with_client_cert_resolver(std::sync::Arc::new(resolver))
            } else {
                let cert = rcgen::CertificateParams::new(vec!["gdp".into()]).unwrap().self_signed(&pair).unwrap();
                builder.with_client_auth_cert(vec![cert.der().clone()], der).unwrap()
            }
        }
    };
    tls.alpn_protocols = protocols;
    let crypto = quinn::crypto::rustls::QuicClientConfig::try_from(tls).unwrap();
    let mut config = quinn::ClientConfig::new(std::sync::Arc::new(crypto));
    let mut transport = quinn::TransportConfig::default();
    transport.keep_alive_interval(Some(Duration::from_secs(1)));
    config.transport_config(std::sync::Arc::new(transport));
    config
}

#[allow(dead_code)]
fn links_move_between_threads(link: Link, port: Port, address: SocketAddr) {
    fn shared<T: Send + Sync + 'static>(_: T) {}
    shared((link, port, address));
}

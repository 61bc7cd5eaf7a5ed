//! Unit tests of tunnels from a client to a listener, over loopback.

use std::time::Instant;

use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::*;
use crate::tunnel::Tunnel;

#[tokio::test]
async fn datagrams_cross_both_forms_of_tunnel() {
    for (bound, websocket) in [("127.0.0.1:0", false), ("0.0.0.0:0", true), ("[::1]:0", false), ("[::]:0", true)] {
        let scene = Scene::new(bound).await;
        let (endpoint, tunnel) = scene.dial(websocket).await;
        for datagram in [b"first".to_vec(), vec![7; 8972]] {
            endpoint.send_to(&datagram, tunnel.local_addr()).await.unwrap();
            let (received, from) = receive(&scene.switch).await;
            assert_eq!(received, datagram);
            assert!(from.ip().to_canonical().is_loopback(), "{from}");
            let from = SocketAddr::new(from.ip().to_canonical(), from.port());
            assert_eq!(scene.peers.get(from).unwrap().ip(), Ipv4Addr::LOCALHOST);
            scene.switch.send_to(&datagram, from_of(&scene.switch, from)).await.unwrap();
            assert_eq!(receive(&endpoint).await, (datagram, tunnel.local_addr()));
        }
        let other = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        other.send_to(b"not from the endpoint", tunnel.local_addr()).await.unwrap();
        endpoint.send_to(b"last", tunnel.local_addr()).await.unwrap();
        assert_eq!(receive(&scene.switch).await.0, b"last");
    }
}

#[tokio::test]
async fn a_tunnel_ends_with_its_listener_and_is_forgotten() {
    let scene = Scene::new("127.0.0.1:0").await;
    let (endpoint, tunnel) = scene.dial(false).await;
    endpoint.send_to(b"first", tunnel.local_addr()).await.unwrap();
    let (_, from) = receive(&scene.switch).await;
    scene.task.abort();
    tunnel.ended().await;
    while scene.peers.get(from).is_some() {
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn garbage_and_silence_end_without_harm() {
    let scene = Scene::new("127.0.0.1:0").await;
    let mut silent = TcpStream::connect(scene.tls).await.unwrap();
    let mut garbage = TcpStream::connect(scene.tls).await.unwrap();
    garbage.write_all(&[0x16; 4096]).await.unwrap();
    let began = Instant::now();
    let _ = garbage.read_to_end(&mut Vec::new()).await;
    assert!(began.elapsed() < OPENING, "garbage is refused at once");
    let (endpoint, tunnel) = scene.dial(true).await;
    endpoint.send_to(b"first", tunnel.local_addr()).await.unwrap();
    assert_eq!(receive(&scene.switch).await.0, b"first");
    assert_eq!(silent.read(&mut [0]).await.unwrap(), 0, "silence ends at the time limit");
}

#[tokio::test]
async fn one_address_has_a_bounded_number_of_connections() {
    let scene = Scene::new("127.0.0.1:0").await;
    let mut open = Vec::new();
    for _ in 0..200 {
        open.push(TcpStream::connect(scene.tls).await.unwrap());
    }
    let mut closed = 0;
    for stream in &mut open {
        let ended = timeout(Duration::from_millis(20), stream.read(&mut [0])).await;
        closed += usize::from(ended.is_ok());
    }
    assert_eq!(closed, 200 - MAX_OPENING_OF_ONE);
}

#[tokio::test]
async fn a_host_without_a_listener_is_an_error_that_names_it() {
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let to = nobody.local_addr().unwrap();
    drop(nobody);
    let endpoint = "127.0.0.1:9".parse().unwrap();
    let error = Tunnel::open("127.0.0.1", to.port(), false, endpoint).await.err().unwrap().to_string();
    assert!(error.contains(&format!("no TCP connection to {to}")) && error.contains("`tls:`"), "{error}");
}

/// A listener, and the socket of its switch.
struct Scene {
    switch: UdpSocket,
    tls: SocketAddr,
    peers: TunnelPeers,
    task: tokio::task::JoinHandle<()>,
}

impl Scene {
    async fn new(bound: &str) -> Self {
        let switch = UdpSocket::bind(bound).await.unwrap();
        let (peers, bind) = (TunnelPeers::default(), (Ipv4Addr::LOCALHOST, 0).into());
        let listener = TlsListener::bind(bind).await.unwrap();
        let tls = listener.local_addr().unwrap();
        let task = tokio::spawn(listener.run(switch.local_addr().unwrap(), peers.clone()));
        Self { switch, tls, peers, task }
    }

    async fn dial(&self, websocket: bool) -> (UdpSocket, Tunnel) {
        let endpoint = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let own = endpoint.local_addr().unwrap();
        let tunnel = Tunnel::open("127.0.0.1", self.tls.port(), websocket, own).await.unwrap();
        (endpoint, tunnel)
    }
}

/// Returns the address in the form that the switch's socket takes.
fn from_of(switch: &UdpSocket, from: SocketAddr) -> SocketAddr {
    match (switch.local_addr().unwrap(), from.ip()) {
        (SocketAddr::V6(_), IpAddr::V4(ip)) => SocketAddr::new(ip.to_ipv6_mapped().into(), from.port()),
        _ => from,
    }
}

async fn receive(socket: &UdpSocket) -> (Vec<u8>, SocketAddr) {
    let mut buffer = vec![0; 1 << 16];
    let (length, from) = timeout(Duration::from_secs(5), socket.recv_from(&mut buffer)).await.unwrap().unwrap();
    buffer.truncate(length);
    (buffer, from)
}

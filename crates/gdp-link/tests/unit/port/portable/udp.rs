//! The one socket that systems other than Linux have: data frames and QUIC packets over loopback.

use std::future::poll_fn;
use std::io::{ErrorKind, IoSliceMut};
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::{Duration, Instant};

use quinn::AsyncUdpSocket;
use quinn::udp::RecvMeta;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use super::data::DataSocket;
use super::udp::SharedUdp;
use super::wake::WakeEvent;
use super::{ethernet, wake};
use crate::port::LinkAddr;
use crate::port::batch::{InFrame, OutFrame, RecvBatch, Sent};

const SOON: Duration = Duration::from_secs(60);

/// The first byte of a data frame.
const DATA: u8 = 0x20;
const QUIC: u8 = 0xc0;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_kind_finds_its_reader() {
    for (bind, to) in [("127.0.0.1:0", "127.0.0.1:0"), ("[::1]:0", "[::1]:0")] {
        let (mut receiver, sender) = (End::bind(bind), End::bind(to));
        let frames: Vec<Vec<u8>> = (0..40u8).map(|i| [&[DATA, 0, i][..], &vec![i; 1300]].concat()).collect();
        let out = frames.iter().map(|frame| frame.split_at(20));
        let to = LinkAddr::udp(receiver.addr());
        let sent = sender.data.send_batch(out.map(|(head, body)| OutFrame { to, head, body }));
        assert_eq!(sent, Sent { sent: 40, lost: 0 });
        assert_eq!(receiver.receive(40), frames);

        let plain = UdpSocket::bind(SocketAddr::new(sender.addr().ip(), 0)).unwrap();
        for datagram in [&[QUIC; 1200][..], &[DATA; 90], &[], &[QUIC; 30]] {
            plain.send_to(datagram, receiver.addr()).unwrap();
        }
        assert_eq!(receiver.receive(1), [[DATA; 90]]);
        for length in [1200, 30] {
            assert_eq!(receiver.packets.recv().await.unwrap(), vec![QUIC; length]);
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frame_wakes_the_thread_that_waits_for_any_socket() {
    let (one, other, sender) = (End::bind("127.0.0.1:0"), End::bind("127.0.0.1:0"), End::bind("127.0.0.1:0"));
    let (to, data, own) = (other.addr(), [one.data.clone(), other.data.clone()], Arc::new(WakeEvent::new().unwrap()));
    let event = own.clone();
    let waiting = std::thread::spawn(move || {
        let (began, mut batch) = (Instant::now(), RecvBatch::new(1500));
        while data[1].try_recv_batch(&mut batch).unwrap() == 0 {
            assert!(began.elapsed() < SOON);
            DataSocket::wait_any(data.iter().map(|data| &**data), &event, SOON).unwrap();
        }
        // The thread's own event, set before it waits.
        event.set();
        DataSocket::wait_any(data.iter().map(|data| &**data), &event, 2 * SOON).unwrap();
        began.elapsed() < SOON
    });
    let frame = OutFrame { to: LinkAddr::udp(to), head: &[DATA, 0], body: &[] };
    assert_eq!(sender.data.send_batch([frame]).sent, 1);
    assert!(tokio::task::spawn_blocking(move || waiting.join().unwrap()).await.unwrap());
    own.set();
}

#[test]
fn an_event_that_was_set_before_ends_one_wait_only() {
    let event = WakeEvent::new().unwrap();
    event.set();
    let began = Instant::now();
    wake::wait_any([&event].into_iter(), SOON);
    assert!(began.elapsed() < SOON);
    let began = Instant::now();
    while began.elapsed() < Duration::from_millis(5) {
        wake::wait_any([&event].into_iter(), Duration::from_millis(5));
    }
}

#[tokio::test]
async fn frames_that_nobody_takes_are_bounded_and_counted() {
    let mut receiver = End::bind("127.0.0.1:0");
    let plain = UdpSocket::bind("127.0.0.1:0").unwrap();
    // Longer than any link's.
    plain.send_to(&[DATA; 20_000], receiver.addr()).unwrap();
    plain.send_to(&[DATA; 10], receiver.addr()).unwrap();
    plain.send_to(&[QUIC; 10], receiver.addr()).unwrap();
    assert_eq!(receiver.packets.recv().await.unwrap(), [QUIC; 10]);
    assert_eq!(receiver.data.receive_drops(), 1);
    assert_eq!(receiver.receive(1), [[DATA; 10]]);

    let elsewhere = LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] };
    let sent = receiver.data.send_batch([OutFrame { to: elsewhere, head: &[DATA, 0], body: &[] }]);
    assert_eq!((sent, receiver.data.send_drops()), (Sent { sent: 0, lost: 1 }, 1));
}

#[tokio::test]
async fn what_needs_linux_fails_with_the_remedy() {
    let bound = SharedUdp::bind("127.0.0.1:0".parse().unwrap(), Some("eth0")).err();
    for error in [bound, ethernet::index_of("eth0").err(), ethernet::find("eth0").err()] {
        let error = error.expect("refused");
        assert_eq!(error.kind(), ErrorKind::Unsupported);
        let text = error.to_string();
        assert!(text.contains("needs Linux") && text.contains("udp://"), "{text}");
    }
}

/// A socket whose packets a task takes, as that of quinn does.
struct End {
    udp: Arc<SharedUdp>,
    data: Arc<DataSocket>,
    packets: mpsc::UnboundedReceiver<Vec<u8>>,
    task: JoinHandle<()>,
}

impl End {
    fn bind(addr: &str) -> Self {
        let udp = Arc::new(SharedUdp::bind(addr.parse().unwrap(), None).unwrap());
        let (sender, packets) = mpsc::unbounded_channel();
        let socket = udp.clone();
        let task = tokio::spawn(async move {
            let mut buf = vec![0; 1 << 16];
            loop {
                let mut meta = [RecvMeta::default()];
                let received =
                    poll_fn(|cx| socket.poll_recv(cx, &mut [IoSliceMut::new(&mut buf)], &mut meta)).await.unwrap();
                assert_eq!(received, 1);
                buf[..meta[0].len].chunks(meta[0].stride.max(1)).for_each(|packet| {
                    let _ = sender.send(packet.to_vec());
                });
            }
        });
        Self { data: Arc::new(DataSocket::udp(udp.clone())), udp, packets, task }
    }

    fn addr(&self) -> SocketAddr {
        self.udp.local_addr().unwrap()
    }

    fn receive(&self, count: usize) -> Vec<Vec<u8>> {
        let (mut batch, mut received, deadline) = (RecvBatch::new(1500), Vec::new(), Instant::now() + SOON);
        while received.len() < count {
            assert!(Instant::now() < deadline, "{} of {count} frames", received.len());
            self.data.wait_readable(Duration::from_millis(100)).unwrap();
            self.data.try_recv_batch(&mut batch).unwrap();
            received.extend(batch.frames().map(|InFrame { bytes, .. }| bytes.to_vec()));
        }
        received
    }
}

impl Drop for End {
    fn drop(&mut self) {
        self.task.abort();
    }
}

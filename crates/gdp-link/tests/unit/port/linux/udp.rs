//! Data frames and QUIC packets over real UDP sockets on loopback, with honest and hostile senders.
//!
//! No root. `tests/tests/networks/udp.rs` has paths with a smaller MTU than their interface.

use std::future::poll_fn;
use std::io::IoSliceMut;
use std::mem::zeroed;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, AsRawFd};
use std::sync::Arc;
use std::time::{Duration, Instant};

use quinn::AsyncUdpSocket;
use quinn::udp::{EcnCodepoint, RecvMeta};

use super::control::Control;
use super::data::DataSocket;
use super::sys::{self, RawAddr};
use super::udp::SharedUdp;
use crate::port::LinkAddr;
use crate::port::batch::{BATCH, InFrame, OutFrame, RecvBatch, Sent, UDP_MTU};

const SOON: Duration = Duration::from_secs(60);

/// The first byte of a data frame.
const DATA: u8 = 0x20;
const QUIC: u8 = 0xc0;

#[tokio::test]
async fn frames_in_a_row_of_one_length_go_as_one_piece_and_all_arrive_in_order() {
    for (from, to) in [("127.0.0.1:0", "127.0.0.1:0"), ("[::1]:0", "[::1]:0"), ("[::]:0", "127.0.0.1:0")] {
        let (sender, plain) = (End::bind(from), Plain::bind(to));
        let frames = frames(&[[1400, 1400, 1400, 300].as_slice(), &[1400, 200, 200, 700, 700, 700], &[64; 3]].concat());
        assert_eq!(sender.send(&frames, plain.addr()), Sent { sent: frames.len(), lost: 0 });
        let mut whole = Vec::new();
        for pieces in [4, 2, 1, 4, 2] {
            let (bytes, segment) = plain.receive();
            let begin = whole.len();
            whole.extend(bytes);
            assert_eq!((whole.len() - begin).div_ceil(segment), pieces, "{from} to {to}: the kernel was given a run");
        }
        assert_eq!(whole, frames.concat());
    }
}

#[tokio::test]
async fn runs_end_at_another_destination_or_class_and_where_no_datagram_is_longer() {
    let (sender, one, other) = (End::bind("127.0.0.1:0"), Plain::bind("127.0.0.1:0"), Plain::bind("127.0.0.1:0"));
    let frame = frames(&[500]).remove(0);
    let urgent = [&[DATA, 5 << 2][..], &frame[2..]].concat();
    let out = |frame, to: &Plain| OutFrame { to: LinkAddr::udp(to.addr()), head: frame, body: &[] };
    let order = [(&frame, &one), (&frame, &one), (&frame, &other), (&frame, &one), (&urgent, &one), (&urgent, &one)];
    assert_eq!(sender.data.send_batch(order.map(|(frame, to)| out(frame, to))).sent, 6);
    assert_eq!([one.receive().0.len(), one.receive().0.len(), one.receive().0.len()], [1000, 500, 1000]);
    assert_eq!(other.receive().0.len(), 500);

    let large = frames(&[1400; BATCH]);
    assert_eq!(sender.send(&large, one.addr()).sent, BATCH);
    assert_eq!([one.receive().0.len(), one.receive().0.len()], [46 * 1400, 18 * 1400]);
    let huge = frames(&[40_000; 2]);
    assert_eq!(sender.send(&huge, one.addr()).sent, 2, "each fits, both do not");
    assert_eq!([one.receive().0.len(), one.receive().0.len()], [40_000, 40_000]);
}

#[tokio::test]
async fn what_arrives_as_one_piece_is_split_into_the_frames_that_were_sent() {
    for bind in ["127.0.0.1:0", "[::1]:0"] {
        let (sender, receiver) = (End::bind(bind), End::bind(bind));
        // Several calls send and receive, and no length aligns the next frame.
        let lengths: Vec<usize> = (0..1000).map(|i| if i % 50 < 45 { 1397 } else { 96 + i }).collect();
        for some in lengths.chunks(200) {
            let frames = frames(some);
            assert_eq!(sender.send(&frames, receiver.addr()).sent, frames.len());
            assert_eq!(receiver.receive(frames.len()), frames);
        }
        assert_eq!((receiver.data.receive_drops(), sender.data.send_drops()), (0, 0));
    }
}

/// The kernel refuses a longer run, and quinn would take it for sent.
#[tokio::test]
async fn a_run_of_the_largest_packets_fits_one_datagram() {
    let end = End::bind("127.0.0.1:0");
    let segments = end.udp.max_transmit_segments();
    assert!(segments > 1 && segments * UDP_MTU as usize <= 65_507, "{segments}");
}

#[tokio::test]
async fn whatever_lengths_a_sender_makes_up_others_are_not_harmed() {
    let (receiver, hostile, honest) = (End::bind("127.0.0.1:0"), Plain::bind("127.0.0.1:0"), End::bind("127.0.0.1:0"));
    let junk = vec![DATA; 65_000];
    hostile.send(&junk[..64], Some(1), 0, receiver.addr());
    hostile.send(&junk[..63 * 95 + 1], Some(95), 0, receiver.addr());
    hostile.send(&junk, Some(65_000 / 2), 0, receiver.addr());
    hostile.send(&junk, None, 0, receiver.addr());
    hostile.send(&[], None, 0, receiver.addr());
    // A QUIC byte, but longer than any peer's datagram: dropped.
    hostile.send(&[&[QUIC; 9500][..], &junk[..9500]].concat(), Some(9500), 0, receiver.addr());
    let frames = frames(&[1400; 3]);
    honest.send(&frames, receiver.addr());
    let mut all = receiver.receive(64 + 64 + 2 + 1 + 3);
    assert_eq!(all.split_off(all.len() - 3), frames);
    let count = |length| all.iter().filter(|frame| frame.len() == length).count();
    assert_eq!([count(1), count(95), count(32_500), count(65_000)], [65, 63, 2, 1]);
    assert_eq!(receiver.receive_packets(1).await.len(), 1);
    assert_eq!(
        (receiver.data.try_recv_batch(&mut RecvBatch::new(1500)).unwrap(), receiver.data.receive_drops()),
        (0, 1)
    );
}

#[tokio::test]
async fn where_the_kernel_refuses_runs_frames_go_one_by_one() {
    let (sender, plain) = (End::bind("127.0.0.1:0"), Plain::bind("127.0.0.1:0"));
    // Without checksums the kernel does not segment.
    sys::set_option(sender.udp.data_fd(), libc::SOL_SOCKET, libc::SO_NO_CHECK, &1i32).unwrap();
    let frames = frames(&[300; 10]);
    for _ in 0..2 {
        assert_eq!(sender.send(&frames, plain.addr()), Sent { sent: 10, lost: 0 });
        frames.iter().for_each(|frame| assert_eq!(plain.receive(), (frame.clone(), 300)));
    }
    // After the path accepts runs again, the sender soon tries them again.
    sys::set_option(sender.udp.data_fd(), libc::SOL_SOCKET, libc::SO_NO_CHECK, &0i32).unwrap();
    let mut calls = 0;
    while {
        calls += 1;
        sender.send(&frames, plain.addr());
        let (first, _) = plain.receive();
        plain.drain();
        first.len() == 300
    } {
        assert!(calls < 2000);
    }
}

#[tokio::test]
async fn a_frame_that_no_path_takes_is_lost_alone() {
    let (sender, plain) = (End::bind("127.0.0.1:0"), Plain::bind("127.0.0.1:0"));
    let frames = frames(&[1000, 1000, 65_530, 1000, 1000]);
    assert_eq!(sender.send(&frames, plain.addr()), Sent { sent: 4, lost: 1 });
    assert_eq!([plain.receive().0.len(), plain.receive().0.len()], [2000, 2000]);
}

#[tokio::test]
async fn each_kind_finds_its_reader_also_where_the_kernel_joined_them() {
    for (bind, to) in [("127.0.0.1:0", "127.0.0.1:0"), ("[::]:0", "127.0.0.1:0"), ("[::]:0", "[::1]:0")] {
        let (receiver, peer) = (End::bind(bind), Plain::bind(to));
        let to = SocketAddr::new(peer.addr().ip(), receiver.addr().port());
        let packet = |length: usize| [&[QUIC][..], &vec![7; length - 1]].concat();
        let frames = frames(&[1200, 1200, 90]);

        peer.send(&[&frames[0][..], &frames[1], &packet(60)].concat(), Some(1200), 0, to);
        assert_eq!(receiver.receive(2), frames[..2]);
        assert_eq!(receiver.receive_packets(1).await, [(peer.addr(), packet(60))]);

        peer.send(&[&packet(1200)[..], &frames[0], &packet(1200), &frames[2]].concat(), Some(1200), 0, to);
        let packets = receiver.receive_packets(2).await;
        assert_eq!(packets, [(peer.addr(), packet(1200)), (peer.addr(), packet(1200))]);
        assert_eq!(receiver.receive(2), [frames[0].clone(), frames[2].clone()]);
    }
}

#[tokio::test]
async fn a_packet_that_the_data_thread_finds_wakes_the_task_that_waits_for_it() {
    let (receiver, peer) = (Arc::new(End::bind("127.0.0.1:0")), Plain::bind("127.0.0.1:0"));
    let waiting = tokio::spawn({
        let receiver = receiver.clone();
        async move { receiver.receive_packets(1).await }
    });
    // The task waits before the packet arrives.
    tokio::task::yield_now().await;
    peer.send(&[&[DATA; 100][..], &[QUIC; 50]].concat(), Some(100), 0, receiver.addr());
    assert_eq!(receiver.receive(1), [[DATA; 100]]);
    let packets = tokio::time::timeout(SOON, waiting).await.expect("woken").unwrap();
    assert_eq!(packets, [(peer.addr(), vec![QUIC; 50])]);
}

#[tokio::test]
async fn class_and_ecn_are_in_the_ip_header_and_marks_are_seen() {
    for (from, to) in [("127.0.0.1:0", "127.0.0.1:0"), ("[::1]:0", "[::1]:0"), ("[::]:0", "127.0.0.1:0")] {
        let (end, peer) = (End::bind(from), Plain::bind(to));
        let mut frames = frames(&[200; 2]);
        frames.iter_mut().for_each(|frame| frame[1] = 0x80 | 6 << 2 | 2);
        assert_eq!(end.send(&frames, peer.addr()).sent, 2);
        assert_eq!(peer.receive_traffic(), (400, 6 << 5 | 2), "{from} to {to}");

        let to = SocketAddr::new(peer.addr().ip(), end.addr().port());
        for (traffic, marked) in [(0, false), (6 << 5 | 2, false), (3, true), (0xff, true), (1, false)] {
            peer.send(&frames.concat(), Some(200), traffic, to);
            let mut batch = RecvBatch::new(1500);
            assert!(end.data.wait_readable(SOON).unwrap());
            assert_eq!(end.data.try_recv_batch(&mut batch).unwrap(), 2);
            let seen: Vec<bool> = batch.frames().map(|frame| frame.congested).collect();
            assert_eq!(seen, [marked; 2], "{traffic}, {from}");
        }
    }
}

#[tokio::test]
async fn frames_of_another_class_or_with_a_mark_are_no_part_of_a_run() {
    for at in ["127.0.0.1:0", "[::1]:0"] {
        let (end, peer) = (End::bind(at), Plain::bind(at));
        let mut frames = frames(&[200; 8]);
        // Two frames each: first another class, then a mark. The key phase does not affect IP's
        // traffic class.
        for (frame, flags) in frames.iter_mut().zip([0b10, 0x82, 0b110, 0b110, 0b111, 0b111, 0, 0]) {
            frame[1] = flags;
        }
        assert_eq!(end.send(&frames, peer.addr()).sent, 8);
        let received = [(); 4].map(|()| peer.receive_traffic());
        assert_eq!(received, [(400, 0b10), (400, 0b10_0010), (400, 0b10_0011), (400, 0)], "{at}");
    }
}

#[tokio::test]
async fn a_mark_stays_with_what_came_to_the_other_socket() {
    for at in ["127.0.0.1:0", "[::1]:0"] {
        let (end, peer) = (End::bind(at), Plain::bind(at));
        for (traffic, ecn) in [(3, Some(EcnCodepoint::Ce)), (2, Some(EcnCodepoint::Ect0)), (0, None)] {
            peer.send(&[[QUIC; 100], [DATA; 100]].concat(), Some(100), traffic, end.addr());
            assert_eq!(end.receive_packets(1).await.len(), 1);
            let mut batch = RecvBatch::new(1500);
            assert!(end.data.wait_readable(SOON).unwrap());
            assert_eq!(end.data.try_recv_batch(&mut batch).unwrap(), 1);
            assert_eq!(batch.frames().next().map(|frame| frame.congested), Some(traffic == 3), "{at}");

            peer.send(&[[DATA; 100], [QUIC; 100]].concat(), Some(100), traffic, end.addr());
            assert_eq!(end.receive(1).len(), 1);
            let (mut buf, mut meta) = ([0; 200], [RecvMeta::default()]);
            let received = poll_fn(|cx| end.udp.poll_recv(cx, &mut [IoSliceMut::new(&mut buf)], &mut meta)).await;
            assert_eq!((received.unwrap(), meta[0].len, meta[0].ecn), (1, 100, ecn), "{at}");
        }
    }
}

#[tokio::test]
async fn an_address_is_held_by_one_port() {
    let first = SharedUdp::bind("127.0.0.1:0".parse().unwrap(), None).unwrap();
    let taken = SharedUdp::bind(first.local_addr().unwrap(), None);
    assert_eq!(taken.err().map(|error| error.kind()), Some(std::io::ErrorKind::AddrInUse));
    let address = first.local_addr().unwrap();
    drop(first);
    SharedUdp::bind(address, None).unwrap();
}

/// Returns frames of these lengths, all different.
fn frames(lengths: &[usize]) -> Vec<Vec<u8>> {
    let frame = |(number, length): (usize, &usize)| {
        let mut frame = vec![number as u8; *length];
        frame[..2].copy_from_slice(&[DATA, 0]);
        frame[2..6].copy_from_slice(&(number as u32).to_be_bytes());
        frame
    };
    lengths.iter().enumerate().map(frame).collect()
}

/// The sockets of a port, under test.
struct End {
    udp: Arc<SharedUdp>,
    data: DataSocket,
}

impl End {
    fn bind(addr: &str) -> Self {
        let udp = Arc::new(SharedUdp::bind(addr.parse().unwrap(), None).unwrap());
        Self { data: DataSocket::udp(udp.clone()), udp }
    }

    fn addr(&self) -> SocketAddr {
        self.udp.local_addr().unwrap()
    }

    /// Sends each frame in two pieces, as publishers do.
    fn send(&self, frames: &[Vec<u8>], to: SocketAddr) -> Sent {
        let out = |frame: &'_ Vec<u8>| {
            let (head, body) = frame.split_at(frame.len().min(20));
            (head.to_vec(), body.to_vec())
        };
        let pieces: Vec<_> = frames.iter().map(out).collect();
        let frames = pieces.iter().map(|(head, body)| OutFrame { to: LinkAddr::udp(to), head, body });
        self.data.send_batch(frames)
    }

    fn receive(&self, count: usize) -> Vec<Vec<u8>> {
        let (mut batch, mut received, deadline) = (RecvBatch::new(1500), Vec::new(), Instant::now() + SOON);
        while received.len() < count {
            assert!(Instant::now() < deadline, "{} of {count} frames", received.len());
            self.data.wait_readable(Duration::from_millis(100)).unwrap();
            let there = self.data.try_recv_batch(&mut batch).unwrap();
            let before = received.len();
            received.extend(batch.frames().map(|InFrame { bytes, .. }| bytes.to_vec()));
            assert_eq!(received.len() - before, there);
            (0..there).for_each(|i| assert_eq!(batch.frame(i), received[before + i]));
        }
        received
    }

    async fn receive_packets(&self, count: usize) -> Vec<(SocketAddr, Vec<u8>)> {
        let (mut storage, mut packets) = (vec![vec![0; 1 << 16]; 4], Vec::new());
        while packets.len() < count {
            let mut meta = [RecvMeta::default(); 4];
            let mut bufs: Vec<IoSliceMut> = storage.iter_mut().map(|buf| IoSliceMut::new(buf)).collect();
            let received = poll_fn(|cx| self.udp.poll_recv(cx, &mut bufs, &mut meta)).await.unwrap();
            for (meta, buf) in meta.iter().zip(&storage).take(received) {
                let from = SocketAddr::new(meta.addr.ip().to_canonical(), meta.addr.port());
                packets.extend(buf[..meta.len].chunks(meta.stride.max(1)).map(|packet| (from, packet.to_vec())));
            }
        }
        packets
    }
}

/// A socket that sends and receives as the test specifies.
struct Plain(UdpSocket);

impl Plain {
    fn bind(addr: &str) -> Self {
        let socket = UdpSocket::bind(addr).unwrap();
        socket.set_read_timeout(Some(SOON)).unwrap();
        sys::set_buffers(&socket, 4 << 20, 4 << 20);
        for (level, option) in [
            (libc::SOL_UDP, libc::UDP_GRO),
            (libc::IPPROTO_IP, libc::IP_RECVTOS),
            (libc::IPPROTO_IPV6, libc::IPV6_RECVTCLASS),
        ] {
            let set = sys::set_option(socket.as_fd(), level, option, &1i32);
            assert!(set.is_ok() || level == libc::IPPROTO_IPV6);
        }
        Self(socket)
    }

    fn addr(&self) -> SocketAddr {
        self.0.local_addr().unwrap()
    }

    /// Sends a datagram that the kernel cuts into segments.
    fn send(&self, bytes: &[u8], segment: Option<u16>, traffic: u8, to: SocketAddr) {
        let mut control = Control::new();
        if let Some(segment) = segment {
            control.push(libc::SOL_UDP, libc::UDP_SEGMENT, &segment.to_ne_bytes());
        }
        let (level, kind) = match to {
            SocketAddr::V4(_) => (libc::IPPROTO_IP, libc::IP_TOS),
            SocketAddr::V6(_) => (libc::IPPROTO_IPV6, libc::IPV6_TCLASS),
        };
        control.push(level, kind, &libc::c_int::from(traffic).to_ne_bytes());
        let (mut addr, length) = RawAddr::socket(to, to.is_ipv6());
        let mut iovec = libc::iovec { iov_base: bytes.as_ptr().cast_mut().cast(), iov_len: bytes.len() };
        // SAFETY: plain integers and pointers.
        let mut header: libc::msghdr = unsafe { zeroed() };
        header.msg_name = (&raw mut addr).cast();
        header.msg_namelen = length;
        header.msg_iov = &raw mut iovec;
        header.msg_iovlen = 1;
        control.attach(&mut header);
        // SAFETY: all memory that the header points to outlives the call, and the kernel only reads
        // it.
        let sent = unsafe { libc::sendmsg(self.0.as_raw_fd(), &header, 0) };
        assert_eq!(sent, bytes.len() as isize, "{}", std::io::Error::last_os_error());
    }

    /// Returns a datagram as the kernel delivers it, and the length of its segments.
    fn receive(&self) -> (Vec<u8>, usize) {
        let (bytes, segment, _) = self.receive_all();
        (bytes, segment)
    }

    /// Returns the length, and the traffic class and ECN bits of the IP header.
    fn receive_traffic(&self) -> (usize, libc::c_int) {
        let (bytes, _, traffic) = self.receive_all();
        (bytes.len(), traffic)
    }

    fn receive_all(&self) -> (Vec<u8>, usize, libc::c_int) {
        let (mut bytes, mut control) = (vec![0; 1 << 16], Control::new());
        let mut iovec = libc::iovec { iov_base: bytes.as_mut_ptr().cast(), iov_len: bytes.len() };
        // SAFETY: plain integers and pointers.
        let mut header: libc::msghdr = unsafe { zeroed() };
        header.msg_iov = &raw mut iovec;
        header.msg_iovlen = 1;
        control.make_room(&mut header);
        // SAFETY: all memory that the header points to outlives the call.
        let length = unsafe { libc::recvmsg(self.0.as_raw_fd(), &mut header, 0) };
        assert!(length >= 0, "{}", std::io::Error::last_os_error());
        bytes.truncate(length as usize);
        let (mut segment, mut traffic) = (bytes.len(), 0);
        control.each(&header, |level, kind, value| match (level, kind) {
            (libc::SOL_UDP, libc::UDP_GRO) => segment = value as usize,
            _ => traffic = value,
        });
        (bytes, segment, traffic)
    }

    fn drain(&self) {
        self.0.set_nonblocking(true).unwrap();
        while self.0.recv(&mut [0; 1]).is_ok() {}
        self.0.set_nonblocking(false).unwrap();
    }
}

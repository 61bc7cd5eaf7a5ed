//! UDP for QUIC and data frames, with two sockets at one address.
//!
//! Each kind of datagram thus has its own reader. The kernel selects the socket by the first byte
//! of a datagram. Quinn polls one socket, the data thread reads the other. The kernel may join
//! datagrams of both kinds into one run (UDP GRO). The reader of such a run hands the misdelivered
//! datagrams over to the other reader.

use std::fmt;
use std::io::{self, IoSliceMut};
use std::mem::{size_of, zeroed};
use std::net::{SocketAddr, UdpSocket as StdUdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use gdp_wire::header::FIRST_QUIC_BYTE;
use quinn::udp::{EcnCodepoint, RecvMeta, Transmit, UdpSocketState};
use quinn::{AsyncUdpSocket, UdpPoller};
use tokio::io::Interest;
use tokio::net::UdpSocket;

use super::control::Control;
use super::host_id;
use super::misdelivered::Packets;
use super::route_mtu::RouteMtu;
use super::sys::{self, RawAddr, step};
use super::wake::WakeEvent;
use crate::port::LinkAddr;
use crate::port::batch::{RecvBatch, UDP_MTU};
use crate::port::frame_queue::{FrameQueue, segments};

/// Socket buffers. A burst of a 1 MB message in frames of 1500 B occupies about 2 MB of the
/// kernel's memory.
const DATA_BUFFER: usize = 16 << 20;
const QUIC_BUFFER: usize = 4 << 20;

/// Number of data runs per receive call, of up to [`LONGEST_RUN`] bytes each.
const RUNS: usize = 16;

/// Maximum number of data frames from the QUIC socket that wait for the data thread.
const MOST_STRAYS: usize = 1024;

/// Maximum length of a run that the kernel joins, in bytes.
const LONGEST_RUN: usize = 1 << 16;

pub struct SharedUdp {
    quic: UdpSocket,
    state: UdpSocketState,
    data: StdUdpSocket,
    v6: bool,
    zero_checksums: bool,
    host: Option<u64>,
    route_mtu: RouteMtu,
    stray_packets: Packets,
    stray_frames: FrameQueue,
    /// Set when data frames are queued.
    wake: Arc<WakeEvent>,
}

impl SharedUdp {
    /// Binds both sockets, and binds them to an interface if one is given. Call within a tokio
    /// runtime.
    pub fn bind(addr: SocketAddr, interface: Option<&str>) -> io::Result<Self> {
        let (quic, data) = bind_both(addr, interface)?;
        // `UdpSocketState` enables GRO, as `prepare_data` does for data. When the kernel joins
        // datagrams, it checks the setting of either socket.
        let state = UdpSocketState::new((&quic).into())?;
        sys::set_buffers(&quic, QUIC_BUFFER, QUIC_BUFFER);
        sys::set_buffers(&data, DATA_BUFFER, QUIC_BUFFER);
        let bound = quic.local_addr()?;
        let v6 = bound.is_ipv6();
        prepare_data(data.as_fd(), v6)?;
        let takes_all =
            interface.is_none() && bound.ip().is_unspecified() && (!v6 || host_id::takes_ipv4(quic.as_fd()));
        // Data frames need no UDP checksum: the hop tag covers what switches forward by, decryption
        // the rest. QUIC verifies its packets.
        let no_check = |fd| sys::set_option(fd, libc::SOL_UDP, libc::UDP_NO_CHECK6_RX, &1i32).is_ok();
        Ok(Self {
            v6,
            zero_checksums: v6 && no_check(quic.as_fd()) && no_check(data.as_fd()),
            host: if takes_all { host_id::id(quic.as_fd()) } else { None },
            route_mtu: RouteMtu::open(bound, interface)?,
            quic: UdpSocket::from_std(quic)?,
            state,
            data,
            stray_packets: Packets::default(),
            stray_frames: FrameQueue::new(MOST_STRAYS),
            wake: Arc::new(WakeEvent::new()?),
        })
    }

    pub fn is_v6(&self) -> bool {
        self.v6
    }

    /// Returns whether the sockets accept datagrams over IPv6 without a UDP checksum.
    pub fn takes_zero_checksums(&self) -> bool {
        self.zero_checksums
    }

    /// Returns the [host id](host_id::id), if the sockets accept datagrams at all IPv4 addresses of
    /// the host.
    pub fn host(&self) -> Option<u64> {
        self.host
    }

    /// Returns the upper bound for the discovery of the path MTU to a peer, in bytes.
    pub fn mtu_upper_bound(&self, to: SocketAddr) -> u16 {
        self.route_mtu.upper_bound(to)
    }

    /// Returns the socket for data frames.
    pub fn data_fd(&self) -> BorrowedFd<'_> {
        self.data.as_fd()
    }

    /// Returns the event that is set when data frames from the QUIC socket are queued.
    pub fn data_wake(&self) -> Arc<WakeEvent> {
        self.wake.clone()
    }

    pub fn has_stray_data(&self) -> bool {
        !self.stray_frames.is_empty()
    }

    pub fn stray_drops(&self) -> u64 {
        self.stray_frames.dropped()
    }

    /// Receives the available data frames, at most [`RUNS`] runs.
    pub fn receive_data(&self, batch: &mut RecvBatch) -> io::Result<()> {
        if self.has_stray_data() {
            self.stray_frames.take(batch);
            return Ok(());
        }
        let mut addrs = [RawAddr::zeroed(); RUNS];
        let mut controls = [Control::new(); RUNS];
        // SAFETY: both are plain structures of integers and pointers, for which zero is a valid
        // value.
        let (mut iovecs, mut messages): ([libc::iovec; RUNS], [libc::mmsghdr; RUNS]) = unsafe { (zeroed(), zeroed()) };
        for (i, slot) in batch.slots(RUNS, LONGEST_RUN).enumerate() {
            iovecs[i] = libc::iovec { iov_base: slot.as_mut_ptr().cast(), iov_len: slot.len() };
            let header = &mut messages[i].msg_hdr;
            header.msg_name = (&raw mut addrs[i]).cast();
            header.msg_namelen = size_of::<RawAddr>() as u32;
            header.msg_iov = &raw mut iovecs[i];
            header.msg_iovlen = 1;
            controls[i].make_room(header);
        }
        // SAFETY: every header points to a buffer, an address and a control message buffer, with
        // their true lengths. All of them outlive the call.
        let count = unsafe { sys::receive(self.data_fd(), &mut messages) }?;
        for (i, message) in messages[..count].iter().enumerate() {
            let Some(from) = addrs[i].socket_addr() else { continue };
            let length = (message.msg_len as usize).min(LONGEST_RUN);
            let (mut segment, mut traffic) = (length, 0);
            controls[i].each(&message.msg_hdr, |level, kind, value| match (level, kind) {
                (libc::SOL_UDP, libc::UDP_GRO) => segment = value as usize,
                (libc::IPPROTO_IP, libc::IP_TOS) | (libc::IPPROTO_IPV6, libc::IPV6_TCLASS) => traffic = value,
                _ => {}
            });
            self.split(batch, i, from, (length, segment), traffic);
        }
        Ok(())
    }

    fn split(
        &self,
        batch: &mut RecvBatch,
        slot: usize,
        from: SocketAddr,
        (length, segment): (usize, usize),
        traffic: libc::c_int,
    ) {
        for (at, length) in segments(length, segment) {
            let datagram = &batch.slot(slot, LONGEST_RUN)[at..at + length];
            if datagram[0] < FIRST_QUIC_BYTE {
                batch.add(slot * LONGEST_RUN + at, length, LinkAddr::udp(from), traffic & ECN == CE);
            } else {
                self.stray_packets.put(from, EcnCodepoint::from_bits(traffic as u8), datagram);
            }
        }
    }
}

/// The ECN bits of the IP traffic class, and the mark that a congested router sets (RFC 3168).
const ECN: libc::c_int = 3;
const CE: libc::c_int = 3;

/// Binds two sockets to one address. No other process can share it: the first socket is bound
/// without sharing. The first socket of another process would therefore fail to bind.
fn bind_both(addr: SocketAddr, interface: Option<&str>) -> io::Result<(StdUdpSocket, StdUdpSocket)> {
    const LOAD_BYTE: u32 = libc::BPF_LD | libc::BPF_B | libc::BPF_ABS;
    const JUMP_AT_LEAST: u32 = libc::BPF_JMP | libc::BPF_JGE | libc::BPF_K;
    const RETURN: u32 = libc::BPF_RET | libc::BPF_K;
    let quic = StdUdpSocket::bind(addr)?;
    quic.set_nonblocking(true)?;
    sys::set_option(quic.as_fd(), libc::SOL_SOCKET, libc::SO_REUSEPORT, &1i32)?;
    if let Some(interface) = interface {
        sys::bind_to_interface(quic.as_fd(), interface)?;
    }
    let data = sys::bind_shared_udp(quic.local_addr()?, interface)?;
    // The program selects a socket by the order of binding. A datagram without a first byte goes to
    // the first socket.
    let mut program = [
        step(LOAD_BYTE, 0, 0, 0),
        step(JUMP_AT_LEAST, 0, 1, FIRST_QUIC_BYTE.into()),
        step(RETURN, 0, 0, 0),
        step(RETURN, 0, 0, 1),
    ];
    sys::attach_program(quic.as_fd(), libc::SO_ATTACH_REUSEPORT_CBPF, &mut program)?;
    Ok((quic, data))
}

/// Configures the data socket. Sent datagrams are never fragmented, independent of the kernel's
/// path MTU. Received datagrams may be joined, and carry their ECN bits.
fn prepare_data(data: BorrowedFd, v6: bool) -> io::Result<()> {
    let set = |level, option, value: libc::c_int| sys::set_option(data, level, option, &value);
    // An IPv6 socket also needs these options for IPv4.
    set(libc::IPPROTO_IP, libc::IP_MTU_DISCOVER, libc::IP_PMTUDISC_PROBE)?;
    set(libc::IPPROTO_IP, libc::IP_RECVTOS, 1)?;
    if v6 {
        set(libc::IPPROTO_IPV6, libc::IPV6_MTU_DISCOVER, libc::IPV6_PMTUDISC_PROBE)?;
        set(libc::IPPROTO_IPV6, libc::IPV6_DONTFRAG, 1)?;
        set(libc::IPPROTO_IPV6, libc::IPV6_RECVTCLASS, 1)?;
    }
    set(libc::SOL_UDP, libc::UDP_GRO, 1)
}

impl AsyncUdpSocket for SharedUdp {
    fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
        Box::pin(Poller(self))
    }

    fn try_send(&self, transmit: &Transmit) -> io::Result<()> {
        self.quic.try_io(Interest::WRITABLE, || self.state.send((&self.quic).into(), transmit))
    }

    fn poll_recv(
        &self,
        cx: &mut Context,
        bufs: &mut [IoSliceMut<'_>],
        meta: &mut [RecvMeta],
    ) -> Poll<io::Result<usize>> {
        let strays = self.stray_packets.take(cx, bufs, meta);
        if strays > 0 {
            return Poll::Ready(Ok(strays));
        }
        loop {
            ready!(self.quic.poll_recv_ready(cx))?;
            let received = self.quic.try_io(Interest::READABLE, || self.state.recv((&self.quic).into(), bufs, meta));
            let received = match received {
                Ok(received) => received,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
                // An ICMP error that a peer provoked must not end the endpoint.
                Err(_) => 0,
            };
            if self.stray_frames.take_from(&mut bufs[..received], &mut meta[..received]) {
                self.wake.set();
            }
            if received > 0 {
                return Poll::Ready(Ok(received));
            }
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.quic.local_addr()
    }

    fn max_transmit_segments(&self) -> usize {
        self.state.max_gso_segments().min(LONGEST_RUN / UDP_MTU as usize)
    }

    /// Returns how many of the largest datagrams are a run. A run of smaller ones is not longer.
    fn max_receive_segments(&self) -> usize {
        LONGEST_RUN.div_ceil(UDP_MTU as usize)
    }

    fn may_fragment(&self) -> bool {
        self.state.may_fragment()
    }
}

impl fmt::Debug for SharedUdp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("SharedUdp").field(&self.quic.local_addr()).finish()
    }
}

#[derive(Debug)]
struct Poller(Arc<SharedUdp>);

impl UdpPoller for Poller {
    fn poll_writable(self: Pin<&mut Self>, cx: &mut Context) -> Poll<io::Result<()>> {
        self.0.quic.poll_send_ready(cx)
    }
}

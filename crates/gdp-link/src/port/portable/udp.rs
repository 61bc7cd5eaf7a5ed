//! UDP for QUIC and data frames, with one socket.
//!
//! The task of quinn reads it, and queues the data frames for the data thread.

use std::fmt;
use std::io::{self, IoSliceMut};
use std::net::{SocketAddr, UdpSocket as StdUdpSocket};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::thread::sleep;
use std::time::Duration;

use quinn::udp::{EcnCodepoint, RecvMeta, Transmit, UdpSocketState};
use quinn::{AsyncUdpSocket, UdpPoller};
use tokio::io::Interest;
use tokio::net::UdpSocket;

use super::ethernet::index_of;
use super::set_buffers;
use super::wake::WakeEvent;
use crate::port::batch::ETHERNET_PAYLOAD;
use crate::port::frame_queue::FrameQueue;

/// Socket buffers. A burst of a 1 MB message in frames of 1500 B occupies about 2 MB of memory.
const RECEIVE_BUFFER: usize = 16 << 20;
const SEND_BUFFER: usize = 4 << 20;

/// Maximum number of data frames that wait for the data thread. A message of 10 MB fits.
const MOST_FRAMES: usize = 8192;

/// Number of attempts to send a frame where there is no buffer space, and the time between them.
const ATTEMPTS: usize = 5;
const BETWEEN_ATTEMPTS: Duration = Duration::from_millis(1);

pub struct SharedUdp {
    socket: UdpSocket,
    state: UdpSocketState,
    v6: bool,
    frames: FrameQueue,
    /// Set when data frames are queued.
    wake: WakeEvent,
}

impl SharedUdp {
    /// Binds the socket. Fails if an interface is given. Call within a tokio runtime.
    pub fn bind(addr: SocketAddr, interface: Option<&str>) -> io::Result<Self> {
        interface.map(index_of).transpose()?;
        let socket = StdUdpSocket::bind(addr)?;
        socket.set_nonblocking(true)?;
        let state = UdpSocketState::new((&socket).into())?;
        set_buffers(&socket, RECEIVE_BUFFER, SEND_BUFFER);
        let (v6, socket) = (socket.local_addr()?.is_ipv6(), UdpSocket::from_std(socket)?);
        Ok(Self { socket, state, v6, frames: FrameQueue::new(MOST_FRAMES), wake: WakeEvent::new()? })
    }

    /// Returns whether the socket accepts datagrams over IPv6 without a UDP checksum.
    pub fn takes_zero_checksums(&self) -> bool {
        false
    }

    /// Returns nothing: a switch on this host has no direct path to this port.
    pub fn host(&self) -> Option<u64> {
        None
    }

    /// Returns the upper bound for the discovery of the path MTU to a peer, in bytes. The route is
    /// not asked for.
    pub fn mtu_upper_bound(&self, _: SocketAddr) -> u16 {
        ETHERNET_PAYLOAD as u16
    }

    /// Returns the received data frames.
    pub fn frames(&self) -> &FrameQueue {
        &self.frames
    }

    /// Returns the event that is set when data frames are queued.
    pub fn wake(&self) -> &WakeEvent {
        &self.wake
    }

    /// Sends a data frame. Of the traffic class, only the ECN bits are sent.
    pub fn send_data(&self, to: SocketAddr, traffic: u8, contents: &[u8]) -> io::Result<()> {
        let destination = match to {
            SocketAddr::V4(v4) if self.v6 => SocketAddr::new(v4.ip().to_ipv6_mapped().into(), v4.port()),
            to => to,
        };
        let ecn = EcnCodepoint::from_bits(traffic);
        let transmit = Transmit { destination, ecn, contents, segment_size: None, src_ip: None };
        let send = || self.state.try_send((&self.socket).into(), &transmit);
        for _ in 1..ATTEMPTS {
            match self.socket.try_io(Interest::WRITABLE, send) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => sleep(BETWEEN_ATTEMPTS),
                result => return result,
            }
        }
        self.socket.try_io(Interest::WRITABLE, send)
    }
}

impl AsyncUdpSocket for SharedUdp {
    fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
        Box::pin(Poller(self))
    }

    fn try_send(&self, transmit: &Transmit) -> io::Result<()> {
        self.socket.try_io(Interest::WRITABLE, || self.state.send((&self.socket).into(), transmit))
    }

    fn poll_recv(
        &self,
        cx: &mut Context,
        bufs: &mut [IoSliceMut<'_>],
        meta: &mut [RecvMeta],
    ) -> Poll<io::Result<usize>> {
        loop {
            ready!(self.socket.poll_recv_ready(cx))?;
            let receive = || self.state.recv((&self.socket).into(), bufs, meta);
            match self.socket.try_io(Interest::READABLE, receive) {
                Ok(0) => {}
                Ok(received) => {
                    if self.frames.take_from(&mut bufs[..received], &mut meta[..received]) {
                        self.wake.set();
                    }
                    return Poll::Ready(Ok(received));
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
                // An ICMP error that a peer provoked must not end the endpoint.
                Err(_) => {}
            }
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    fn max_transmit_segments(&self) -> usize {
        self.state.max_gso_segments()
    }

    fn max_receive_segments(&self) -> usize {
        self.state.gro_segments()
    }

    fn may_fragment(&self) -> bool {
        self.state.may_fragment()
    }
}

impl fmt::Debug for SharedUdp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("SharedUdp").field(&self.socket.local_addr()).finish()
    }
}

#[derive(Debug)]
struct Poller(Arc<SharedUdp>);

impl UdpPoller for Poller {
    fn poll_writable(self: Pin<&mut Self>, cx: &mut Context) -> Poll<io::Result<()>> {
        self.0.socket.poll_send_ready(cx)
    }
}

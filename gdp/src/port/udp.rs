//! One UDP socket for QUIC and data frames, told apart by the first byte of the datagram. quinn polls it; the data frames
//! it finds wait in a bounded queue for the thread that takes them.

use std::collections::VecDeque;
use std::fmt;
use std::io::{self, IoSliceMut};
use std::net::SocketAddr;
use std::os::fd::{AsFd, BorrowedFd};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll, ready};

use gdp_wire::header::FIRST_QUIC_BYTE;
use quinn::udp::{RecvMeta, Transmit, UdpSocketState};
use quinn::{AsyncUdpSocket, UdpPoller};
use tokio::io::Interest;
use tokio::net::UdpSocket;

use super::LinkAddr;
use super::data::RecvBatch;
use super::host;
use super::sys::{self, Event};

/// Data frames that wait to be taken; more are dropped and counted.
const QUEUE: usize = 4096;

const BUFFER: usize = 4 << 20;

pub struct SharedUdp {
    socket: UdpSocket,
    state: UdpSocketState,
    v6: bool,
    zero_checksums: bool,
    host: Option<u64>,
    queue: Mutex<VecDeque<(SocketAddr, Vec<u8>)>>,
    /// Set while the queue is not empty.
    event: Event,
    dropped: AtomicU64,
}

impl SharedUdp {
    /// Binds within a tokio runtime.
    pub fn bind(addr: SocketAddr) -> io::Result<Self> {
        let socket = std::net::UdpSocket::bind(addr)?;
        socket.set_nonblocking(true)?;
        let state = UdpSocketState::new((&socket).into())?;
        // Receive offload would glue datagrams of both kinds together.
        let _ = sys::set_option(socket.as_fd(), libc::SOL_UDP, libc::UDP_GRO, &0i32);
        sys::set_buffers(socket.as_fd(), BUFFER, BUFFER);
        let bound = socket.local_addr()?;
        let v6 = bound.is_ipv6();
        let takes_all = bound.ip().is_unspecified() && (!v6 || host::takes_ipv4(socket.as_fd()));
        // Data frames are checked without it: the hop tag covers the header, decryption the payload. QUIC checks its packets.
        let zero_checksums =
            v6 && sys::set_option(socket.as_fd(), libc::SOL_UDP, libc::UDP_NO_CHECK6_RX, &1i32).is_ok();
        Ok(Self {
            v6,
            zero_checksums,
            host: if takes_all { host::id(socket.as_fd()) } else { None },
            socket: UdpSocket::from_std(socket)?,
            state,
            queue: Mutex::new(VecDeque::with_capacity(64)),
            event: Event::new()?,
            dropped: AtomicU64::new(0),
        })
    }

    pub fn is_v6(&self) -> bool {
        self.v6
    }

    /// Whether datagrams over IPv6 are taken without a UDP checksum.
    pub fn takes_zero_checksums(&self) -> bool {
        self.zero_checksums
    }

    /// The [host](host::id), if datagrams are taken at all its IPv4 addresses.
    pub fn host(&self) -> Option<u64> {
        self.host
    }

    pub fn socket_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }

    pub fn data_event(&self) -> BorrowedFd<'_> {
        self.event.fd()
    }

    pub fn queue_drops(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Moves waiting data frames into `batch`.
    pub fn take_data(&self, batch: &mut RecvBatch) {
        let mut queue = self.lock_queue();
        while let Some((from, frame)) = queue.front() {
            if !batch.push(frame, LinkAddr::udp(*from)) {
                return;
            }
            queue.pop_front();
        }
        self.event.clear();
    }

    fn queue_data(&self, from: SocketAddr, frame: &[u8]) {
        let mut queue = self.lock_queue();
        if queue.len() >= QUEUE {
            self.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        queue.push_back((from, frame.to_vec()));
        if queue.len() == 1 {
            self.event.set();
        }
    }

    fn lock_queue(&self) -> MutexGuard<'_, VecDeque<(SocketAddr, Vec<u8>)>> {
        self.queue.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
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
            let received =
                self.socket.try_io(Interest::READABLE, || self.state.recv((&self.socket).into(), bufs, meta));
            let received = match received {
                Ok(received) => received,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
                // An ICMP error that some peer provoked must not end the endpoint.
                Err(_) => 0,
            };
            let mut kept = 0;
            for i in 0..received {
                let length = meta[i].len;
                match bufs[i].first() {
                    Some(first) if length > 0 && *first < FIRST_QUIC_BYTE => {
                        self.queue_data(meta[i].addr, &bufs[i][..length]);
                    }
                    Some(_) if length > 0 => {
                        if kept != i {
                            let (front, back) = bufs.split_at_mut(i);
                            front[kept][..length].copy_from_slice(&back[0][..length]);
                            meta[kept] = meta[i];
                        }
                        kept += 1;
                    }
                    _ => {}
                }
            }
            if kept > 0 {
                return Poll::Ready(Ok(kept));
            }
            // Data only: come back for more, but let the runtime's other tasks have their turn.
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

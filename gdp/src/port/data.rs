//! Data frames in and out of a port, in batches; on Ethernet without an allocation per frame. Called from the userspace plane
//! of a switch and from an endpoint's receiving thread; what a frame means is not known here.

use std::io;
use std::mem::{size_of, zeroed};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use gdp_wire::Header;
use zerocopy::IntoBytes;

use super::LinkAddr;
use super::sys::{self, Event, RawAddr};
use super::udp::SharedUdp;

/// Most frames one system call receives or sends. Also what a veth ring of 256 takes without loss.
pub const BATCH: usize = 64;

/// How long sending waits for room in the socket's buffer before it gives frames up.
const SEND_PATIENCE: Duration = Duration::from_millis(5);

/// Room for the frames one receive call takes, and what that call found.
pub struct RecvBatch {
    /// In words, so that each frame begins at an address its header can be read from.
    storage: Vec<u64>,
    stride: usize,
    lengths: [usize; BATCH],
    from: [LinkAddr; BATCH],
    count: usize,
}

impl RecvBatch {
    /// For frames of up to `largest` bytes; a larger one arrives cut, and shows as truncated.
    pub fn new(largest: usize) -> Self {
        let stride = largest.next_multiple_of(64).max(Header::LEN);
        Self {
            storage: vec![0; stride / 8 * BATCH],
            stride,
            lengths: [0; BATCH],
            from: [LinkAddr::Ethernet { ifindex: 0, mac: [0; 6] }; BATCH],
            count: 0,
        }
    }

    /// The frames of the last receive call, each beginning at a multiple of 8, and who sent them.
    pub fn frames(&mut self) -> impl Iterator<Item = (&mut [u8], LinkAddr)> {
        let (lengths, from) = (&self.lengths, &self.from);
        self.storage
            .as_mut_bytes()
            .chunks_exact_mut(self.stride)
            .zip(lengths.iter().zip(from))
            .take(self.count)
            .map(|(frame, (length, from))| (&mut frame[..*length], *from))
    }

    /// Frame `index` of the last receive call, once more: to send what was rewritten in place.
    pub fn frame(&self, index: usize) -> &[u8] {
        assert!(index < self.count, "frame {index} of {}", self.count);
        &self.storage.as_bytes()[index * self.stride..][..self.lengths[index]]
    }

    /// The largest frame there is room for.
    pub fn largest(&self) -> usize {
        self.stride
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Takes a copy of a frame that came another way; `false` when the batch is full.
    pub(crate) fn push(&mut self, frame: &[u8], from: LinkAddr) -> bool {
        if self.count == BATCH {
            return false;
        }
        let length = frame.len().min(self.stride);
        self.storage.as_mut_bytes()[self.count * self.stride..][..length].copy_from_slice(&frame[..length]);
        self.lengths[self.count] = length;
        self.from[self.count] = from;
        self.count += 1;
        true
    }
}

/// A frame to send, in two pieces that need not lie together.
#[derive(Clone, Copy)]
pub struct OutFrame<'a> {
    pub to: LinkAddr,
    pub head: &'a [u8],
    /// May be empty.
    pub body: &'a [u8],
}

/// What became of frames that were to be sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sent {
    /// Handed to the kernel.
    pub sent: usize,
    /// Given up: no room in time, an interface that is down, an address of another kind of port.
    pub lost: usize,
}

/// Where data frames of a port arrive and leave. Shared by threads; receiving is meant for one of them.
pub struct DataSocket {
    kind: Kind,
    wake: Event,
    lost: AtomicU64,
}

pub(super) enum Kind {
    Ethernet { fd: OwnedFd, ifindex: u32, ethertype: u16 },
    Udp(Arc<SharedUdp>),
}

impl DataSocket {
    pub(super) fn new(kind: Kind) -> io::Result<Self> {
        Ok(Self { kind, wake: Event::new()?, lost: AtomicU64::new(0) })
    }

    /// Receives what is there, up to [`BATCH`] frames, replacing what the batch held; 0 if there is nothing.
    pub fn try_recv_batch(&self, batch: &mut RecvBatch) -> io::Result<usize> {
        batch.count = 0;
        match &self.kind {
            Kind::Ethernet { fd, ifindex, .. } => recv_ethernet(fd.as_fd(), *ifindex, batch)?,
            Kind::Udp(socket) => socket.take_data(batch),
        }
        Ok(batch.count)
    }

    /// Blocks until there is something to receive (`true`), [`Self::wake`] is called, or `timeout` is over.
    pub fn wait_readable(&self, timeout: Duration) -> io::Result<bool> {
        sys::wait(self.as_fd(), libc::POLLIN, Some(&self.wake), timeout)
    }

    /// Ends the present or the next [`Self::wait_readable`], so that its thread looks at something else.
    pub fn wake(&self) {
        self.wake.set();
    }

    /// Sends frames in their order, [`BATCH`] to a system call. Blocks for a few milliseconds at most when the kernel has
    /// no room, then gives up the rest of that call's frames.
    pub fn send_batch<'a>(&self, frames: impl IntoIterator<Item = OutFrame<'a>>) -> Sent {
        let mut total = Sent::default();
        let mut frames = frames.into_iter();
        loop {
            let mut chunk = Chunk::new();
            let mut foreign = 0;
            for frame in frames.by_ref() {
                match self.raw_addr(frame.to) {
                    Some((addr, length)) => chunk.push(frame, addr, length),
                    None => foreign += 1,
                }
                if chunk.count == BATCH {
                    break;
                }
            }
            if chunk.count == 0 && foreign == 0 {
                break;
            }
            let sent = chunk.send(self.socket_fd());
            total.sent += sent;
            total.lost += chunk.count - sent + foreign;
        }
        self.lost.fetch_add(total.lost as u64, Ordering::Relaxed);
        total
    }

    /// Frames that arrived and were dropped because nobody took them in time.
    pub fn receive_drops(&self) -> u64 {
        let queued = match &self.kind {
            Kind::Ethernet { .. } => 0,
            Kind::Udp(socket) => socket.queue_drops(),
        };
        sys::receive_drops(self.socket_fd()) + queued
    }

    /// Frames that could not be sent.
    pub fn send_drops(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    fn raw_addr(&self, to: LinkAddr) -> Option<(RawAddr, u32)> {
        match (&self.kind, to) {
            (Kind::Ethernet { ifindex, ethertype, .. }, LinkAddr::Ethernet { ifindex: to_ifindex, mac })
                if *ifindex == to_ifindex =>
            {
                Some((RawAddr::station(*ifindex, mac, *ethertype), size_of::<libc::sockaddr_ll>() as u32))
            }
            (Kind::Udp(socket), LinkAddr::Udp(addr)) => Some(RawAddr::socket(addr, socket.is_v6())),
            _ => None,
        }
    }

    fn socket_fd(&self) -> BorrowedFd<'_> {
        match &self.kind {
            Kind::Ethernet { fd, .. } => fd.as_fd(),
            Kind::Udp(socket) => socket.socket_fd(),
        }
    }
}

/// The descriptor to wait on for data frames; of a UDP port it is not the socket itself.
impl AsFd for DataSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match &self.kind {
            Kind::Ethernet { fd, .. } => fd.as_fd(),
            Kind::Udp(socket) => socket.data_event(),
        }
    }
}

fn recv_ethernet(fd: BorrowedFd, ifindex: u32, batch: &mut RecvBatch) -> io::Result<()> {
    let mut addrs = [RawAddr::zeroed(); BATCH];
    // SAFETY: both are plain structures of integers and pointers, for which zero is a valid value.
    let (mut iovecs, mut messages): ([libc::iovec; BATCH], [libc::mmsghdr; BATCH]) = unsafe { (zeroed(), zeroed()) };
    for (i, frame) in batch.storage.as_mut_bytes().chunks_exact_mut(batch.stride).enumerate() {
        iovecs[i] = libc::iovec { iov_base: frame.as_mut_ptr().cast(), iov_len: frame.len() };
        let header = &mut messages[i].msg_hdr;
        header.msg_name = (&raw mut addrs[i]).cast();
        header.msg_namelen = size_of::<RawAddr>() as u32;
        header.msg_iov = &raw mut iovecs[i];
        header.msg_iovlen = 1;
    }
    let count = loop {
        // SAFETY: every header points to a buffer and an address that outlive the call, with their true lengths.
        let result = sys::check(unsafe {
            libc::recvmmsg(
                fd.as_raw_fd(),
                messages.as_mut_ptr(),
                BATCH as u32,
                libc::MSG_DONTWAIT as _,
                std::ptr::null_mut(),
            )
        });
        match result {
            Ok(count) => break count as usize,
            Err(error) => match error.raw_os_error() {
                Some(libc::EINTR) => continue,
                // ENETDOWN is told once after the interface went down; it may come up again.
                Some(libc::EAGAIN | libc::ENETDOWN) => return Ok(()),
                _ => return Err(error),
            },
        }
    };
    for i in 0..count {
        batch.lengths[i] = messages[i].msg_len as usize;
        batch.from[i] = LinkAddr::Ethernet { ifindex, mac: addrs[i].mac() };
    }
    batch.count = count;
    Ok(())
}

/// The arguments of one `sendmmsg` call.
struct Chunk<'a> {
    addrs: [(RawAddr, u32); BATCH],
    iovecs: [[libc::iovec; 2]; BATCH],
    count: usize,
    frames: std::marker::PhantomData<&'a [u8]>,
}

impl<'a> Chunk<'a> {
    fn new() -> Self {
        let empty = libc::iovec { iov_base: std::ptr::null_mut(), iov_len: 0 };
        Self {
            addrs: [(RawAddr::zeroed(), 0); BATCH],
            iovecs: [[empty; 2]; BATCH],
            count: 0,
            frames: std::marker::PhantomData,
        }
    }

    fn push(&mut self, frame: OutFrame<'a>, addr: RawAddr, length: u32) {
        self.addrs[self.count] = (addr, length);
        self.iovecs[self.count] = [frame.head, frame.body]
            .map(|piece| libc::iovec { iov_base: piece.as_ptr().cast_mut().cast(), iov_len: piece.len() });
        self.count += 1;
    }

    /// Returns how many the kernel took.
    fn send(&mut self, fd: BorrowedFd) -> usize {
        // SAFETY: plain structures of integers and pointers, for which zero is a valid value.
        let mut messages: [libc::mmsghdr; BATCH] = unsafe { zeroed() };
        for (i, message) in messages[..self.count].iter_mut().enumerate() {
            message.msg_hdr.msg_name = (&raw mut self.addrs[i].0).cast();
            message.msg_hdr.msg_namelen = self.addrs[i].1;
            message.msg_hdr.msg_iov = self.iovecs[i].as_mut_ptr();
            message.msg_hdr.msg_iovlen = 2;
        }
        let (mut next, mut sent, mut waited, mut told) = (0, 0, false, false);
        while next < self.count {
            let rest = &mut messages[next..self.count];
            // SAFETY: the headers point to addresses and pieces of frames that live as long as `self` and `'a`; the
            // kernel only reads through them.
            let result = sys::check(unsafe {
                libc::sendmmsg(fd.as_raw_fd(), rest.as_mut_ptr(), rest.len() as u32, libc::MSG_DONTWAIT as _)
            });
            match result {
                Ok(count) => {
                    next += count as usize;
                    sent += count as usize;
                }
                Err(error) => match error.raw_os_error() {
                    Some(libc::EINTR) => {}
                    Some(libc::EAGAIN | libc::ENOBUFS) if !waited => {
                        waited = true;
                        let _ = sys::wait(fd, libc::POLLOUT, None, SEND_PATIENCE);
                    }
                    // May be about the past: a socket tells once that its interface was down.
                    Some(libc::ENETDOWN) if !told => told = true,
                    Some(libc::EAGAIN | libc::ENOBUFS | libc::ENETDOWN | libc::ENXIO) => break,
                    // Something about this one frame: its size, its destination.
                    _ => next += 1,
                },
            }
        }
        sent
    }
}

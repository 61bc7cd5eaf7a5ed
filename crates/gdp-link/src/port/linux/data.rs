//! Sends and receives a port's data frames in batches, without an allocation per frame.
//!
//! The userspace data plane of a switch and the receiving thread of an endpoint use it. This module
//! does not interpret frames.

use std::io;
use std::mem::size_of;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::ethernet;
use super::send::{Chunk, Offload};
use super::sys::{self, RawAddr};
use super::udp::SharedUdp;
use super::wake::{self, WakeEvent};
use crate::port::LinkAddr;
use crate::port::batch::{OutFrame, RecvBatch, Sent};
use crate::port::interface::Interface;

/// The socket for a port's data frames. Threads share it; only one of them should receive.
pub struct DataSocket {
    kind: Medium,
    wake: Arc<WakeEvent>,
    offload: Offload,
    lost: AtomicU64,
}

enum Medium {
    Ethernet { fd: OwnedFd, ifindex: u32, ethertype: u16 },
    Udp(Arc<SharedUdp>),
}

impl DataSocket {
    /// Opens the socket for data frames of an interface.
    pub(in crate::port) fn ethernet(interface: &Interface, ethertype: u16) -> io::Result<Self> {
        let fd = ethernet::open_data(interface, ethertype)?;
        let kind = Medium::Ethernet { fd, ifindex: interface.index, ethertype };
        Ok(Self { kind, wake: Arc::new(WakeEvent::new()?), offload: Offload::never(), lost: AtomicU64::new(0) })
    }

    /// Returns the data socket of a UDP port.
    pub(in crate::port) fn udp(socket: Arc<SharedUdp>) -> Self {
        let wake = socket.data_wake();
        Self { kind: Medium::Udp(socket), wake, offload: Offload::default(), lost: AtomicU64::new(0) }
    }

    /// Receives the available frames, up to a bounded number, and replaces the contents of the
    /// batch. Returns 0 if there are none.
    pub fn try_recv_batch(&self, batch: &mut RecvBatch) -> io::Result<usize> {
        batch.clear();
        match &self.kind {
            Medium::Ethernet { fd, ifindex, .. } => ethernet::receive(fd.as_fd(), *ifindex, batch)?,
            Medium::Udp(socket) => socket.receive_data(batch)?,
        }
        Ok(batch.len())
    }

    /// Blocks until frames are available (`true`), until [`Self::wake`] is called, or until
    /// `timeout` expires.
    pub fn wait_readable(&self, timeout: Duration) -> io::Result<bool> {
        Ok(self.has_misdelivered()
            || wake::wait(self.as_fd(), libc::POLLIN, Some(&self.wake), timeout)?
            || self.has_misdelivered())
    }

    /// Blocks until one of the sockets has frames, until `wake` is set, or until `timeout` expires.
    /// At most [`wake::MOST_AT_ONCE`] sockets are waited for.
    pub fn wait_any<'a>(
        sockets: impl Iterator<Item = &'a Self> + Clone,
        wake: &WakeEvent,
        timeout: Duration,
    ) -> io::Result<()> {
        if sockets.clone().any(Self::has_misdelivered) {
            return Ok(());
        }
        wake::wait_any(sockets.map(|socket| (socket.as_fd(), &*socket.wake)), wake, timeout)
    }

    /// Ends the current or the next [`Self::wait_readable`], to let its thread do other work.
    pub fn wake(&self) {
        self.wake.set();
    }

    /// Sends frames in order, with up to [`crate::port::BATCH`] frames per system call.
    ///
    /// Over UDP, consecutive frames with the same destination, traffic class and length leave as
    /// one datagram (GSO). If the kernel has no buffer space, it blocks for a few milliseconds at
    /// most. It then gives up the remaining frames of that call.
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
                if chunk.is_full() {
                    break;
                }
            }
            if chunk.len() == 0 && foreign == 0 {
                break;
            }
            let sent = chunk.send(self.as_fd(), &self.offload);
            total.sent += sent;
            total.lost += chunk.len() - sent + foreign;
        }
        self.lost.fetch_add(total.lost as u64, Ordering::Relaxed);
        total
    }

    /// Returns the bytes of kernel memory for frames that the interface has not sent yet.
    pub fn send_queue(&self) -> usize {
        sys::send_queue(self.as_fd())
    }

    /// Returns the number of frames dropped because this process did not receive them in time.
    pub fn receive_drops(&self) -> u64 {
        let strays = match &self.kind {
            Medium::Ethernet { .. } => 0,
            Medium::Udp(socket) => socket.stray_drops(),
        };
        sys::receive_drops(self.as_fd()) + strays
    }

    /// Returns the number of frames that could not be sent.
    pub fn send_drops(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    fn has_misdelivered(&self) -> bool {
        matches!(&self.kind, Medium::Udp(socket) if socket.has_stray_data())
    }

    fn raw_addr(&self, to: LinkAddr) -> Option<(RawAddr, u32)> {
        match (&self.kind, to) {
            (Medium::Ethernet { ifindex, ethertype, .. }, LinkAddr::Ethernet { ifindex: to_ifindex, mac })
                if *ifindex == to_ifindex =>
            {
                Some((RawAddr::station(*ifindex, mac, *ethertype), size_of::<libc::sockaddr_ll>() as u32))
            }
            (Medium::Udp(socket), LinkAddr::Udp(addr)) => Some(RawAddr::socket(addr, socket.is_v6())),
            _ => None,
        }
    }

    fn as_fd(&self) -> BorrowedFd<'_> {
        match &self.kind {
            Medium::Ethernet { fd, .. } => fd.as_fd(),
            Medium::Udp(socket) => socket.data_fd(),
        }
    }
}

//! Sends and receives a port's data frames: one datagram a call.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::ethernet::no_ethernet;
use super::udp::SharedUdp;
use super::wake::{self, WakeEvent};
use crate::port::LinkAddr;
use crate::port::batch::{OutFrame, RecvBatch, Sent, UDP_MTU, traffic};
use crate::port::interface::Interface;

/// The socket for a port's data frames. Threads share it; only one of them should receive.
pub struct DataSocket {
    socket: Arc<SharedUdp>,
    lost: AtomicU64,
}

impl DataSocket {
    /// Fails: there are no links over raw Ethernet here.
    pub(in crate::port) fn ethernet(_: &Interface, _: u16) -> io::Result<Self> {
        Err(no_ethernet())
    }

    /// Returns the data socket of a UDP port.
    pub(in crate::port) fn udp(socket: Arc<SharedUdp>) -> Self {
        Self { socket, lost: AtomicU64::new(0) }
    }

    /// Receives the available frames, up to a bounded number, and replaces the contents of the
    /// batch. Returns 0 if there are none.
    pub fn try_recv_batch(&self, batch: &mut RecvBatch) -> io::Result<usize> {
        batch.clear();
        self.socket.frames().take(batch);
        Ok(batch.len())
    }

    /// Blocks until frames are available (`true`), until [`Self::wake`] is called, or until
    /// `timeout` expires.
    pub fn wait_readable(&self, timeout: Duration) -> io::Result<bool> {
        if self.socket.frames().is_empty() {
            wake::wait_any([self.socket.wake()].into_iter(), timeout);
        }
        Ok(!self.socket.frames().is_empty())
    }

    /// Blocks until one of the sockets has frames, until `wake` is set, or until `timeout` expires.
    pub fn wait_any<'a>(
        sockets: impl Iterator<Item = &'a Self> + Clone,
        wake: &WakeEvent,
        timeout: Duration,
    ) -> io::Result<()> {
        if sockets.clone().all(|socket| socket.socket.frames().is_empty()) {
            wake::wait_any(sockets.map(|socket| socket.socket.wake()).chain([wake]), timeout);
        }
        Ok(())
    }

    /// Ends the current or the next [`Self::wait_readable`], to let its thread do other work.
    pub fn wake(&self) {
        self.socket.wake().set();
    }

    /// Sends frames in order. Waits for a few milliseconds at most where the system has no buffer
    /// space, and gives up the frame then.
    pub fn send_batch<'a>(&self, frames: impl IntoIterator<Item = OutFrame<'a>>) -> Sent {
        let (mut total, mut datagram) = (Sent::default(), Vec::with_capacity(UDP_MTU as usize));
        for frame in frames {
            datagram.clear();
            datagram.extend_from_slice(frame.head);
            datagram.extend_from_slice(frame.body);
            let sent = match frame.to {
                LinkAddr::Udp(to) => self.socket.send_data(to, traffic(frame), &datagram).is_ok(),
                LinkAddr::Ethernet { .. } => false,
            };
            total.sent += usize::from(sent);
            total.lost += usize::from(!sent);
        }
        self.lost.fetch_add(total.lost as u64, Ordering::Relaxed);
        total
    }

    /// Returns the number of frames dropped because this process did not take them in time. What
    /// the system drops is not known here.
    pub fn receive_drops(&self) -> u64 {
        self.socket.frames().dropped()
    }

    /// Returns the number of frames that could not be sent.
    pub fn send_drops(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

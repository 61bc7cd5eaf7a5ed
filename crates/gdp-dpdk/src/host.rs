//! Moves packets between ports and the host's interfaces. One thread passes arrived packets that
//! are not for this plane to the kernel. For each port, another thread reads the packets that the
//! kernel sends. Loops therefore never wait for the kernel.

use std::collections::HashMap;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::thread::JoinHandle;

use crate::lane::TxLane;
use crate::mbuf::{Mbuf, Pool};
use crate::tap::Tap;

/// Maximum number of packets that wait for the kernel.
pub const WAITING: usize = 1024;

/// Queue of packets to the kernel.
#[derive(Clone)]
pub struct ToHost(SyncSender<ToTap>);

/// The thread of [`ToHost`]. Dropping it waits until the last clone of [`ToHost`] is dropped and
/// its queue is empty.
pub struct Giver(Option<JoinHandle<()>>);

impl Drop for Giver {
    fn drop(&mut self) {
        if let Some(thread) = self.0.take() {
            let _ = thread.join();
        }
    }
}

/// Command to the thread.
enum ToTap {
    Packet(u32, Mbuf),
    Opened(u32, Arc<Tap>),
    /// Removes a port. The sender acknowledges it.
    Closed(u32, SyncSender<()>),
}

impl ToHost {
    pub fn start() -> io::Result<(Self, Giver)> {
        let (sender, messages) = mpsc::sync_channel(WAITING);
        let thread = std::thread::Builder::new().name("gdp-to-host".into()).spawn(move || give_all(messages))?;
        Ok((Self(sender), Giver(Some(thread))))
    }

    /// Queues a packet that arrived at a port for the kernel. Returns `false` if the queue is full;
    /// the packet is then lost.
    pub fn give(&self, port: u32, mbuf: Mbuf) -> bool {
        self.0.try_send(ToTap::Packet(port, mbuf)).is_ok()
    }
}

fn give_all(messages: Receiver<ToTap>) {
    let mut taps: HashMap<u32, Arc<Tap>> = HashMap::new();
    for message in messages {
        match message {
            ToTap::Opened(port, tap) => _ = taps.insert(port, tap),
            ToTap::Closed(port, answer) => {
                taps.remove(&port);
                let _ = answer.send(());
            }
            ToTap::Packet(port, mbuf) => {
                // The devices used here deliver packets in one segment.
                let Some(tap) = taps.get(&port).filter(|_| mbuf.is_linear()) else { continue };
                // The kernel counts packets that it refuses, as on any interface, for example while
                // the interface is down.
                if let Err(error) = tap.write(mbuf.bytes()) {
                    tracing::debug!(interface = tap.name(), %error, "the kernel did not take a packet");
                }
            }
        }
    }
}

/// The host's interface of a port. Dropping it ends the thread and thereby deletes the interface.
pub struct Host {
    stop: OwnedFd,
    to_host: ToHost,
    port: u32,
    thread: Option<JoinHandle<()>>,
}

impl Host {
    /// Starts the thread. Packets that the kernel sends leave by `lane`.
    pub fn start(tap: Arc<Tap>, (to_host, port): (ToHost, u32), pool: Pool, lane: TxLane) -> io::Result<Self> {
        let (stop, stopped) = event()?;
        let of = tap.clone();
        let take = move || take_all(&of, stopped.as_fd(), &pool, lane);
        let thread = std::thread::Builder::new().name("gdp-from-host".into()).spawn(take)?;
        let _ = to_host.0.send(ToTap::Opened(port, tap));
        Ok(Self { stop, to_host, port, thread: Some(thread) })
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        let (answer, answered) = mpsc::sync_channel(1);
        if self.to_host.0.send(ToTap::Closed(self.port, answer)).is_ok() {
            let _ = answered.recv();
        }
        let one = 1u64;
        // SAFETY: the call writes eight bytes to an open descriptor.
        unsafe { libc::write(self.stop.as_raw_fd(), (&raw const one).cast(), 8) };
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn take_all(tap: &Tap, stopped: BorrowedFd<'_>, pool: &Pool, mut lane: TxLane) {
    while wait(tap.as_fd(), stopped) {
        loop {
            match take(tap, pool) {
                Ok(Some(mbuf)) => lane.send(mbuf),
                Ok(None) => break,
                Err(error) => {
                    tracing::warn!(interface = tap.name(), %error, "the host's side of a port is of no use any more");
                    return;
                }
            }
        }
        lane.flush();
    }
}

/// Reads a packet that the kernel sends. If no buffer is available, the packet is lost.
fn take(tap: &Tap, pool: &Pool) -> io::Result<Option<Mbuf>> {
    let Some(mut mbuf) = pool.alloc() else {
        return tap.read(&mut [0; 1]).map(|_| None);
    };
    mbuf.reshape(0, pool.largest());
    let Some(room) = mbuf.bytes_mut() else { return Ok(None) };
    let Some(length) = tap.read(room)? else { return Ok(None) };
    mbuf.reshape(0, length);
    Ok(Some(mbuf))
}

/// Waits until the kernel sends a packet. Returns `false` when the thread should end.
fn wait(tap: BorrowedFd<'_>, stopped: BorrowedFd<'_>) -> bool {
    let poll = |fd: BorrowedFd<'_>| libc::pollfd { fd: fd.as_raw_fd(), events: libc::POLLIN, revents: 0 };
    let mut fds = [poll(tap), poll(stopped)];
    // SAFETY: the array has this number of structures.
    unsafe { libc::poll(fds.as_mut_ptr(), fds.len() as libc::nfds_t, -1) };
    fds[1].revents == 0
}

/// Returns two descriptors of one event.
fn event() -> io::Result<(OwnedFd, OwnedFd)> {
    // SAFETY: the call makes a descriptor or fails.
    let fd = unsafe { libc::eventfd(0, libc::EFD_CLOEXEC) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: no other code owns this descriptor.
    let event = unsafe { OwnedFd::from_raw_fd(fd) };
    let other = event.try_clone()?;
    Ok((event, other))
}

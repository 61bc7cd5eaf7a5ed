//! Between ports and the host's sides of them: one thread gives the kernel what arrived and is not
//! for this plane, and for each port one takes from the kernel what is to leave. So no loop ever
//! waits for the kernel.

use std::collections::HashMap;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::thread::JoinHandle;

use crate::lane::TxLane;
use crate::mbuf::{Mbuf, Pool};
use crate::tap::Tap;

/// Packets that wait for the kernel, at most.
pub const WAITING: usize = 1024;

/// The way to the kernel.
#[derive(Clone)]
pub struct ToHost(SyncSender<Told>);

/// The thread of [`ToHost`]. Dropping it waits until the last clone of that is gone, and all that
/// waited with it.
pub struct Giver(Option<JoinHandle<()>>);

impl Drop for Giver {
    fn drop(&mut self) {
        if let Some(thread) = self.0.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread is given.
enum Told {
    Packet(u32, Mbuf),
    Come(u32, Arc<Tap>),
    /// With whom to tell that it is.
    Gone(u32, SyncSender<()>),
}

impl ToHost {
    pub fn start() -> io::Result<(Self, Giver)> {
        let (sender, told) = mpsc::sync_channel(WAITING);
        let thread = std::thread::Builder::new().name("gdp-to-host".into()).spawn(move || give_all(told))?;
        Ok((Self(sender), Giver(Some(thread))))
    }

    /// Gives the kernel a packet that arrived at a port; `false` if too many wait already, and this
    /// one is gone.
    pub fn give(&self, port: u32, mbuf: Mbuf) -> bool {
        self.0.try_send(Told::Packet(port, mbuf)).is_ok()
    }
}

fn give_all(told: Receiver<Told>) {
    let mut taps: HashMap<u32, Arc<Tap>> = HashMap::new();
    for told in told {
        match told {
            Told::Come(port, tap) => _ = taps.insert(port, tap),
            Told::Gone(port, answer) => {
                taps.remove(&port);
                let _ = answer.send(());
            }
            Told::Packet(port, mbuf) => {
                // Our devices give packets in one piece.
                let Some(tap) = taps.get(&port).filter(|_| mbuf.is_linear()) else { continue };
                // As with any interface: the kernel counts what it does not take, of one that is
                // down for instance.
                if let Err(error) = tap.write(mbuf.bytes()) {
                    tracing::debug!(interface = tap.name(), %error, "the kernel did not take a packet");
                }
            }
        }
    }
}

/// The host's side of a port. Dropping it ends the thread, and with it the interface.
pub struct Host {
    stop: OwnedFd,
    to_host: ToHost,
    port: u32,
    thread: Option<JoinHandle<()>>,
}

impl Host {
    /// What the kernel sends leaves by `lane`.
    pub fn start(tap: Arc<Tap>, (to_host, port): (ToHost, u32), pool: Pool, lane: TxLane) -> io::Result<Self> {
        let (stop, stopped) = event()?;
        let of = tap.clone();
        let take = move || take_all(&of, stopped.as_fd(), &pool, lane);
        let thread = std::thread::Builder::new().name("gdp-from-host".into()).spawn(take)?;
        let _ = to_host.0.send(Told::Come(port, tap));
        Ok(Self { stop, to_host, port, thread: Some(thread) })
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        let (answer, answered) = mpsc::sync_channel(1);
        if self.to_host.0.send(Told::Gone(self.port, answer)).is_ok() {
            let _ = answered.recv();
        }
        let one = 1u64;
        // SAFETY: eight bytes, to a descriptor that is open.
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

/// A packet that the kernel sends. Without memory for it, it is lost.
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

/// Until the kernel has something; `false` once it is time to end.
fn wait(tap: BorrowedFd<'_>, stopped: BorrowedFd<'_>) -> bool {
    let poll = |fd: BorrowedFd<'_>| libc::pollfd { fd: fd.as_raw_fd(), events: libc::POLLIN, revents: 0 };
    let mut fds = [poll(tap), poll(stopped)];
    // SAFETY: two such structures.
    unsafe { libc::poll(fds.as_mut_ptr(), fds.len() as libc::nfds_t, -1) };
    fds[1].revents == 0
}

/// Two descriptors of one event.
fn event() -> io::Result<(OwnedFd, OwnedFd)> {
    // SAFETY: makes a descriptor or nothing.
    let fd = unsafe { libc::eventfd(0, libc::EFD_CLOEXEC) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: it is nobody else's.
    let event = unsafe { OwnedFd::from_raw_fd(fd) };
    let other = event.try_clone()?;
    Ok((event, other))
}

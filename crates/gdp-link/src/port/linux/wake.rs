//! Waits for descriptors, and for events that make a queue in memory pollable like a socket.

use std::io;
use std::mem::size_of;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::time::Duration;

use super::sys::check;

/// Waits until the descriptor is ready for `events` (POLLIN, POLLOUT), `wake` is set, or the
/// timeout expires. Returns whether the descriptor is ready. Clears `wake`.
pub fn wait(fd: BorrowedFd, events: i16, wake: Option<&WakeEvent>, timeout: Duration) -> io::Result<bool> {
    let poll = |fd: BorrowedFd, events| libc::pollfd { fd: fd.as_raw_fd(), events, revents: 0 };
    let mut polls = [poll(fd, events), poll(wake.map_or(fd, WakeEvent::fd), libc::POLLIN)];
    let count = if wake.is_some() { 2 } else { 1 };
    let time = timespec(timeout);
    // SAFETY: the pointers refer to at least `count` pollfds and one timespec, which outlive the
    // call; no signal mask.
    match check(unsafe { libc::ppoll(polls.as_mut_ptr(), count, &time, std::ptr::null()) }) {
        Ok(_) => {
            if let Some(wake) = wake.filter(|_| polls[1].revents != 0) {
                wake.clear();
            }
            Ok(polls[0].revents != 0)
        }
        Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(false),
        Err(error) => Err(error),
    }
}

/// Maximum number of sockets that [`wait_any`] waits for.
pub const MOST_AT_ONCE: usize = 8;

/// Waits until one of the descriptors is readable, one of the events is set, or the timeout
/// expires. Clears the events.
pub fn wait_any<'a>(
    sockets: impl Iterator<Item = (BorrowedFd<'a>, &'a WakeEvent)> + Clone,
    wake: &WakeEvent,
    timeout: Duration,
) -> io::Result<()> {
    // The kernel ignores negative descriptors.
    let mut polls = [libc::pollfd { fd: -1, events: libc::POLLIN, revents: 0 }; 2 * MOST_AT_ONCE + 1];
    let sockets = sockets.take(MOST_AT_ONCE);
    let all = sockets.clone().flat_map(|(fd, wake)| [fd, wake.fd()]).chain([wake.fd()]);
    let mut count: libc::nfds_t = 0;
    for (poll, fd) in polls.iter_mut().zip(all) {
        poll.fd = fd.as_raw_fd();
        count += 1;
    }
    let time = timespec(timeout);
    // SAFETY: the pointers refer to at least `count` pollfds and one timespec, which outlive the
    // call; no signal mask.
    match check(unsafe { libc::ppoll(polls.as_mut_ptr(), count, &time, std::ptr::null()) }) {
        Ok(_) => {
            let is_set = |poll: &libc::pollfd| poll.revents != 0;
            sockets.zip(polls.chunks(2)).filter(|(_, polls)| is_set(&polls[1])).for_each(|((_, wake), _)| wake.clear());
            if is_set(&polls[count as usize - 1]) {
                wake.clear();
            }
            Ok(())
        }
        Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(()),
        Err(error) => Err(error),
    }
}

/// Returns a timeout in the kernel's format. Longer ones than the kernel's become its longest.
fn timespec(timeout: Duration) -> libc::timespec {
    libc::timespec {
        tv_sec: timeout.as_secs().min(i32::MAX as u64) as libc::time_t,
        tv_nsec: timeout.subsec_nanos().into(),
    }
}

/// An eventfd, which makes a queue in memory pollable like a socket.
#[derive(Debug)]
pub struct WakeEvent(OwnedFd);

impl WakeEvent {
    pub fn new() -> io::Result<Self> {
        // SAFETY: no pointers; `OwnedFd` owns the new descriptor.
        Ok(Self(unsafe { OwnedFd::from_raw_fd(check(libc::eventfd(0, libc::EFD_NONBLOCK | libc::EFD_CLOEXEC))?) }))
    }

    pub fn set(&self) {
        let one = 1u64;
        // SAFETY: the kernel reads eight bytes from `one`. The call can only fail when the event's
        // count is already 2^64 − 2.
        unsafe { libc::write(self.0.as_raw_fd(), (&raw const one).cast(), size_of::<u64>()) };
    }

    pub fn clear(&self) {
        let mut count = 0u64;
        // SAFETY: the kernel writes eight bytes to `count`. The call fails only when the event is
        // not set.
        unsafe { libc::read(self.0.as_raw_fd(), (&raw mut count).cast(), size_of::<u64>()) };
    }

    pub fn fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

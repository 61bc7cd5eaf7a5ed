//! Sends the frames of one `sendmmsg` call.
//!
//! Over UDP, a run of consecutive frames that the kernel can segment goes to it as one datagram
//! (UDP GSO). The run then traverses the kernel's stack once.
//!
//! This code does not use `quinn-udp`, which sends one contiguous datagram per call: see
//! docs/decisions.md.

use std::marker::PhantomData;
use std::mem::zeroed;
use std::os::fd::{AsRawFd, BorrowedFd};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use super::control::Control;
use super::sys::{self, RawAddr};
use super::wake;
use crate::port::LinkAddr;
use crate::port::batch::{BATCH, OutFrame, traffic};

/// Maximum time to wait for space in the socket's buffer before frames are given up.
const SEND_PATIENCE: Duration = Duration::from_millis(5);

/// Maximum length of a run, in bytes. With the headers of UDP and IPv6 it must fit 16 bits.
const LONGEST_RUN: usize = 65_535 - 8 - 40;

/// Maximum number of frames in a run. Kernels support 64 since 4.18, later ones more.
const MOST_SEGMENTS: usize = 64;

/// Number of calls without runs after the kernel refused a run. Paths change, and a later run may
/// succeed.
const PAUSE: u32 = 1000;

/// Whether to send runs of frames with segmentation offload. The kernel refuses a run that it
/// cannot segment: with IPsec, or on sockets or devices without checksums.
#[derive(Default)]
pub struct Offload {
    /// Remaining calls before the next attempt. `u32::MAX` disables offload.
    paused: AtomicU32,
}

impl Offload {
    /// Returns the state for a medium without segmentation offload.
    pub fn never() -> Self {
        Self { paused: AtomicU32::new(u32::MAX) }
    }

    /// Returns whether the next call may send runs.
    fn is_on(&self) -> bool {
        match self.paused.load(Ordering::Relaxed) {
            0 => true,
            u32::MAX => false,
            paused => {
                // Two concurrent threads may count one call. This is harmless.
                self.paused.store(paused - 1, Ordering::Relaxed);
                false
            }
        }
    }

    fn refused(&self) {
        self.paused.store(PAUSE, Ordering::Relaxed);
    }
}

/// Up to [`BATCH`] frames.
pub struct Chunk<'a> {
    frames: [Frame; BATCH],
    iovecs: [[libc::iovec; 2]; BATCH],
    count: usize,
    pieces: PhantomData<&'a [u8]>,
}

#[derive(Clone, Copy)]
struct Frame {
    to: LinkAddr,
    addr: RawAddr,
    addr_len: u32,
    length: usize,
    traffic: u8,
}

impl<'a> Chunk<'a> {
    pub fn new() -> Self {
        let nowhere = LinkAddr::Ethernet { ifindex: 0, mac: [0; 6] };
        let none = Frame { to: nowhere, addr: RawAddr::zeroed(), addr_len: 0, length: 0, traffic: 0 };
        let empty = libc::iovec { iov_base: std::ptr::null_mut(), iov_len: 0 };
        Self { frames: [none; BATCH], iovecs: [[empty; 2]; BATCH], count: 0, pieces: PhantomData }
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn is_full(&self) -> bool {
        self.count == BATCH
    }

    /// Adds a frame to a chunk that is not full.
    pub fn push(&mut self, frame: OutFrame<'a>, addr: RawAddr, addr_len: u32) {
        let OutFrame { to, head, body } = frame;
        let length = head.len() + body.len();
        self.frames[self.count] = Frame { to, addr, addr_len, length, traffic: traffic(frame) };
        self.iovecs[self.count] =
            [head, body].map(|piece| libc::iovec { iov_base: piece.as_ptr().cast_mut().cast(), iov_len: piece.len() });
        self.count += 1;
    }

    /// Sends the chunk, and returns the number of frames that the kernel accepted.
    pub fn send(&self, fd: BorrowedFd, offload: &Offload) -> usize {
        // SAFETY: plain structures of integers and pointers, for which zero is a valid value.
        let mut messages: [libc::mmsghdr; BATCH] = unsafe { zeroed() };
        let mut controls = [Control::new(); BATCH];
        let (mut next, mut sent, mut waited, mut told) = (0, 0, false, false);
        // Frames before this index are sent individually.
        let mut single = if offload.is_on() { 0 } else { self.count };
        while next < self.count {
            let mut ends = [0; BATCH];
            let mut count = 0;
            let mut start = next;
            while start < self.count {
                let end = self.end_of_run(start, single);
                self.describe(start, end, &mut messages[count], &mut controls[count]);
                ends[count] = end;
                (start, count) = (end, count + 1);
            }
            // SAFETY: the headers point to addresses, control messages and pieces of frames. These
            // live as long as `self`, `controls` and `'a`, and the kernel only reads them.
            let result = sys::check(unsafe {
                libc::sendmmsg(fd.as_raw_fd(), messages.as_mut_ptr(), count as u32, libc::MSG_DONTWAIT as _)
            });
            match result {
                Ok(0) => break,
                Ok(taken) => {
                    let end = ends[taken as usize - 1];
                    sent += end - next;
                    next = end;
                }
                Err(error) => match error.raw_os_error() {
                    Some(libc::EINTR) => {}
                    Some(libc::EAGAIN | libc::ENOBUFS) if !waited => {
                        waited = true;
                        let _ = wake::wait(fd, libc::POLLOUT, None, SEND_PATIENCE);
                    }
                    // May report an earlier event: a socket reports once that its interface was
                    // down.
                    Some(libc::ENETDOWN) if !told => told = true,
                    Some(libc::EAGAIN | libc::ENOBUFS | libc::ENETDOWN | libc::ENXIO) => break,
                    // The kernel refuses runs, on this path or in general. Or the path only takes
                    // smaller frames, and the last frame of the run may be small enough.
                    Some(refusal @ (libc::EIO | libc::EINVAL | libc::EOPNOTSUPP | libc::EMSGSIZE))
                        if ends[0] - next > 1 =>
                    {
                        if refusal != libc::EMSGSIZE {
                            offload.refused();
                        }
                        single = ends[0];
                    }
                    // The error concerns this frame or the destination of the run: its size or its
                    // address.
                    _ => next = ends[0],
                },
            }
        }
        sent
    }

    /// Returns the end of the run that begins at frame `start`. All its frames have the same
    /// destination, traffic class and length; only the last frame may be shorter. Frames before
    /// `single` form no runs.
    fn end_of_run(&self, start: usize, single: usize) -> usize {
        let first = &self.frames[start];
        let (mut end, mut bytes) = (start + 1, first.length);
        if start < single || first.length == 0 {
            return end;
        }
        while end < self.count && end - start < MOST_SEGMENTS && self.frames[end - 1].length == first.length {
            let next = &self.frames[end];
            bytes += next.length;
            let fits = (1..=first.length).contains(&next.length) && bytes <= LONGEST_RUN;
            if !fits || (next.to, next.traffic) != (first.to, first.traffic) {
                break;
            }
            end += 1;
        }
        end
    }

    fn describe(&self, start: usize, end: usize, message: &mut libc::mmsghdr, control: &mut Control) {
        let first = &self.frames[start];
        *control = Control::new();
        if end - start > 1 {
            control.push(libc::SOL_UDP, libc::UDP_SEGMENT, &(first.length as u16).to_ne_bytes());
        }
        if first.traffic != 0 {
            let (level, kind) = match first.to {
                LinkAddr::Udp(addr) if addr.is_ipv6() => (libc::IPPROTO_IPV6, libc::IPV6_TCLASS),
                _ => (libc::IPPROTO_IP, libc::IP_TOS),
            };
            control.push(level, kind, &libc::c_int::from(first.traffic).to_ne_bytes());
        }
        let header = &mut message.msg_hdr;
        header.msg_name = (&raw const first.addr).cast_mut().cast();
        header.msg_namelen = first.addr_len;
        header.msg_iov = self.iovecs[start..end].as_ptr().cast_mut().cast();
        header.msg_iovlen = (2 * (end - start)) as _;
        control.attach(header);
    }
}

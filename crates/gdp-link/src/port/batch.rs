//! Batches of frames: the buffers of received frames and the description of frames to send. No
//! system calls.

use std::net::IpAddr;

use gdp_wire::packet::{IPV4_LEN, IPV6_LEN, UDP_LEN};
use gdp_wire::{Header, SMALLEST_PATH};

use super::LinkAddr;

/// Largest data frame on a UDP link, in bytes: the payload of IPv4 on Ethernet with jumbo frames.
/// The MTU of a link may be smaller, by QUIC's path MTU discovery.
pub const UDP_MTU: u32 = 9000 - (IPV4_LEN + UDP_LEN) as u32;

/// Returns the smallest MTU of an interface that carries links over UDP, in bytes.
pub fn min_udp_mtu(bound: IpAddr) -> u32 {
    let ip = if bound.is_ipv4() { IPV4_LEN } else { IPV6_LEN };
    u32::from(SMALLEST_PATH) + (ip + UDP_LEN) as u32
}

/// The payload of UDP over IPv4 on Ethernet without jumbo frames, in bytes. Path MTU discovery goes
/// up to this at least.
pub const ETHERNET_PAYLOAD: u32 = 1500 - (IPV4_LEN + UDP_LEN) as u32;

/// Maximum number of frames per send call, and per receive call on Ethernet. A veth ring of 256
/// takes a batch without loss.
pub const BATCH: usize = 64;

/// The buffer of one receive call and the frames that the call received.
pub struct RecvBatch {
    /// Slots of equal size. Each takes one buffer from the kernel: a frame, or over UDP a run of
    /// frames.
    pub(super) storage: Vec<u8>,
    largest: usize,
    /// The received frames, in the order of their addresses and without overlap.
    pub(super) slots: Vec<BufferSlot>,
}

#[derive(Clone, Copy)]
pub(super) struct BufferSlot {
    pub(super) at: usize,
    pub(super) length: usize,
    pub(super) from: LinkAddr,
    pub(super) congested: bool,
}

/// A received frame. Its address may be unaligned: copy the header out.
pub struct InFrame<'a> {
    pub bytes: &'a mut [u8],
    pub from: LinkAddr,
    /// Whether a router between the two ends of the link marked the frame (CE, RFC 3168). Never set
    /// on Ethernet.
    pub congested: bool,
}

impl RecvBatch {
    /// Creates a batch for frames of up to `largest` bytes. On Ethernet a larger frame arrives cut,
    /// and parsing reports it as truncated.
    pub fn new(largest: usize) -> Self {
        Self { storage: Vec::new(), largest: largest.next_multiple_of(64), slots: Vec::with_capacity(BATCH) }
    }

    /// Returns the frames of the last receive call.
    pub fn frames(&mut self) -> impl Iterator<Item = InFrame<'_>> {
        let (mut rest, mut taken) = (&mut self.storage[..], 0);
        self.slots.iter().map(move |slot| {
            let (frame, behind) = std::mem::take(&mut rest)[slot.at - taken..].split_at_mut(slot.length);
            (rest, taken) = (behind, slot.at + slot.length);
            InFrame { bytes: frame, from: slot.from, congested: slot.congested }
        })
    }

    /// Returns frame `index` of the last receive call again, for example to send it after a rewrite
    /// in place.
    pub fn frame(&self, index: usize) -> &[u8] {
        let BufferSlot { at, length, .. } = self.slots[index];
        &self.storage[at..at + length]
    }

    /// Returns the size of the largest frame that fits, in bytes.
    pub fn largest(&self) -> usize {
        self.largest
    }

    pub fn len(&self) -> usize {
        self.slots.len()
    }

    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Adds a copy of a frame that did not arrive through this batch. Returns `false` if there are
    /// already [`BATCH`] frames.
    pub fn push(&mut self, frame: &[u8], from: LinkAddr, congested: bool) -> bool {
        if self.slots.len() >= BATCH {
            return false;
        }
        let at = self.slots.last().map_or(0, |last| last.at + last.length);
        let end = at + frame.len();
        if self.storage.len() < end {
            self.storage.resize(end, 0);
        }
        self.storage[at..end].copy_from_slice(frame);
        self.slots.push(BufferSlot { at, length: frame.len(), from, congested });
        true
    }

    pub(super) fn clear(&mut self) {
        self.slots.clear();
    }
}

/// A frame to send, in two pieces that need not be contiguous.
#[derive(Clone, Copy)]
pub struct OutFrame<'a> {
    pub to: LinkAddr,
    /// At least the two bytes with the frame's type and traffic class.
    pub head: &'a [u8],
    /// May be empty.
    pub body: &'a [u8],
}

/// The result of a send call.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sent {
    /// Frames that the kernel accepted.
    pub sent: usize,
    /// Frames given up: no buffer space in time, an interface that is down, or an address of
    /// another kind of port.
    pub lost: usize,
}

/// Returns the IP traffic class byte of a frame. Returns 0 on Ethernet, where only the frame's own
/// header carries the class.
pub fn traffic(frame: OutFrame) -> u8 {
    match (frame.to, frame.head) {
        (LinkAddr::Udp(_), [_, flags, ..]) => Header::ip_traffic(*flags),
        _ => 0,
    }
}

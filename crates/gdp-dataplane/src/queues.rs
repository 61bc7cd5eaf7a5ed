//! Ethernet interfaces with a long queue: the kernel queues frames of the userspace plane because
//! the interface sends more slowly than they arrive. The forwarder's threads query their sockets
//! and record the result here. The tables pass it to the forwarding decision, which marks frames
//! that can carry congestion marks.
//!
//! Over UDP, queueing disciplines and routers mark the outer packet instead. They know the queue of
//! each path, and the single UDP socket has many paths. They do not mark GDP frames directly on
//! Ethernet.

use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, Ordering};

use gdp_link::port::LinkAddr;
use parking_lot::RwLock;

/// Size in bytes of kernel memory at which a queue is long: about 57 full frames, or 7 ms at 100
/// Mb/s. A single batch may exceed it, so threads check queues before they send a batch.
const LONG: usize = 128 << 10;

/// Interfaces whose queue was long at the last check.
#[derive(Default)]
pub struct Queues {
    /// Whether any queue is long. Most frames read only this flag.
    any: AtomicBool,
    long: RwLock<HashSet<u32>>,
}

impl Queues {
    /// Records the queues of these interfaces. Also checks interfaces whose queue was long at the
    /// last check, because nothing may have been sent there since. `bytes`:
    /// [`gdp_link::port::DataSocket::send_queue`].
    pub fn look(&self, interfaces: impl Iterator<Item = u32>, bytes: impl Fn(u32) -> usize) {
        interfaces.for_each(|ifindex| self.note(ifindex, bytes(ifindex)));
        if self.any.load(Ordering::Relaxed) {
            let long = self.long.read().clone();
            long.into_iter().for_each(|ifindex| self.note(ifindex, bytes(ifindex)));
        }
    }

    /// Records the queue of one interface.
    pub fn note(&self, ifindex: u32, bytes: usize) {
        if self.is_long(ifindex) == (bytes > LONG) {
            return;
        }
        let mut long = self.long.write();
        if bytes > LONG {
            long.insert(ifindex)
        } else {
            long.remove(&ifindex)
        };
        self.any.store(!long.is_empty(), Ordering::Relaxed);
    }

    pub fn is_long(&self, ifindex: u32) -> bool {
        self.any.load(Ordering::Relaxed) && self.long.read().contains(&ifindex)
    }

    /// Returns whether frames to this neighbour wait in a long queue.
    pub fn is_long_to(&self, to: LinkAddr) -> bool {
        matches!(to, LinkAddr::Ethernet { ifindex, .. } if self.is_long(ifindex))
    }
}

#[cfg(test)]
#[path = "../tests/unit/queues.rs"]
mod tests;

//! Which Ethernet interfaces have a queue: frames of the userspace plane that the kernel holds
//! because the interface sends slower than they come. The forwarder's threads ask their sockets and
//! write it here; the tables tell the forwarding decision, which marks frames that take marks.
//!
//! Over UDP that is for queueing disciplines and routers to do: they know the queue of each path,
//! of which the one socket has many, and mark what carries the frame. They mark no frame that is
//! directly on Ethernet.

use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, Ordering};

use gdp_link::port::LinkAddr;
use parking_lot::RwLock;

/// Bytes of the kernel's memory that are a queue: about 57 full frames, which take 7 ms at 100
/// Mb/s. A batch that was just handed over may be more, so queues are to be asked for before that.
const LONG: usize = 128 << 10;

/// Interfaces whose queue was long when it was last asked for.
#[derive(Default)]
pub struct Queues {
    /// Whether there is one: so that as a rule that is all a frame asks.
    any: AtomicBool,
    long: RwLock<HashSet<u32>>,
}

impl Queues {
    /// Takes note of the queues of these interfaces, and of those that were long when they were
    /// last asked for: perhaps nothing was sent there since. `bytes`:
    /// [`gdp_link::port::DataSocket::send_queue`].
    pub fn look(&self, interfaces: impl Iterator<Item = u32>, bytes: impl Fn(u32) -> usize) {
        interfaces.for_each(|ifindex| self.note(ifindex, bytes(ifindex)));
        if self.any.load(Ordering::Relaxed) {
            let long = self.long.read().clone();
            long.into_iter().for_each(|ifindex| self.note(ifindex, bytes(ifindex)));
        }
    }

    /// The same of one interface.
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

    /// Whether frames wait long before they leave for this neighbour.
    pub fn is_long_to(&self, to: LinkAddr) -> bool {
        matches!(to, LinkAddr::Ethernet { ifindex, .. } if self.is_long(ifindex))
    }
}

#[cfg(test)]
#[path = "../tests/unit/queues.rs"]
mod tests;

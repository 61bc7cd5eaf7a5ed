//! State that the threads of the userspace plane share.

use crate::notices::Notices;
use crate::queues::Queues;
use crate::tally::Tally;
use gdp_link::port::{DataSocket, LinkAddr, OutFrame};
use gdp_wire::{Counter, Header};
use parking_lot::RwLock;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use zerocopy::IntoBytes as _;

/// Medium on which frames can be sent: an interface, or UDP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Medium {
    Ethernet(u32),
    Udp,
}

impl From<LinkAddr> for Medium {
    fn from(address: LinkAddr) -> Self {
        match address {
            LinkAddr::Ethernet { ifindex, .. } => Self::Ethernet(ifindex),
            LinkAddr::Udp(_) => Self::Udp,
        }
    }
}

/// State shared by all threads.
pub struct Shared {
    pub notices: Arc<Notices>,
    pub tally: Tally,
    pub queues: Arc<Queues>,
    pub sockets: RwLock<HashMap<Medium, Arc<DataSocket>>>,
    pub counters: [AtomicU64; Counter::COUNT],
}

impl Shared {
    /// Creates the shared state. `queues`: the queues of the tables.
    pub fn new(queues: Arc<Queues>) -> Self {
        Self {
            notices: Arc::default(),
            tally: Tally::default(),
            queues,
            sockets: RwLock::new(HashMap::new()),
            counters: [const { AtomicU64::new(0) }; Counter::COUNT],
        }
    }

    /// Returns the counters in the order of [`Counter::ALL`].
    pub fn counters(&self) -> [u64; Counter::COUNT] {
        std::array::from_fn(|i| self.counters[i].load(Ordering::Relaxed))
    }

    /// Sends a frame of this node, without reporting a loss.
    pub fn send_own(&self, to: LinkAddr, header: Header, payload: &[u8]) {
        let sockets = self.sockets.read();
        if let Some(socket) = sockets.get(&Medium::from(to)) {
            socket.send_batch([OutFrame { to, head: header.as_bytes(), body: payload }]);
        }
    }

    pub fn count(&self, counter: Counter, frames: u64) {
        if frames > 0 {
            self.counters[counter as usize].fetch_add(frames, Ordering::Relaxed);
        }
    }
}

pub fn sockets<T>(shared: &Shared, change: impl FnOnce(&mut HashMap<Medium, Arc<DataSocket>>) -> T) -> T {
    change(&mut shared.sockets.write())
}

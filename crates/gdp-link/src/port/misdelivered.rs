//! Queues for datagrams that arrived at the wrong one of a port's two UDP sockets.
//!
//! The kernel sometimes joins a datagram with one for the other socket. Such datagrams are rare.
//! The queues are bounded; excess datagrams are dropped.

use std::collections::VecDeque;
use std::io::{self, IoSliceMut};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::task::{Context, Waker};

use parking_lot::Mutex;
use quinn::udp::{EcnCodepoint, RecvMeta};

use super::LinkAddr;
use super::batch::RecvBatch;
use super::sys::WakeFd;
use crate::port::route_mtu::UDP_MTU;

/// Queue length and maximum datagram length of each kind. No link carries longer datagrams.
const QUEUE: usize = 1024;
const LONGEST: usize = UDP_MTU as usize;

/// A data frame.
struct Stray {
    from: LinkAddr,
    congested: bool,
    bytes: Vec<u8>,
}

/// Data frames that quinn's task received.
pub struct Frames {
    queue: Mutex<VecDeque<Stray>>,
    /// The length of the queue, readable without the lock.
    length: AtomicUsize,
    wake: Arc<WakeFd>,
    dropped: AtomicU64,
}

impl Frames {
    pub fn new() -> io::Result<Self> {
        let (queue, length, dropped) = (Mutex::default(), AtomicUsize::new(0), AtomicU64::new(0));
        Ok(Self { queue, length, wake: Arc::new(WakeFd::new()?), dropped })
    }

    /// Returns the event that is set when a frame is queued.
    pub fn wake(&self) -> Arc<WakeFd> {
        self.wake.clone()
    }

    pub fn is_empty(&self) -> bool {
        self.length.load(Ordering::Acquire) == 0
    }

    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    pub fn put(&self, from: LinkAddr, congested: bool, frame: &[u8]) {
        let mut queue = self.queue.lock();
        if queue.len() >= QUEUE || frame.len() > LONGEST {
            self.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        queue.push_back(Stray { from, congested, bytes: frame.to_vec() });
        self.length.store(queue.len(), Ordering::Release);
        drop(queue);
        self.wake.set();
    }

    /// Moves queued frames into `batch` while it has space.
    pub fn take(&self, batch: &mut RecvBatch) {
        let mut queue = self.queue.lock();
        while let Some(Stray { from, congested, bytes }) = queue.front()
            && batch.push(bytes, *from, *congested)
        {
            queue.pop_front();
        }
        self.length.store(queue.len(), Ordering::Release);
    }
}

/// QUIC packets that the data thread received. QUIC retransmits those that are dropped here.
#[derive(Default)]
pub struct Packets(Mutex<Waiting>);

#[derive(Default)]
struct Waiting {
    packets: VecDeque<(SocketAddr, Option<EcnCodepoint>, Vec<u8>)>,
    /// The waker of the task that takes packets.
    waker: Option<Waker>,
}

impl Packets {
    pub fn put(&self, from: SocketAddr, ecn: Option<EcnCodepoint>, packet: &[u8]) {
        let mut waiting = self.0.lock();
        if waiting.packets.len() < QUEUE && packet.len() <= LONGEST {
            waiting.packets.push_back((from, ecn, packet.to_vec()));
            waiting.waker.iter().for_each(Waker::wake_by_ref);
        }
    }

    /// Moves queued packets into `bufs` while there is space, and returns their number. If there
    /// are none, the task is woken when a packet is queued.
    pub fn take(&self, cx: &Context, bufs: &mut [IoSliceMut<'_>], meta: &mut [RecvMeta]) -> usize {
        let mut waiting = self.0.lock();
        let mut count = 0;
        while count < bufs.len().min(meta.len())
            && let Some((addr, ecn, packet)) = waiting.packets.pop_front()
        {
            let Some(room) = bufs[count].get_mut(..packet.len()) else { continue };
            room.copy_from_slice(&packet);
            meta[count] = RecvMeta { addr, len: packet.len(), stride: packet.len(), ecn, dst_ip: None };
            count += 1;
        }
        if count == 0 && waiting.waker.as_ref().is_none_or(|waker| !waker.will_wake(cx.waker())) {
            waiting.waker = Some(cx.waker().clone());
        }
        count
    }
}

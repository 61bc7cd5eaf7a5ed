//! The UDP socket's data frames that the task of quinn received, until the data thread takes them.
//! The queue is bounded; excess frames are dropped.

use std::collections::VecDeque;
use std::ops::DerefMut;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use gdp_wire::header::FIRST_QUIC_BYTE;
use parking_lot::Mutex;
use quinn::udp::{EcnCodepoint, RecvMeta};

use super::LinkAddr;
use super::batch::{RecvBatch, UDP_MTU};

/// Maximum length of a frame. No link carries longer ones.
const LONGEST: usize = UDP_MTU as usize;

struct QueuedFrame {
    from: LinkAddr,
    congested: bool,
    bytes: Vec<u8>,
}

pub struct FrameQueue {
    queue: Mutex<VecDeque<QueuedFrame>>,
    /// Maximum number of frames.
    most: usize,
    /// The length of the queue, readable without the lock.
    length: AtomicUsize,
    dropped: AtomicU64,
}

impl FrameQueue {
    pub fn new(most: usize) -> Self {
        Self { queue: Mutex::default(), most, length: AtomicUsize::new(0), dropped: AtomicU64::new(0) }
    }

    pub fn is_empty(&self) -> bool {
        self.length.load(Ordering::Acquire) == 0
    }

    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Moves the data frames of received runs here, so that only QUIC packets are left. Returns
    /// whether there were data frames.
    pub fn take_from(&self, bufs: &mut [impl DerefMut<Target = [u8]>], meta: &mut [RecvMeta]) -> bool {
        let mut found = false;
        for (buf, meta) in bufs.iter_mut().zip(meta) {
            let (congested, mut packets) = (meta.ecn == Some(EcnCodepoint::Ce), 0);
            for (at, length) in segments(meta.len.min(buf.len()), meta.stride) {
                if buf[at] < FIRST_QUIC_BYTE {
                    self.put(LinkAddr::udp(meta.addr), congested, &buf[at..at + length]);
                    found = true;
                } else {
                    buf.copy_within(at..at + length, packets);
                    packets += length;
                }
            }
            meta.len = packets;
        }
        found
    }

    fn put(&self, from: LinkAddr, congested: bool, frame: &[u8]) {
        let mut queue = self.queue.lock();
        if queue.len() >= self.most || frame.len() > LONGEST {
            self.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        queue.push_back(QueuedFrame { from, congested, bytes: frame.to_vec() });
        self.length.store(queue.len(), Ordering::Release);
    }

    /// Moves queued frames into `batch` while it has space.
    pub fn take(&self, batch: &mut RecvBatch) {
        let mut queue = self.queue.lock();
        while let Some(QueuedFrame { from, congested, bytes }) = queue.front()
            && batch.push(bytes, *from, *congested)
        {
            queue.pop_front();
        }
        self.length.store(queue.len(), Ordering::Release);
    }
}

/// Returns the offset and length of each datagram of a run that the kernel joined. All have the
/// same length, except that the last may be shorter.
pub fn segments(length: usize, segment: usize) -> impl Iterator<Item = (usize, usize)> {
    let segment = segment.max(1);
    (0..length).step_by(segment).map(move |at| (at, segment.min(length - at)))
}

//! The queue of requests to a service that this node serves, between the inbox and its
//! [`Server`](super::Server).

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use gdp_wire::Name;
use tokio::sync::mpsc;

use gdp_e2e::seal::Message;

/// Limits of queued requests: their number and the bytes of their bodies. Excess requests are
/// dropped without an answer, because queueing more would exhaust the server's memory.
const MAX_WAITING: usize = 4096;
const MAX_WAITING_BYTES: usize = 64 << 20;

/// Limits of requests that arrive before the RIB has announced their callers: the time in
/// nanoseconds of the steady clock, their number and their bytes.
const TIMEOUT: u64 = 5_000_000_000;
const MAX_EARLY: usize = 64;
const MAX_EARLY_BYTES: usize = 4 << 20;

/// The receiving end of a request queue.
pub struct RequestQueue {
    requests: mpsc::Receiver<Message>,
    bytes: Arc<AtomicUsize>,
}

impl RequestQueue {
    /// Returns the next request, or `None` after the sending end was dropped. Safe to cancel.
    pub async fn recv(&mut self) -> Option<Message> {
        let request = self.requests.recv().await?;
        self.bytes.fetch_sub(request.body.len(), Ordering::Relaxed);
        Some(request)
    }
}

/// The sending end of a request queue.
pub struct Tray {
    requests: mpsc::Sender<Message>,
    bytes: Arc<AtomicUsize>,
    early: VecDeque<(u64, Message)>,
    early_bytes: usize,
}

/// Creates an empty request queue.
pub fn new() -> (Tray, RequestQueue) {
    let ((sender, requests), bytes) = (mpsc::channel(MAX_WAITING), Arc::<AtomicUsize>::default());
    let tray = Tray { requests: sender, bytes: bytes.clone(), early: VecDeque::new(), early_bytes: 0 };
    (tray, RequestQueue { requests, bytes })
}

impl Tray {
    /// Queues a request of an authorised caller. Returns `false` if there is no space.
    pub fn put(&self, request: Message) -> bool {
        let size = request.body.len();
        if self.bytes.load(Ordering::Relaxed).saturating_add(size) > MAX_WAITING_BYTES {
            return false;
        }
        // Counted before the request can be received.
        self.bytes.fetch_add(size, Ordering::Relaxed);
        let put = self.requests.try_send(request).is_ok();
        if !put {
            self.bytes.fetch_sub(size, Ordering::Relaxed);
        }
        put
    }

    /// Buffers a request of an unknown caller. Returns the number of buffered requests that were
    /// dropped to make space.
    pub fn defer(&mut self, now: u64, request: Message) -> usize {
        self.early_bytes += request.body.len();
        self.early.push_back((now, request));
        let mut dropped = 0;
        while self.early.len() > MAX_EARLY || self.early_bytes > MAX_EARLY_BYTES {
            self.drop_first();
            dropped += 1;
        }
        dropped
    }

    /// Removes the buffered requests whose callers `may` now call. Returns them, and the number of
    /// expired requests.
    pub fn release(&mut self, now: u64, may: impl Fn(&Name) -> bool) -> (Vec<Message>, usize) {
        let (mut released, mut dropped) = (Vec::new(), 0);
        for (since, request) in std::mem::take(&mut self.early) {
            if may(&request.writer) {
                released.push(request);
            } else if now.saturating_sub(since) > TIMEOUT {
                dropped += 1;
            } else {
                self.early.push_back((since, request));
            }
        }
        self.early_bytes = self.early.iter().map(|(_, request)| request.body.len()).sum();
        (released, dropped)
    }

    fn drop_first(&mut self) {
        if let Some((_, request)) = self.early.pop_front() {
            self.early_bytes -= request.body.len();
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/request_queue.rs"]
mod tests;

//! Where requests to a service that this node serves wait for its [`Server`](super::Server).

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use gdp_wire::Name;
use tokio::sync::mpsc;

use gdp_e2e::seal::Message;

/// Requests that wait for a server, and bytes of their bodies. More are dropped: callers that still
/// wait for so many replies had better be told by silence than by a server that has no memory left.
const MAX_WAITING: usize = 4096;
const MAX_WAITING_BYTES: usize = 64 << 20;

/// Requests that came before the RIB told of their callers: each may be of one of them for so long
/// (steady clock, nanoseconds).
const TIMEOUT: u64 = 5_000_000_000;
const MAX_EARLY: usize = 64;
const MAX_EARLY_BYTES: usize = 4 << 20;

/// The end of a desk that requests are taken from.
pub struct RequestQueue {
    requests: mpsc::Receiver<Message>,
    bytes: Arc<AtomicUsize>,
}

impl RequestQueue {
    /// The next; `None` once no more are put there. Safe to cancel.
    pub async fn recv(&mut self) -> Option<Message> {
        let request = self.requests.recv().await?;
        self.bytes.fetch_sub(request.body.len(), Ordering::Relaxed);
        Some(request)
    }
}

/// The end that they are put on.
pub struct Tray {
    requests: mpsc::Sender<Message>,
    bytes: Arc<AtomicUsize>,
    early: VecDeque<(u64, Message)>,
    early_bytes: usize,
}

/// A desk with nothing on it.
pub fn new() -> (Tray, RequestQueue) {
    let ((sender, requests), bytes) = (mpsc::channel(MAX_WAITING), Arc::<AtomicUsize>::default());
    let tray = Tray { requests: sender, bytes: bytes.clone(), early: VecDeque::new(), early_bytes: 0 };
    (tray, RequestQueue { requests, bytes })
}

impl Tray {
    /// Puts a request there of one who may call; `false` if there is no room.
    pub fn put(&self, request: Message) -> bool {
        let size = request.body.len();
        if self.bytes.load(Ordering::Relaxed).saturating_add(size) > MAX_WAITING_BYTES {
            return false;
        }
        // Before it can be taken out again.
        self.bytes.fetch_add(size, Ordering::Relaxed);
        let put = self.requests.try_send(request).is_ok();
        if !put {
            self.bytes.fetch_sub(size, Ordering::Relaxed);
        }
        put
    }

    /// Keeps a request of one who is not known as a caller yet. Returns how many were dropped for
    /// it.
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

    /// Takes out what was held and `may` be put there by now. Returns that, and how many waited for
    /// too long.
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

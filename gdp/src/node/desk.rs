//! Where requests to a service that this node serves wait for its [`Server`](super::Server).

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use gdp_wire::Name;
use tokio::sync::mpsc;

use crate::seal::Message;

/// Requests that wait for a server, and bytes of their bodies. More are dropped: callers that still wait for so many replies had better
/// be told by silence than by a server that has no memory left.
const MAX_WAITING: usize = 4096;
const MAX_WAITING_BYTES: usize = 64 << 20;

/// Requests that came before the RIB told of their callers: each may be of one of them for so long (steady clock, nanoseconds).
const PATIENCE: u64 = 5_000_000_000;
const MAX_EARLY: usize = 64;
const MAX_EARLY_BYTES: usize = 4 << 20;

/// The end of a desk that requests are taken from.
pub struct Desk {
    requests: mpsc::Receiver<Message>,
    bytes: Arc<AtomicUsize>,
}

impl Desk {
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
pub fn new() -> (Tray, Desk) {
    let ((sender, requests), bytes) = (mpsc::channel(MAX_WAITING), Arc::<AtomicUsize>::default());
    let tray = Tray { requests: sender, bytes: bytes.clone(), early: VecDeque::new(), early_bytes: 0 };
    (tray, Desk { requests, bytes })
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

    /// Keeps a request of one who is not known as a caller yet. Returns how many were dropped for it.
    pub fn hold(&mut self, now: u64, request: Message) -> usize {
        self.early_bytes += request.body.len();
        self.early.push_back((now, request));
        let mut dropped = 0;
        while self.early.len() > MAX_EARLY || self.early_bytes > MAX_EARLY_BYTES {
            self.drop_first();
            dropped += 1;
        }
        dropped
    }

    /// Takes out what was held and `may` be put there by now. Returns that, and how many waited for too long.
    pub fn release(&mut self, now: u64, may: impl Fn(&Name) -> bool) -> (Vec<Message>, usize) {
        let (mut released, mut dropped) = (Vec::new(), 0);
        for (since, request) in std::mem::take(&mut self.early) {
            if may(&request.writer) {
                released.push(request);
            } else if now.saturating_sub(since) > PATIENCE {
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
mod tests {
    use bytes::Bytes;

    use super::*;
    use crate::seal::Encoding;

    #[tokio::test]
    async fn what_waits_is_bounded_and_comes_in_its_order() {
        let (tray, mut desk) = new();
        for sequence in 0..MAX_WAITING as u64 {
            assert!(tray.put(request(1, sequence, 10)));
        }
        assert!(!tray.put(request(1, 0, 10)), "too many");
        assert_eq!(desk.recv().await.unwrap().sequence, 0);
        assert!(!tray.put(request(1, 0, MAX_WAITING_BYTES)), "too much");
        assert!(tray.put(request(1, 7777, 10)));
        for _ in 1..MAX_WAITING {
            desk.recv().await.unwrap();
        }
        assert!(tray.put(request(1, 8888, MAX_WAITING_BYTES - 10)), "there is room again");
        assert_eq!(desk.recv().await.unwrap().sequence, 7777);
        drop(tray);
        assert_eq!(desk.recv().await.unwrap().sequence, 8888, "what was taken in is served");
        assert!(desk.recv().await.is_none());
    }

    #[test]
    fn what_comes_before_its_caller_is_known_waits_for_a_while() {
        let (mut tray, _desk) = new();
        let known = |caller: u8| move |writer: &Name| *writer == Name::from_bytes([caller; 32]);
        assert_eq!(tray.hold(0, request(1, 1, 10)) + tray.hold(1, request(2, 2, 10)), 0);
        let (released, late) = tray.release(2, known(2));
        assert_eq!((released.len(), released[0].sequence, late), (1, 2, 0));
        let (released, late) = tray.release(PATIENCE + 1, known(2));
        assert_eq!((released.len(), late), (0, 1));
        let dropped: usize = (0..MAX_EARLY as u64 + 3).map(|i| tray.hold(i, request(1, i, 10))).sum();
        assert_eq!(dropped, 3);
        assert_eq!(tray.hold(0, request(3, 1, MAX_EARLY_BYTES)), MAX_EARLY, "bytes are bounded, too");
        let (released, late) = tray.release(0, |_| true);
        assert_eq!((released.len(), late), (1, 0));
        assert_eq!((tray.early_bytes, tray.early.len()), (0, 0));
    }

    fn request(writer: u8, sequence: u64, size: usize) -> Message {
        Message {
            name: Name::default(),
            writer: Name::from_bytes([writer; 32]),
            session: [0; 16],
            sequence,
            timestamp_ns: 0,
            encoding: Encoding::Bytes,
            in_reply_to: None,
            origin: Bytes::new(),
            latched: None,
            service: None,
            body: vec![0; size].into(),
        }
    }
}

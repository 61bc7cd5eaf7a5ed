//! A subscription as the receiving thread holds it: the reader, whom it believes, and the queue to the application.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use gdp_wire::Name;
use tokio::sync::mpsc;

use super::counters::Counters;
use crate::identity::VerifyKey;
use crate::seal::{DropReason, EpochKey, Message, Moment, Reader, Received};

/// Writers of one name that are believed at once.
const MAX_WRITERS: usize = 256;

/// A writer whose right to a name was verified.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Writer {
    pub entity: Name,
    pub key: VerifyKey,
    pub not_after: u64,
}

/// The thread's side of a subscription.
pub struct Intake {
    reader: Reader,
    /// What every writer of the name seals with.
    key: EpochKey,
    queue: mpsc::Sender<Message>,
    queued_bytes: Arc<AtomicUsize>,
    max_queued_bytes: usize,
    /// Those the reader believes, and until when (Unix seconds).
    writers: HashMap<Name, u64>,
    /// Empty between calls; keeps its capacity.
    received: Received,
    seen_drops: [u64; DropReason::COUNT],
}

impl Intake {
    pub fn new(
        reader: Reader,
        key: &EpochKey,
        queue: mpsc::Sender<Message>,
        queued_bytes: Arc<AtomicUsize>,
        max_queued_bytes: usize,
    ) -> Self {
        Self {
            reader,
            key: key.clone(),
            queue,
            queued_bytes,
            max_queued_bytes,
            writers: HashMap::new(),
            received: Received::default(),
            seen_drops: [0; DropReason::COUNT],
        }
    }

    pub fn authorise(&mut self, writer: Writer) {
        if self.writers.len() >= MAX_WRITERS && !self.writers.contains_key(&writer.entity) {
            tracing::warn!(writer = %writer.entity, "more than {MAX_WRITERS} writers of one name; this one is not believed");
            return;
        }
        if self.reader.authorise(writer.entity, writer.key).is_err() {
            return;
        }
        // A writer that comes back keeps the replay windows it had.
        if self.writers.insert(writer.entity, writer.not_after).is_none() {
            // It is authorised, so the reader takes its key.
            let _ = self.reader.set_key(&writer.entity, super::EPOCH, self.key.clone());
        }
    }

    pub fn knows(&self, writer: &Name) -> bool {
        self.writers.contains_key(writer)
    }

    /// Takes a frame's payload; what it completes is delivered.
    pub fn push(&mut self, now: Moment, source: Name, payload: &[u8], counters: &Counters) -> Result<(), DropReason> {
        let result = self.reader.push(now, source, payload, &mut self.received);
        let mut received = std::mem::take(&mut self.received);
        received.messages.drain(..).for_each(|message| self.deliver(message, counters));
        received.clear();
        self.received = received;
        result
    }

    /// A writer is believed as long as its certificate holds, not as long as it is attached: forgetting it would forget
    /// which of its messages were delivered.
    pub fn expire(&mut self, now: Moment) {
        let unix = Duration::from_nanos(now.unix_ns).as_secs();
        let reader = &mut self.reader;
        self.writers.retain(|writer, not_after| {
            let holds = unix <= *not_after;
            if !holds {
                reader.revoke(writer);
            }
            holds
        });
        if reader.next_deadline().is_some_and(|deadline| deadline < now.steady_ns) {
            reader.expire(now.steady_ns);
        }
    }

    pub fn count_drops(&mut self, counters: &Counters) {
        let drops = self.reader.drops();
        if *drops != self.seen_drops {
            for ((now, seen), count) in drops.iter().zip(&self.seen_drops).zip(&counters.dropped) {
                count.add(now - seen);
            }
            self.seen_drops = *drops;
        }
    }

    fn deliver(&mut self, message: Message, counters: &Counters) {
        let length = message.body.len();
        let queued = self.queued_bytes.fetch_add(length, Ordering::Relaxed);
        match self.queue.try_reserve() {
            Ok(place) if queued.saturating_add(length) <= self.max_queued_bytes => {
                // Counted first: who has the message may look.
                counters.messages_received.add(1);
                place.send(message);
            }
            _ => {
                self.queued_bytes.fetch_sub(length, Ordering::Relaxed);
                counters.queue_full.add(1);
            }
        }
    }
}

//! The local writer on behalf of one remote publisher.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_e2e::seal::Message;
use gdp_util::backoff::Backoff;

use super::direct::{DirectLocal, LastWrite};
use super::format::Inbound;
use super::pending_match::PendingMatch;
use crate::graph::{WriteError, Writer};
use crate::stats::{Drop, RouteCounters};
use gdp_ros::qos_mapping::latched_depth;
use gdp_ros::roster::{Kind, Offer};
use gdp_ros::types::Types;

/// Time for which a writer stays after its publisher has gone and the last message was written, so
/// that reliable subscribers can request retransmissions.
const LINGER: Duration = Duration::from_secs(1);

/// Bound in bytes on the history of one transient-local publisher.
const MAX_HISTORY_BYTES: usize = 64 << 20;

/// Backoff between attempts to create a writer.
const RETRY: Backoff = Backoff::new(Duration::from_secs(1), Duration::from_secs(30));

/// The local writer of one remote publisher, or its description while there is no writer.
pub struct Local {
    pub kind: Kind,
    pub definition: Option<Arc<str>>,
    /// The full name of the publisher's node, or an empty text.
    pub node: Arc<str>,
    pub offers: Offer,
    state: LocalState,
    /// The publisher's transient-local history, for a writer that is created later.
    history: VecDeque<Message>,
    /// Bytes of the history.
    history_bytes: usize,
}

enum LocalState {
    /// The writer has to be created.
    Wanted,
    Made(Box<Made>),
    /// The publisher is silent, so it has no writer.
    Silent,
    Failed {
        why: String,
        again: Instant,
        retry: Backoff,
    },
}

/// A writer, and the conversion of messages for it.
pub struct Made {
    pub writer: Writer,
    pub offers: Offer,
    format: Inbound,
    /// Messages as they arrived: compressed ones may be much smaller.
    pending_match: Option<PendingMatch<Message>>,
    written: LastWrite,
}

/// Reason and text of a message that was not written.
pub type Refused = (Drop, String);

impl Local {
    pub fn new(kind: Kind, definition: Option<Arc<str>>, node: Arc<str>, offers: Offer) -> Self {
        Self { kind, definition, node, offers, state: LocalState::Wanted, history: VecDeque::new(), history_bytes: 0 }
    }

    /// Whether a writer with this type and QoS can stay. Its depth may change.
    pub fn is_of(&self, kind: &Kind, definition: Option<&Arc<str>>, offers: &Offer) -> bool {
        let offers = Offer { depth: self.offers.depth, ..*offers };
        (&self.kind, self.definition.as_ref(), self.offers) == (kind, definition, offers)
    }

    /// Records to which node the publisher belongs and how much it keeps. Its graph may tell that
    /// later than the rest.
    pub fn update(&mut self, node: Arc<str>, depth: u32) {
        if let LocalState::Made(made) = &mut self.state {
            if self.node != node {
                made.writer.assign(&node);
            }
            if self.offers.depth != depth {
                made.writer.set_depth(depth);
                made.offers.depth = depth;
            }
        }
        (self.node, self.offers.depth) = (node, depth);
    }

    /// Whether it is time to create the writer.
    pub fn is_due(&self, now: Instant) -> bool {
        match &self.state {
            LocalState::Wanted => true,
            LocalState::Failed { again, .. } => *again <= now,
            LocalState::Made(_) | LocalState::Silent => false,
        }
    }

    /// Returns the reason if the writer could not be created.
    pub fn fault(&self) -> Option<&str> {
        match &self.state {
            LocalState::Failed { why, .. } => Some(why),
            _ => None,
        }
    }

    /// Installs the writer. Returns the publisher's transient-local history, which must be written
    /// first.
    pub fn made(&mut self, made: Made) -> Vec<Message> {
        self.state = LocalState::Made(made.into());
        self.history.iter().cloned().collect()
    }

    pub fn failed(&mut self, now: Instant, why: String) {
        let mut retry = match &self.state {
            LocalState::Failed { retry, .. } => *retry,
            _ => RETRY,
        };
        self.state = LocalState::Failed { why, again: now + retry.next_delay(), retry };
    }

    /// Removes and returns the writer of a silent publisher, so that subscribers here see the
    /// publisher leave.
    pub fn silence(&mut self) -> Option<Made> {
        match std::mem::replace(&mut self.state, LocalState::Silent) {
            LocalState::Made(made) => Some(*made),
            _ => None,
        }
    }

    /// Records another type or QoS of the publisher, so that its writer is created anew. Returns
    /// the old writer, if there was one.
    pub fn renew(&mut self, kind: Kind, definition: Option<Arc<str>>, node: Arc<str>, offers: Offer) -> Option<Made> {
        if kind != self.kind {
            self.forget();
        }
        (self.kind, self.definition, self.node, self.offers) = (kind, definition, node, offers);
        match std::mem::replace(&mut self.state, LocalState::Wanted) {
            LocalState::Made(made) => Some(*made),
            _ => None,
        }
    }

    pub fn into_made(mut self) -> Option<Made> {
        self.silence()
    }

    /// Stores a message in the history, if its publisher is transient-local.
    pub fn keep(&mut self, message: &Message) {
        let most = latched_depth(&self.offers);
        if most == 0 {
            return self.forget();
        }
        self.history_bytes += message.body.len();
        self.history.push_back(message.clone());
        while self.history.len() > most || (self.history.len() > 1 && self.history_bytes > MAX_HISTORY_BYTES) {
            self.forget_oldest();
        }
    }

    /// Returns the direct path of messages, if there is a writer and no history.
    pub fn direct(&mut self, types: &Types) -> Option<DirectLocal> {
        match &mut self.state {
            LocalState::Made(made) if latched_depth(&self.offers) == 0 => made.direct(types),
            _ => None,
        }
    }

    /// Returns the bytes of the history and of the messages that wait for subscribers.
    pub fn bytes(&self) -> usize {
        match &self.state {
            LocalState::Made(made) => self.history_bytes + made.bytes(),
            _ => self.history_bytes,
        }
    }

    /// Drops the oldest message of the history or of the waiting ones, whichever has more bytes.
    /// Returns its size in bytes.
    pub fn evict(&mut self) -> usize {
        match &mut self.state {
            LocalState::Made(made) if made.bytes() > self.history_bytes => made.evict(),
            _ => self.forget_oldest(),
        }
    }

    fn forget(&mut self) {
        self.history.clear();
        self.history_bytes = 0;
    }

    fn forget_oldest(&mut self) -> usize {
        let bytes = self.history.pop_front().map_or(0, |oldest| oldest.body.len());
        self.history_bytes -= bytes;
        bytes
    }

    pub fn is_made(&self) -> bool {
        matches!(self.state, LocalState::Made(_))
    }

    pub fn made_mut(&mut self) -> Option<&mut Made> {
        match &mut self.state {
            LocalState::Made(made) => Some(made),
            _ => None,
        }
    }
}

impl Made {
    pub fn new(now: Instant, writer: Writer, offers: Offer, format: Inbound) -> Self {
        Self {
            writer,
            offers,
            format,
            pending_match: Some(PendingMatch::new(now, offers.reliable)),
            written: Arc::default(),
        }
    }

    /// Writes a message, or queues it until subscribers have matched.
    pub async fn take(&mut self, types: &Types, counters: &RouteCounters, message: Message) -> Result<(), Refused> {
        let began = Instant::now();
        match &mut self.pending_match {
            Some(pending_match) => {
                let length = message.body.len();
                pending_match.push(message, length);
            }
            None => {
                self.write(types, counters, message).await?;
                counters.handling.record(began.elapsed());
            }
        }
        Ok(())
    }

    /// Returns the direct path of messages, unless they must be converted or wait for subscribers.
    pub fn direct(&mut self, types: &Types) -> Option<DirectLocal> {
        if self.pending_match.is_some() || !self.format.is_unchanged(types) {
            return None;
        }
        Some(DirectLocal { writer: self.writer.immediate_writer()?, written: self.written.clone() })
    }

    /// Returns the time of the last message that was written.
    pub fn last_write(&self) -> Option<Instant> {
        *self.written.lock()
    }

    /// Whether messages are queued until subscribers have matched.
    pub fn is_holding(&self) -> bool {
        self.pending_match.is_some()
    }

    /// Returns the bytes of the messages that wait for subscribers.
    pub fn bytes(&self) -> usize {
        self.pending_match.as_ref().map_or(0, PendingMatch::bytes)
    }

    /// Drops the writer and returns the number of messages that waited.
    pub fn abandon(self) -> u64 {
        self.pending_match.map_or(0, |pending_match| pending_match.waiting() as u64)
    }

    /// Drops the oldest waiting message and returns its size in bytes.
    pub fn evict(&mut self) -> usize {
        self.pending_match.as_mut().map_or(0, PendingMatch::drop_oldest)
    }

    /// Writes the waiting messages once they need not wait any longer. Returns the errors.
    pub async fn look(&mut self, types: &Types, counters: &RouteCounters, now: Instant) -> Vec<Refused> {
        let Self { writer, pending_match, .. } = self;
        let Some(pending_match) = pending_match else { return Vec::new() };
        let due = pending_match.take(now, || writer.is_matched());
        if pending_match.is_done() {
            self.pending_match = None;
        }
        let mut refused = Vec::new();
        for message in due {
            refused.extend(self.write(types, counters, message).await.err());
        }
        refused
    }

    /// Whether the writer may be dropped, after its publisher has gone.
    pub fn is_over(&self, now: Instant) -> bool {
        self.pending_match.is_none() && self.last_write().is_none_or(|written| now >= written + LINGER)
    }

    async fn write(&mut self, types: &Types, counters: &RouteCounters, message: Message) -> Result<(), Refused> {
        let (timestamp_ns, carried) = (message.timestamp_ns, message.body.len());
        let bytes = self.format.convert(types, message).map_err(|why| (Drop::Unconvertible, why))?;
        let length = bytes.len();
        let result = self.writer.write(bytes, timestamp_ns).await;
        *self.written.lock() = Some(Instant::now());
        match result {
            Ok(()) => {
                counters.passed(length, carried);
                Ok(())
            }
            Err(error @ WriteError::Malformed) => Err((Drop::Malformed, error.to_string())),
            Err(error @ WriteError::Stalled) => Err((Drop::Stalled, error.to_string())),
            Err(error @ WriteError::Failed(_)) => Err((Drop::WriteFailed, error.to_string())),
        }
    }
}

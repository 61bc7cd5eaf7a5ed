//! The local writer on behalf of one remote publisher.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_e2e::seal::Message;
use gdp_util::backoff::Backoff;

use super::format::Inbound;
use super::pending_match::PendingMatch;
use crate::delivery::latched;
use crate::graph::{WriteError, Writer};
use crate::stats::{Drop, RouteCounters};
use gdp_ros::roster::{Kind, Offer};
use gdp_ros::types::Types;

/// For how long it stays after its publisher has gone and something was written: so that reliable
/// subscribers can have it repaired.
const LINGER: Duration = Duration::from_secs(1);

/// Bytes that are kept of what one publisher latches.
const MAX_HISTORY_BYTES: usize = 64 << 20;

/// Between attempts to make one.
const RETRY: Backoff = Backoff::new(Duration::from_secs(1), Duration::from_secs(30));

/// The counterpart of a publisher, or what is known of one that cannot be made.
pub struct Local {
    pub kind: Kind,
    pub definition: Option<Arc<str>>,
    pub offers: Offer,
    state: LocalState,
    /// What the publisher latches, for a writer that is made later; and how much that is.
    history: VecDeque<Message>,
    history_bytes: usize,
}

enum LocalState {
    /// It is to be made.
    Wanted,
    Made(Box<Made>),
    /// Nothing is heard of its publisher.
    Silent,
    Failed {
        why: String,
        again: Instant,
        retry: Backoff,
    },
}

/// A writer, and how messages become such as it takes.
pub struct Made {
    pub writer: Writer,
    pub offers: Offer,
    format: Inbound,
    /// As they came: compressed, they may be much smaller.
    pending_match: Option<PendingMatch<Message>>,
    written: Option<Instant>,
}

/// Why a message was not written.
pub type Refused = (Drop, String);

impl Local {
    pub fn new(kind: Kind, definition: Option<Arc<str>>, offers: Offer) -> Self {
        Self { kind, definition, offers, state: LocalState::Wanted, history: VecDeque::new(), history_bytes: 0 }
    }

    /// Whether it is time to try to make it.
    pub fn is_due(&self, now: Instant) -> bool {
        match &self.state {
            LocalState::Wanted => true,
            LocalState::Failed { again, .. } => *again <= now,
            LocalState::Made(_) | LocalState::Silent => false,
        }
    }

    /// Why there is none, if one could not be made.
    pub fn fault(&self) -> Option<&str> {
        match &self.state {
            LocalState::Failed { why, .. } => Some(why),
            _ => None,
        }
    }

    /// It is made: what its publisher latches is written first.
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

    /// Nothing is heard of its publisher: subscribers here see it go.
    pub fn silence(&mut self) -> Option<Made> {
        match std::mem::replace(&mut self.state, LocalState::Silent) {
            LocalState::Made(made) => Some(*made),
            _ => None,
        }
    }

    /// It is to be made anew, for this. What was there, if it was.
    pub fn renew(&mut self, kind: Kind, definition: Option<Arc<str>>, offers: Offer) -> Option<Made> {
        if kind != self.kind {
            self.forget();
        }
        (self.kind, self.definition, self.offers) = (kind, definition, offers);
        match std::mem::replace(&mut self.state, LocalState::Wanted) {
            LocalState::Made(made) => Some(*made),
            _ => None,
        }
    }

    pub fn into_made(mut self) -> Option<Made> {
        self.silence()
    }

    /// Keeps a message that its publisher latches.
    pub fn keep(&mut self, message: &Message) {
        let most = latched(&self.offers);
        if most == 0 {
            return self.forget();
        }
        self.history_bytes += message.body.len();
        self.history.push_back(message.clone());
        while self.history.len() > most || (self.history.len() > 1 && self.history_bytes > MAX_HISTORY_BYTES) {
            self.forget_oldest();
        }
    }

    /// Bytes that are kept, or wait for subscribers.
    pub fn bytes(&self) -> usize {
        match &self.state {
            LocalState::Made(made) => self.history_bytes + made.bytes(),
            _ => self.history_bytes,
        }
    }

    /// Lets the oldest message of them go: how many bytes these are.
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
        Self { writer, offers, format, pending_match: Some(PendingMatch::new(now, offers.reliable)), written: None }
    }

    /// Writes a message, or has it wait.
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

    /// Whether something waits.
    pub fn is_holding(&self) -> bool {
        self.pending_match.is_some()
    }

    /// Bytes that wait for subscribers.
    pub fn bytes(&self) -> usize {
        self.pending_match.as_ref().map_or(0, PendingMatch::bytes)
    }

    /// How many messages wait that go with it.
    pub fn abandon(self) -> u64 {
        self.pending_match.map_or(0, |pending_match| pending_match.into_waiting().count() as u64)
    }

    /// Lets the oldest message that waits go: how many bytes it is.
    pub fn evict(&mut self) -> usize {
        self.pending_match.as_mut().map_or(0, PendingMatch::drop_oldest)
    }

    /// Writes what has waited, once it need not wait any more; what was refused.
    pub async fn look(&mut self, types: &Types, counters: &RouteCounters, now: Instant) -> Vec<Refused> {
        let Self { writer, pending_match, .. } = self;
        let mut refused = Vec::new();
        if pending_match.as_mut().is_some_and(|pending_match| pending_match.is_over(now, || writer.is_matched()))
            && let Some(pending_match) = self.pending_match.take()
        {
            for message in pending_match.into_waiting() {
                refused.extend(self.write(types, counters, message).await.err());
            }
        }
        refused
    }

    /// Whether it may go, its publisher having gone.
    pub fn is_over(&self, now: Instant) -> bool {
        self.pending_match.is_none() && self.written.is_none_or(|written| now >= written + LINGER)
    }

    async fn write(&mut self, types: &Types, counters: &RouteCounters, message: Message) -> Result<(), Refused> {
        let (timestamp_ns, carried) = (message.timestamp_ns, message.body.len());
        let bytes = self.format.convert(types, message).map_err(|why| (Drop::Unconvertible, why))?;
        let length = bytes.len();
        let result = self.writer.write(bytes, timestamp_ns).await;
        self.written = Some(Instant::now());
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

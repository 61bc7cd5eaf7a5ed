//! What stands in the graph for one publisher elsewhere.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_e2e::seal::Message;
use gdp_util::backoff::Backoff;

use super::format::Inbound;
use super::hold::Hold;
use crate::delivery::latched;
use crate::graph::{WriteError, Writer};
use crate::stats::{Drop, RouteCounters};
use gdp_ros::roster::{Kind, Offer};
use gdp_ros::types::Types;

/// For how long it stays after its publisher has gone and something was written: so that reliable
/// subscribers can have it repaired.
const LINGER: Duration = Duration::from_secs(1);

/// Bytes that are kept of what one publisher latches.
const MAX_KEPT_BYTES: usize = 64 << 20;

/// Between attempts to make one.
const RETRY: Backoff = Backoff::new(Duration::from_secs(1), Duration::from_secs(30));

/// The counterpart of a publisher, or what is known of one that cannot be made.
pub struct Local {
    pub kind: Kind,
    pub definition: Option<Arc<str>>,
    pub offers: Offer,
    state: State,
    /// What the publisher latches, for a writer that is made later; and how much that is.
    kept: VecDeque<Message>,
    kept_bytes: usize,
}

enum State {
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
    hold: Option<Hold<Message>>,
    written: Option<Instant>,
}

/// Why a message was not written.
pub type Refused = (Drop, String);

impl Local {
    pub fn new(kind: Kind, definition: Option<Arc<str>>, offers: Offer) -> Self {
        Self { kind, definition, offers, state: State::Wanted, kept: VecDeque::new(), kept_bytes: 0 }
    }

    /// Whether it is time to try to make it.
    pub fn is_due(&self, now: Instant) -> bool {
        match &self.state {
            State::Wanted => true,
            State::Failed { again, .. } => *again <= now,
            State::Made(_) | State::Silent => false,
        }
    }

    /// Why there is none, if one could not be made.
    pub fn fault(&self) -> Option<&str> {
        match &self.state {
            State::Failed { why, .. } => Some(why),
            _ => None,
        }
    }

    /// It is made: what its publisher latches is written first.
    pub fn made(&mut self, made: Made) -> Vec<Message> {
        self.state = State::Made(made.into());
        self.kept.iter().cloned().collect()
    }

    pub fn failed(&mut self, now: Instant, why: String) {
        let mut retry = match &self.state {
            State::Failed { retry, .. } => *retry,
            _ => RETRY,
        };
        self.state = State::Failed { why, again: now + retry.next_delay(), retry };
    }

    /// Nothing is heard of its publisher: subscribers here see it go.
    pub fn silence(&mut self) -> Option<Made> {
        match std::mem::replace(&mut self.state, State::Silent) {
            State::Made(made) => Some(*made),
            _ => None,
        }
    }

    /// It is to be made anew, for this. What was there, if it was.
    pub fn renew(&mut self, kind: Kind, definition: Option<Arc<str>>, offers: Offer) -> Option<Made> {
        if kind != self.kind {
            self.forget();
        }
        (self.kind, self.definition, self.offers) = (kind, definition, offers);
        match std::mem::replace(&mut self.state, State::Wanted) {
            State::Made(made) => Some(*made),
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
        self.kept_bytes += message.body.len();
        self.kept.push_back(message.clone());
        while self.kept.len() > most || (self.kept.len() > 1 && self.kept_bytes > MAX_KEPT_BYTES) {
            self.forget_oldest();
        }
    }

    /// Bytes that are kept, or wait for subscribers.
    pub fn bytes(&self) -> usize {
        match &self.state {
            State::Made(made) => self.kept_bytes + made.bytes(),
            _ => self.kept_bytes,
        }
    }

    /// Lets the oldest message of them go: how many bytes these are.
    pub fn evict(&mut self) -> usize {
        match &mut self.state {
            State::Made(made) if made.bytes() > self.kept_bytes => made.evict(),
            _ => self.forget_oldest(),
        }
    }

    fn forget(&mut self) {
        self.kept.clear();
        self.kept_bytes = 0;
    }

    fn forget_oldest(&mut self) -> usize {
        let bytes = self.kept.pop_front().map_or(0, |oldest| oldest.body.len());
        self.kept_bytes -= bytes;
        bytes
    }

    pub fn is_made(&self) -> bool {
        matches!(self.state, State::Made(_))
    }

    pub fn made_mut(&mut self) -> Option<&mut Made> {
        match &mut self.state {
            State::Made(made) => Some(made),
            _ => None,
        }
    }
}

impl Made {
    pub fn new(now: Instant, writer: Writer, offers: Offer, format: Inbound) -> Self {
        Self { writer, offers, format, hold: Some(Hold::new(now, offers.reliable)), written: None }
    }

    /// Writes a message, or has it wait.
    pub async fn take(&mut self, types: &Types, counters: &RouteCounters, message: Message) -> Result<(), Refused> {
        let began = Instant::now();
        match &mut self.hold {
            Some(hold) => {
                let length = message.body.len();
                hold.push(message, length);
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
        self.hold.is_some()
    }

    /// Bytes that wait for subscribers.
    pub fn bytes(&self) -> usize {
        self.hold.as_ref().map_or(0, Hold::bytes)
    }

    /// How many messages wait that go with it.
    pub fn abandon(self) -> u64 {
        self.hold.map_or(0, |hold| hold.into_waiting().count() as u64)
    }

    /// Lets the oldest message that waits go: how many bytes it is.
    pub fn evict(&mut self) -> usize {
        self.hold.as_mut().map_or(0, Hold::drop_oldest)
    }

    /// Writes what has waited, once it need not wait any more; what was refused.
    pub async fn look(&mut self, types: &Types, counters: &RouteCounters, now: Instant) -> Vec<Refused> {
        let Self { writer, hold, .. } = self;
        let mut refused = Vec::new();
        if hold.as_mut().is_some_and(|hold| hold.is_over(now, || writer.is_matched()))
            && let Some(hold) = self.hold.take()
        {
            for message in hold.into_waiting() {
                refused.extend(self.write(types, counters, message).await.err());
            }
        }
        refused
    }

    /// Whether it may go, its publisher having gone.
    pub fn is_over(&self, now: Instant) -> bool {
        self.hold.is_none() && self.written.is_none_or(|written| now >= written + LINGER)
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

//! The writer's state of a topic's readers: the messages that each has, and the speed of its path.

use std::collections::BTreeMap;

use gdp_wire::Name;

use super::black_hole::Suspicion;
use super::congestion::{Path, Sample};
use super::delivery_rate::DeliveryRate;
use super::outbox::Outbox;
use super::repair_budget::{Fresh, RepairBudget};
use super::sent_log::{Sent, SentLog};
use super::{MS, Position};

/// Maximum number of tracked readers of a topic. Further readers get the same frames without
/// repair.
pub const MOST_PEERS: usize = 1024;

/// Interval of the checks for silent readers. A reader is ignored after [`SILENT`] checks without a
/// report.
pub const SILENCE_STEP: u64 = 500 * MS;
const SILENT: u32 = 6;

/// Time for which publishers do not wait for a reader that fell behind a full history. Doubles each
/// time.
const LAG: u64 = 4_000 * MS;

/// The parts of a report that concern the sender.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    pub acknowledged: u64,
    pub received_bytes: u64,
    pub needless_bytes: u64,
    pub ce: u32,
    pub echo: Option<Position>,
    pub delay: u64,
}

#[derive(Debug)]
pub struct ReaderState {
    path: Path,
    /// All messages up to this sequence are acknowledged.
    acknowledged: u64,
    /// The reader fell behind the history. Publishers do not wait for it until it has caught up.
    lagging: bool,
    lagging_until: u64,
    lags: u32,
    /// Start of the time that a publisher has waited for the reader, with interruptions.
    waited_since: Option<u64>,
    /// Number of checks since the last report.
    silent: u32,
    /// The latest sent frame that the reader has reported.
    echo: Option<Sent>,
    delivery_rate: DeliveryRate,
    received_bytes: u64,
    needless_bytes: u64,
    ce: u32,
    /// Bytes of the topic that are no longer in flight to the reader.
    arrived: u64,
    /// Time of the last increase of `arrived`.
    progress_at: u64,
    repairs: RepairBudget,
    pub suspicion: Suspicion,
    /// Start of the time that losses count for. Earlier losses are handled, or say nothing about
    /// the present path.
    reported_since: u64,
    lost: u64,
}

impl ReaderState {
    /// Returns the state of a reader that joins at `now`, after `sent` bytes of the topic, `fresh`
    /// of them for the first time.
    pub fn new(now: u64, acknowledged: u64, sent: u64, fresh: u64) -> Self {
        Self {
            path: Path::new(),
            acknowledged,
            lagging: false,
            lagging_until: 0,
            lags: 0,
            waited_since: None,
            silent: 0,
            echo: None,
            delivery_rate: DeliveryRate::new(now),
            received_bytes: 0,
            needless_bytes: 0,
            ce: 0,
            arrived: sent,
            progress_at: now,
            repairs: RepairBudget::new(now, fresh),
            suspicion: Suspicion::default(),
            reported_since: now,
            lost: 0,
        }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn has_room(&self, sent: u64) -> bool {
        self.under_way(sent) < self.path.window()
    }

    pub fn is_live(&self) -> bool {
        self.silent < SILENT
    }

    pub fn acknowledged(&self) -> u64 {
        self.acknowledged
    }

    /// Returns whether the history retains messages until this reader has them.
    pub fn is_waited_for(&self) -> bool {
        self.is_live() && !self.lagging
    }

    /// Returns the bytes in flight to the reader, of `sent` bytes in total.
    pub fn under_way(&self, sent: u64) -> u64 {
        sent - self.arrived
    }

    /// Returns the time when bytes in flight count as lost. `last` is the time of the last
    /// transmission.
    pub fn overdue_at(&self, last: u64) -> u64 {
        self.progress_at.max(last).saturating_add(self.path.timeout_factor())
    }

    /// Counts all bytes in flight as lost, because no report arrived. The path may be gone.
    pub fn forget_under_way(&mut self, now: u64, sent: u64) {
        self.path.on_silence(self.under_way(sent));
        self.arrived = sent;
        self.progress_at = now;
    }

    /// Processes a report. Returns the number of frames with a mark since the previous report, and
    /// whether the path now counts as congested.
    pub fn on_report(&mut self, now: u64, report: &Report, log: &SentLog, outbox: &Outbox, sent: u64) -> (u64, bool) {
        if self.path.is_silent() {
            self.reported_since = now;
        }
        self.silent = 0;
        self.acknowledged = self.acknowledged.max(report.acknowledged.min(outbox.last()));
        let half = outbox.oldest().midpoint(outbox.last());
        if self.acknowledged >= half {
            self.waited_since = None;
            self.lagging &= now < self.lagging_until;
        }
        let Some(echo) = report.echo.and_then(|position| log.find(position)) else { return (0, false) };
        let repeated = report.echo.and_then(|position| outbox.repeated(position));
        let arrived = repeated.map_or(echo.total, |repeated| repeated.total);
        let before = self.arrived;
        if arrived > self.arrived {
            (self.arrived, self.progress_at) = (arrived.min(sent), now);
        }
        // A reader's claim to have received more than was sent is ignored.
        let most = sent.saturating_sub(self.echo.map_or(0, |echo| echo.total).min(before));
        let delivered = report.received_bytes.saturating_sub(self.received_bytes).min(most);
        // A repair echoes its first transmission.
        let latest = self.echo.filter(|before| before.total > echo.total).unwrap_or(echo);
        let rate = self.delivery_rate.add(now, delivered, &latest);
        let sample = Sample {
            rtt: (repeated.is_none() && arrived > before)
                .then(|| now.saturating_sub(echo.at).saturating_sub(report.delay)),
            delivered,
            rate,
            paused: self.echo.is_some_and(|before| before.pauses != echo.pauses),
            lost: std::mem::take(&mut self.lost),
            needless: report.needless_bytes.saturating_sub(self.needless_bytes).min(most),
            marks: u64::from(report.ce.wrapping_sub(self.ce)).min(1 << 16),
            acknowledged: self.arrived,
            sent,
        };
        let congested = self.path.on_report(now, &sample);
        if congested {
            self.reported_since = now;
        }
        (self.received_bytes, self.ce) = (report.received_bytes, report.ce);
        self.needless_bytes = report.needless_bytes;
        if self.echo.is_none_or(|before| echo.total > before.total) {
            self.echo = Some(echo);
        }
        (sample.marks, congested)
    }

    /// Pays for a repair of `bytes` bytes, if it is within the reader's budget.
    pub fn pay(&mut self, now: u64, bytes: u64, fresh: Fresh) -> bool {
        self.repairs.pay(now, bytes, fresh, self.lagging)
    }

    /// Records that the reader requested `bytes` bytes, which were sent at `sent_at`.
    pub fn on_lost(&mut self, bytes: u64, sent_at: u64) {
        if sent_at >= self.reported_since {
            self.lost += bytes;
        }
    }
}

/// All readers of a topic.
#[derive(Debug, Default)]
pub struct Peers(BTreeMap<Name, ReaderState>);

impl Peers {
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn get(&self, reader: &Name) -> Option<&ReaderState> {
        self.0.get(reader)
    }

    pub fn get_mut(&mut self, reader: &Name) -> Option<&mut ReaderState> {
        self.0.get_mut(reader)
    }

    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Adds a reader, unless it is there already. Returns false if there are too many.
    pub fn join(&mut self, reader: Name, peer: ReaderState) -> bool {
        if self.0.len() >= MOST_PEERS && !self.0.contains_key(&reader) {
            return false;
        }
        self.0.entry(reader).or_insert(peer);
        true
    }

    /// Replaces the state of a reader that has restarted. What limits it remains, so that restarts
    /// do not evade it. Returns false if there is no such reader.
    pub fn restart(&mut self, reader: &Name, peer: ReaderState) -> bool {
        let Some(known) = self.0.get_mut(reader) else { return false };
        let ReaderState { repairs, lags, lagging_until, .. } = *known;
        *known = ReaderState { repairs, lags, lagging_until, ..peer };
        true
    }

    pub fn leave(&mut self, reader: &Name) {
        self.0.remove(reader);
    }

    /// Returns the live reader with room in flight that has the fastest path.
    pub fn leader(&self, now: u64, sent: u64) -> Option<Name> {
        let open = self.0.iter().filter(|(_, peer)| peer.is_live() && peer.has_room(sent));
        open.max_by_key(|(_, peer)| peer.path.rate(now)).map(|(name, _)| *name)
    }

    pub fn any_live(&self) -> bool {
        self.0.values().any(ReaderState::is_live)
    }

    pub fn live(&mut self) -> impl Iterator<Item = &mut ReaderState> {
        self.0.values_mut().filter(|peer| peer.is_live())
    }

    /// Returns the last sequence that all awaited readers have. If all readers lag, the most
    /// advanced of them counts.
    pub fn acknowledged(&self) -> u64 {
        let waited_for = self.0.values().filter(|peer| peer.is_waited_for()).map(ReaderState::acknowledged).min();
        waited_for.unwrap_or_else(|| self.first_acknowledged())
    }

    /// Returns the last sequence that any live reader has.
    pub fn first_acknowledged(&self) -> u64 {
        self.0.values().filter(|peer| peer.is_live()).map(ReaderState::acknowledged).max().unwrap_or(u64::MAX)
    }

    /// Returns the live readers that lack messages up to this sequence, and how many.
    pub fn lacking(&self, sequence: u64) -> impl Iterator<Item = (Name, u64)> {
        let live = self.0.iter().filter(|(_, peer)| peer.is_live());
        let lacks = move |(name, peer): (&Name, &ReaderState)| (*name, sequence.saturating_sub(peer.acknowledged));
        live.map(lacks).filter(|(_, count)| *count > 0)
    }

    /// Returns whether any reader, live or not, lacks a message up to this sequence.
    pub fn lacks(&self, sequence: u64) -> bool {
        self.0.values().any(|peer| peer.acknowledged < sequence)
    }

    /// Waits for the readers that lack this sequence, on behalf of a publisher. A reader that has
    /// been awaited too long becomes lagging, for longer each time. Returns the time when the next
    /// reader becomes lagging.
    pub fn wait(&mut self, now: u64, sequence: u64) -> u64 {
        // If no reader has the sequence, the cause is not a single slow reader.
        if self.first_acknowledged() < sequence {
            return u64::MAX;
        }
        let mut next = u64::MAX;
        for peer in self.0.values_mut().filter(|peer| peer.is_waited_for() && peer.acknowledged < sequence) {
            let since = *peer.waited_since.get_or_insert(now);
            let until = since.saturating_add(peer.path.repair_time());
            if until > now {
                next = next.min(until);
                continue;
            }
            (peer.lagging, peer.waited_since) = (true, None);
            peer.lagging_until = now + (LAG << peer.lags.min(6));
            peer.lags += 1;
        }
        next
    }

    /// Returns the last sequence that all live readers have.
    pub fn acknowledged_by_all(&self) -> u64 {
        self.0.values().filter(|peer| peer.is_live()).map(ReaderState::acknowledged).min().unwrap_or(u64::MAX)
    }

    /// Performs one check for silent readers, while frames are being sent.
    pub fn look(&mut self) {
        self.0.values_mut().for_each(|peer| peer.silent = peer.silent.saturating_add(1));
    }
}

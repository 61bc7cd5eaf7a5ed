//! The messages of one topic at the writer: waiting, in progress, and sent ones that may be
//! requested again.

use std::collections::VecDeque;
use std::sync::Arc;

use super::history::{History, LARGE, Overflow, Reliability, STALE, TopicCounters};
use super::{Position, Sealed};
use crate::feedback_wire::Missing;

/// A frame payload to send.
#[derive(Clone, Debug)]
pub struct Chosen {
    pub message: Arc<Sealed>,
    pub frame: usize,
    pub repair: bool,
}

/// Maximum number of remembered ranges that will not be sent. Readers give older ones up together
/// with messages that can no longer be repaired.
const MOST_SKIPPED: usize = 256;

/// Maximum number of waiting repairs, of all readers together.
const MOST_REPAIRS: usize = 1 << 14;

/// The last retransmission of a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Repeated {
    /// 0: never.
    pub at: u64,
    /// Bytes of the topic sent up to then.
    pub total: u64,
    queued: bool,
}

#[derive(Debug)]
struct QueuedMessage {
    message: Arc<Sealed>,
    pushed: u64,
    /// Frames that were sent or skipped.
    sent: usize,
    /// When the last frame was sent for the first time.
    completed: u64,
    /// Retransmissions by frame, from the first request on.
    repeated: Vec<Repeated>,
    /// Whether its frames are too large and are being resealed.
    resealing: bool,
}

impl QueuedMessage {
    fn is_sent(&self) -> bool {
        self.sent == self.message.frames()
    }

    fn messages(&self) -> u64 {
        self.message.last() - self.message.first() + 1
    }

    fn is_large(&self) -> bool {
        self.messages() == 1 && self.message.total_bytes() >= LARGE
    }
}

#[derive(Debug)]
pub struct Outbox {
    reliability: Reliability,
    history: History,
    /// Entries in the order of sequences.
    entries: VecDeque<QueuedMessage>,
    bytes: usize,
    /// Number of messages in the entries.
    messages: u64,
    last: u64,
    /// All entries before this index have been sent.
    cursor: usize,
    /// Repairs: the first sequence of the entry, and the frame.
    repairs: VecDeque<(u64, u32)>,
    /// Whether a repair is next, if both a repair and a new frame wait.
    repair_next: bool,
    to_reseal: VecDeque<Arc<Sealed>>,
    /// The latest ranges of sequences that will not be sent, or not again.
    skipped: VecDeque<(u64, u64)>,
    counters: TopicCounters,
}

impl Outbox {
    pub fn new(reliability: Reliability, history: History) -> Self {
        Self {
            reliability,
            history,
            entries: VecDeque::new(),
            bytes: 0,
            messages: 0,
            last: 0,
            cursor: 0,
            repairs: VecDeque::new(),
            repair_next: true,
            to_reseal: VecDeque::new(),
            skipped: VecDeque::new(),
            counters: TopicCounters::default(),
        }
    }

    pub fn counters(&self) -> &TopicCounters {
        &self.counters
    }

    pub fn count_congestion(&mut self, marked: u64, slowed: bool) {
        self.counters.marked += marked;
        self.counters.slowed += u64::from(slowed);
    }

    pub fn is_reliable(&self) -> bool {
        matches!(self.reliability, Reliability::Reliable { .. })
    }

    /// Returns the last pushed sequence; 0 before the first.
    pub fn last(&self) -> u64 {
        self.last
    }

    /// Returns the last sequence up to which all messages were sent or skipped.
    pub fn sent_through(&self) -> u64 {
        self.entries
            .iter()
            .skip(self.cursor)
            .find(|entry| !entry.is_sent())
            .map_or(self.last, |entry| entry.message.first() - 1)
    }

    /// Returns the number of messages that were not sent completely.
    pub fn unsent(&self) -> u64 {
        self.entries.iter().skip(self.cursor).filter(|entry| !entry.is_sent()).map(QueuedMessage::messages).sum()
    }

    /// Returns the first sequence that can still be repaired.
    pub fn oldest(&self) -> u64 {
        self.entries.front().map_or(self.last + 1, |entry| entry.message.first())
    }

    /// If this sequence will never be sent, returns the first later sequence outside the skipped
    /// range.
    pub fn skips(&self, sequence: u64) -> Option<u64> {
        let (_, last) = self.skipped.iter().find(|(first, last)| (first..=last).contains(&&sequence))?;
        Some(last + 1)
    }

    /// Records that this entry will not be sent, or not again.
    fn skip(&mut self, index: usize) {
        let message = &self.entries[index].message;
        match self.skipped.back_mut() {
            Some((_, last)) if *last + 1 == message.first() => *last = message.last(),
            _ => self.skipped.push_back((message.first(), message.last())),
        }
        if self.skipped.len() > MOST_SKIPPED {
            self.skipped.pop_front();
        }
    }

    /// Returns whether `messages` messages of `bytes` bytes have room, possibly after removing the
    /// oldest entry.
    pub fn has_room(&self, messages: u64, bytes: usize, acknowledged: u64) -> bool {
        let oldest_may_go = |entry: &QueuedMessage| entry.is_sent() && entry.message.last() <= acknowledged;
        let full = self.messages + messages > self.history.messages as u64 || self.bytes + bytes > self.history.bytes;
        !full || self.entries.is_empty() || self.entries.front().is_some_and(oldest_may_go)
    }

    /// Returns whether messages wait that are not yet in progress.
    pub fn has_waiting(&self) -> bool {
        self.begun() < self.entries.len()
    }

    /// Returns the last sequence of the oldest entry, if it was sent.
    pub fn oldest_sent(&self) -> Option<u64> {
        self.entries.front().filter(|oldest| oldest.is_sent()).map(|oldest| oldest.message.last())
    }

    /// Adds a message. `acknowledged` is the last sequence of all awaited readers, `by_all` that of
    /// all live readers. Returns the message if the caller must wait.
    pub fn push(&mut self, now: u64, message: Sealed, acknowledged: u64, by_all: u64) -> Result<(), Sealed> {
        debug_assert!(message.first() > self.last);
        let count = message.last() - message.first() + 1;
        let fits =
            |outbox: &Self| outbox.bytes + message.total_bytes() <= outbox.history.bytes || outbox.entries.is_empty();
        match self.reliability {
            Reliability::BestEffort { lifetime } => {
                self.expire(now, lifetime);
                while self.entries.len() - self.begun() >= self.history.messages.max(1) {
                    self.drop_entry(self.begun());
                }
                while !fits(self) {
                    // Drops sent entries first, then waiting ones, and the one in progress last.
                    let begun = self.begun();
                    let next = if self.cursor == 0 && begun < self.entries.len() { begun } else { 0 };
                    self.drop_entry(next);
                }
            }
            Reliability::Reliable { overflow } => {
                while self.messages + count > self.history.messages as u64 || !fits(self) {
                    let Some(oldest) = self.entries.front() else { break };
                    let may_go = oldest.is_sent() && oldest.message.last() <= acknowledged;
                    if !may_go && overflow == Overflow::Block {
                        return Err(message);
                    }
                    // An entry in progress is useful only as a whole, so waiting entries are
                    // dropped first.
                    let goes = oldest.sent > 0 && !oldest.is_sent();
                    let index = usize::from(goes && self.entries.len() > 1);
                    let gives_way = &self.entries[index];
                    if !gives_way.is_sent() || gives_way.message.last() > by_all {
                        self.counters.evicted += gives_way.messages();
                    }
                    if gives_way.sent == 0 {
                        self.skip(index);
                    }
                    self.remove(index);
                }
            }
        }
        self.counters.messages += count;
        self.messages += count;
        self.last = message.last();
        self.bytes += message.total_bytes();
        let message = Arc::new(message);
        self.entries.push_back(QueuedMessage {
            message,
            pushed: now,
            sent: 0,
            completed: 0,
            repeated: Vec::new(),
            resealing: false,
        });
        Ok(())
    }

    /// Marks all waiting messages as sent, because there are no readers.
    pub fn skip_all(&mut self) {
        self.skip_before(u64::MAX);
    }

    /// Marks waiting messages before this sequence as sent, because no reader wants them.
    pub fn skip_before(&mut self, sequence: u64) {
        let unwanted = self.entries.partition_point(|entry| entry.message.last() < sequence);
        for entry in self.entries.iter_mut().take(unwanted) {
            entry.sent = entry.message.frames();
            entry.repeated.iter_mut().for_each(|repeated| repeated.queued = false);
        }
        self.repairs.retain(|(first, _)| *first >= sequence);
        self.cursor = self.cursor.max(unwanted);
    }

    /// Returns the next frame payload, in frames of at most `max_payload` bytes.
    pub fn choose(&mut self, now: u64, max_payload: usize) -> Option<Chosen> {
        match self.reliability {
            Reliability::BestEffort { lifetime } => self.expire(now, lifetime),
            Reliability::Reliable { overflow: Overflow::DropOldest { keep_last } } => self.drop_stale(now, keep_last),
            Reliability::Reliable { overflow: Overflow::Block } => {}
        }
        let fresh = self.fresh(max_payload);
        if (self.repair_next || fresh.is_none())
            && let Some(repair) = self.repair(max_payload)
        {
            return Some(repair);
        }
        fresh
    }

    /// Records the transmission of the chosen payload. `total` is the number of bytes of the topic
    /// sent, including this payload.
    pub fn take(&mut self, now: u64, chosen: &Chosen, total: u64) {
        self.counters.frames += 1;
        let Some(index) = self.find(chosen.message.first()) else { return };
        let entry = &mut self.entries[index];
        if chosen.repair {
            self.repairs.pop_front();
            self.counters.repeated += 1;
            entry.repeated[chosen.frame] = Repeated { at: now, total, queued: false };
        } else {
            entry.sent = chosen.frame + 1;
            entry.completed = now;
            self.advance();
        }
        self.repair_next = !chosen.repair;
    }

    /// Returns the next message that must be sealed for smaller frames. Returns each message once.
    pub fn next_to_reseal(&mut self) -> Option<Arc<Sealed>> {
        self.to_reseal.pop_front()
    }

    /// Replaces messages by the same ones in smaller frames, which are sent from the start. Does
    /// nothing if the messages have left the history.
    pub fn resealed(&mut self, message: Sealed) {
        let Some(index) = self.find(message.first()) else { return };
        let entry = &mut self.entries[index];
        if entry.message.last() != message.last() || entry.message.cut() >= message.cut() {
            return;
        }
        self.bytes = self.bytes - entry.message.total_bytes() + message.total_bytes();
        let first = message.first();
        *entry = QueuedMessage {
            message: Arc::new(message),
            pushed: entry.pushed,
            sent: 0,
            completed: 0,
            repeated: Vec::new(),
            resealing: false,
        };
        self.repairs.retain(|(of, _)| *of != first);
        self.cursor = self.cursor.min(index);
    }

    /// Drops messages that cannot be sealed again.
    pub fn abandon(&mut self, first: u64) {
        if let Some(index) = self.find(first) {
            self.counters.evicted += self.entries[index].messages();
            self.remove(index);
        }
    }

    /// Queues the segments that a reader lacks. Segments from `in_flight` on, and repairs sent
    /// after `too_early`, are still in flight to the reader. `pay` returns whether a frame of its
    /// length is within the reader's budget. Returns the bytes queued for this reader.
    pub fn ask(
        &mut self,
        range: &Missing,
        too_early: u64,
        in_flight: Option<Position>,
        mut pay: impl FnMut(u64) -> bool,
    ) -> u64 {
        let Some(index) = self.find(range.sequence) else { return 0 };
        let entry = &mut self.entries[index];
        let message = &entry.message;
        let other_cut = range.cut != message.cut() && *range != Missing::whole(range.sequence);
        let (from, to) = if other_cut { (0, u32::MAX) } else { (range.first, range.last().unwrap_or(u32::MAX)) };
        let frame_of = |index| message.frame_of(Position { sequence: range.sequence, index });
        let frames = frame_of(from)..frame_of(to) + 1;
        if entry.repeated.is_empty() {
            entry.repeated.resize(message.frames(), Repeated::default());
        }
        let mut queued = 0;
        // Frames that are not yet sent will be sent anyway.
        for frame in frames.start..frames.end.min(entry.sent) {
            let repeated = &mut entry.repeated[frame];
            let is_in_flight = in_flight.is_some_and(|from| message.position(frame) >= from);
            if repeated.queued || (repeated.at == 0 && is_in_flight) || repeated.at > too_early {
                continue;
            }
            let bytes = message.len(frame) as u64;
            if self.repairs.len() >= MOST_REPAIRS || !pay(bytes) {
                self.counters.over_budget += 1;
                break;
            }
            repeated.queued = true;
            queued += bytes;
            self.repairs.push_back((message.first(), frame as u32));
        }
        queued
    }

    /// Returns the length of the frame payload with this segment, if it is available and was sent.
    pub fn len_of(&self, position: Position) -> Option<usize> {
        let entry = &self.entries[self.find(position.sequence)?];
        let frame = entry.message.frame_of(position);
        (frame < entry.sent).then(|| entry.message.len(frame))
    }

    /// Returns the last retransmission of the frame with this segment.
    pub fn repeated(&self, position: Position) -> Option<Repeated> {
        let entry = &self.entries[self.find(position.sequence)?];
        entry.repeated.get(entry.message.frame_of(position)).copied().filter(|repeated| repeated.at > 0)
    }

    /// Returns the index of the first entry that is not yet in progress.
    fn begun(&self) -> usize {
        let going = self.entries.get(self.cursor).is_some_and(|entry| entry.sent > 0);
        self.cursor + usize::from(going)
    }

    /// Moves the cursor behind what was sent.
    fn advance(&mut self) {
        while self.entries.get(self.cursor).is_some_and(QueuedMessage::is_sent) {
            self.cursor += 1;
        }
    }

    fn fresh(&mut self, max_payload: usize) -> Option<Chosen> {
        for entry in self.entries.iter_mut().skip(self.cursor) {
            if entry.is_sent() || entry.resealing {
                continue;
            }
            if entry.message.largest() > max_payload {
                entry.resealing = true;
                self.to_reseal.push_back(entry.message.clone());
                continue;
            }
            return Some(Chosen { message: entry.message.clone(), frame: entry.sent, repair: false });
        }
        None
    }

    fn repair(&mut self, max_payload: usize) -> Option<Chosen> {
        while let Some(&(sequence, frame)) = self.repairs.front() {
            if let Some(index) = self.find(sequence) {
                let entry = &mut self.entries[index];
                if entry.message.largest() <= max_payload && !entry.resealing {
                    return Some(Chosen { message: entry.message.clone(), frame: frame as usize, repair: true });
                }
                if !entry.resealing {
                    entry.resealing = true;
                    self.to_reseal.push_back(entry.message.clone());
                }
            }
            self.repairs.pop_front();
        }
        None
    }

    /// Returns the index of the entry with this sequence.
    fn find(&self, sequence: u64) -> Option<usize> {
        let index = self.entries.partition_point(|entry| entry.message.last() < sequence);
        self.entries.get(index).filter(|entry| entry.message.first() <= sequence).map(|_| index)
    }

    /// Drops stale messages of which a frame would be next, while newer ones wait. A message in
    /// progress stays, because it is useful only as a whole.
    ///
    /// Of those that wait, it drops all but the newest `keep_last` at once: a reader learns of each
    /// gap in a round trip of its own.
    fn drop_stale(&mut self, now: u64, keep_last: usize) {
        let repaired = self.repairs.front().and_then(|(sequence, _)| self.find(*sequence));
        if let Some(index) = repaired.filter(|index| self.is_stale(now, *index, keep_last)) {
            self.evict(index);
        }
        let waiting = self.begun();
        if !self.is_stale(now, waiting, keep_last) {
            return;
        }
        while self.entries.len() - waiting > keep_last.max(1)
            && self.entries.get(waiting).is_some_and(|entry| entry.sent == 0 && entry.is_large())
        {
            self.evict(waiting);
        }
    }

    fn is_stale(&self, now: u64, index: usize, keep_last: usize) -> bool {
        let Some(entry) = self.entries.get(index) else { return false };
        // Readers ask for what they lack of a message when they have seen the rest of it.
        let since = if entry.is_sent() { entry.completed } else { entry.pushed };
        now.saturating_sub(since) > STALE
            && self.entries.len() - index > keep_last
            && entry.is_large()
            && (entry.is_sent() || entry.sent == 0)
            && self.entries.iter().skip(index + 1).any(|newer| !newer.is_sent())
    }

    /// Drops a message that some reader lacks.
    fn evict(&mut self, index: usize) {
        self.counters.evicted += self.entries[index].messages();
        self.skip(index);
        self.remove(index);
    }

    fn expire(&mut self, now: u64, lifetime: u64) {
        while self.entries.front().is_some_and(|entry| now.saturating_sub(entry.pushed) > lifetime) {
            let entry = &self.entries[0];
            if !entry.is_sent() {
                self.counters.expired += entry.messages();
            }
            self.remove(0);
        }
    }

    fn drop_entry(&mut self, index: usize) {
        let entry = &self.entries[index];
        if !entry.is_sent() {
            self.counters.replaced += entry.messages();
        }
        self.remove(index);
    }

    fn remove(&mut self, index: usize) {
        if let Some(entry) = self.entries.remove(index) {
            self.bytes -= entry.message.total_bytes();
            self.messages -= entry.messages();
            if index < self.cursor {
                self.cursor -= 1;
            }
            self.advance();
            if self.entries.is_empty() {
                self.repairs.clear();
            }
        }
    }
}

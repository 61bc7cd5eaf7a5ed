//! The messages of one topic at the writer: those that wait, the one that goes, and those that went
//! and may be asked for again.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::Serialize;

use super::{Position, Sealed};
use crate::feedback_wire::Missing;

/// What a topic promises.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// Of messages that wait, the newest; and of a message, nothing more once it is `lifetime`
    /// nanoseconds old.
    BestEffort { lifetime: u64 },
    /// Every message, as long as the history has it.
    Reliable { overflow: Overflow },
}

/// What a reliable topic does when its history is full of messages that a reader still lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// The publisher waits. A reader that falls behind is waited for once, for a while, and no
    /// longer.
    Block,
    /// The oldest message goes, and is counted.
    DropOldest,
}

/// How much a topic keeps. A message that is larger than all of it is taken if nothing else is
/// there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct History {
    /// Best effort: of messages that have not begun to go; those under one signature count as one.
    /// Reliable: of all.
    pub messages: usize,
    pub bytes: usize,
}

/// What became of a topic's messages and frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TopicCounters {
    pub messages: u64,
    /// Messages that newer ones replaced before all their frames had gone.
    pub replaced: u64,
    /// Messages whose lifetime ended before all their frames had gone.
    pub expired: u64,
    /// Messages of a reliable topic that went from the history before every live reader had them.
    pub evicted: u64,
    /// Frame payloads sent, those sent again included; several that share a frame count one each.
    pub frames: u64,
    pub repeated: u64,
    /// Asked for by a reader beyond its budget.
    pub over_budget: u64,
    /// Frames that readers say came with a congestion mark.
    pub marked: u64,
    /// Times that a path was taken to be congested, and less was sent.
    pub slowed: u64,
}

/// A frame payload that goes.
#[derive(Clone, Debug)]
pub struct Chosen {
    pub message: Arc<Sealed>,
    pub frame: usize,
    pub repair: bool,
}

/// Ranges that are remembered of what never went; readers that lack older ones give them up with
/// what can be repaired no more.
const MOST_SKIPPED: usize = 256;

/// Frames that wait to go again, of all readers together.
const MOST_REPAIRS: usize = 1 << 14;

/// When a frame went again.
#[derive(Clone, Copy, Debug, Default)]
pub struct Repeated {
    /// 0: never.
    pub at: u64,
    /// Bytes of the topic that had gone by then.
    pub total: u64,
    queued: bool,
}

#[derive(Debug)]
struct QueuedMessage {
    message: Arc<Sealed>,
    pushed: u64,
    /// Frames that went, or will not any more.
    sent: usize,
    /// By frame, once one is asked for again.
    repeated: Vec<Repeated>,
    /// Its frames are too large; smaller ones are being made.
    resealing: bool,
}

impl QueuedMessage {
    fn is_sent(&self) -> bool {
        self.sent == self.message.frames()
    }

    fn messages(&self) -> u64 {
        self.message.last() - self.message.first() + 1
    }
}

#[derive(Debug)]
pub struct Outbox {
    reliability: Reliability,
    history: History,
    /// In the order of sequences.
    entries: VecDeque<QueuedMessage>,
    bytes: usize,
    /// Messages in the entries.
    messages: u64,
    last: u64,
    /// Entries before this one have all been sent.
    cursor: usize,
    /// First sequence of the entry, and frame.
    repairs: VecDeque<(u64, u32)>,
    /// Whose turn it is if both have something.
    repair_next: bool,
    to_reseal: VecDeque<Arc<Sealed>>,
    /// Ranges of sequences that never went, the latest ones.
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

    /// The last sequence ever pushed; 0 before there is one.
    pub fn last(&self) -> u64 {
        self.last
    }

    /// All messages up to this sequence have gone, as far as they will.
    pub fn sent_through(&self) -> u64 {
        self.entries
            .iter()
            .skip(self.cursor)
            .find(|entry| !entry.is_sent())
            .map_or(self.last, |entry| entry.message.first() - 1)
    }

    /// Messages that wait to go, or have not gone whole.
    pub fn unsent(&self) -> u64 {
        self.entries.iter().skip(self.cursor).filter(|entry| !entry.is_sent()).map(QueuedMessage::messages).sum()
    }

    /// The first sequence that can still be repaired.
    pub fn oldest(&self) -> u64 {
        self.entries.front().map_or(self.last + 1, |entry| entry.message.first())
    }

    /// If nothing of this sequence ever goes: the first one after it of which that is not so.
    pub fn skips(&self, sequence: u64) -> Option<u64> {
        let (_, last) = self.skipped.iter().find(|(first, last)| (first..=last).contains(&&sequence))?;
        Some(last + 1)
    }

    /// Nothing has gone of this entry, and nothing will.
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

    /// Whether so many messages, of so many bytes, find room, or the oldest may go for them.
    pub fn has_room(&self, messages: u64, bytes: usize, acknowledged: u64) -> bool {
        let oldest_may_go = |entry: &QueuedMessage| entry.is_sent() && entry.message.last() <= acknowledged;
        let full = self.messages + messages > self.history.messages as u64 || self.bytes + bytes > self.history.bytes;
        !full || self.entries.is_empty() || self.entries.front().is_some_and(oldest_may_go)
    }

    /// Whether messages wait that have not begun to go.
    pub fn has_waiting(&self) -> bool {
        self.begun() < self.entries.len()
    }

    /// The last sequence of the oldest message, if that has gone.
    pub fn oldest_sent(&self) -> Option<u64> {
        self.entries.front().filter(|oldest| oldest.is_sent()).map(|oldest| oldest.message.last())
    }

    /// `acknowledged`: what every reader that is waited for has; `by_all`: what every live one has.
    /// Gives the message back if the caller has to wait.
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
                    // What has gone goes first; what goes at the moment, last.
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
                    // What goes at the moment is of use only whole: what waits behind it gives way
                    // first.
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
        self.entries.push_back(QueuedMessage { message, pushed: now, sent: 0, repeated: Vec::new(), resealing: false });
        Ok(())
    }

    /// Nobody is there to send to: what waits counts as sent.
    pub fn skip_all(&mut self) {
        self.entries.iter_mut().for_each(|entry| entry.sent = entry.message.frames());
        self.repairs.clear();
        self.cursor = self.entries.len();
    }

    /// What goes next, in frames of at most `max_payload` bytes.
    pub fn choose(&mut self, now: u64, max_payload: usize) -> Option<Chosen> {
        if let Reliability::BestEffort { lifetime } = self.reliability {
            self.expire(now, lifetime);
        }
        let fresh = self.fresh(max_payload);
        if (self.repair_next || fresh.is_none())
            && let Some(repair) = self.repair(max_payload)
        {
            return Some(repair);
        }
        fresh
    }

    /// What was chosen goes. `total`: bytes of the topic that have gone, these included.
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
            while self.entries.get(self.cursor).is_some_and(QueuedMessage::is_sent) {
                self.cursor += 1;
            }
        }
        self.repair_next = !chosen.repair;
    }

    /// A message that must be sealed for smaller frames, once.
    pub fn next_to_reseal(&mut self) -> Option<Arc<Sealed>> {
        self.to_reseal.pop_front()
    }

    /// The same messages in smaller frames; they are sent from their beginning. Nothing happens if
    /// they are gone by now.
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
            repeated: Vec::new(),
            resealing: false,
        };
        self.repairs.retain(|(of, _)| *of != first);
        self.cursor = self.cursor.min(index);
    }

    /// Messages that cannot be sealed again are lost.
    pub fn abandon(&mut self, first: u64) {
        if let Some(index) = self.find(first) {
            self.counters.evicted += self.entries[index].messages();
            self.remove(index);
        }
    }

    /// Queues what a reader lacks. `too_early`: what went again later than this is on its way to
    /// the reader already. `pay` is asked with the bytes of each frame whether the reader may have
    /// it. Returns the bytes queued for this reader.
    pub fn ask(&mut self, range: &Missing, too_early: u64, mut pay: impl FnMut(u64) -> bool) -> u64 {
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
        // What has not gone yet is on its way anyway.
        for frame in frames.start..frames.end.min(entry.sent) {
            let repeated = &mut entry.repeated[frame];
            if repeated.queued || (repeated.at > 0 && repeated.at > too_early) {
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

    /// Bytes of the frame payload with this segment, if it is here and went.
    pub fn len_of(&self, position: Position) -> Option<usize> {
        let entry = &self.entries[self.find(position.sequence)?];
        let frame = entry.message.frame_of(position);
        (frame < entry.sent).then(|| entry.message.len(frame))
    }

    /// When the frame with this segment went again, if ever.
    pub fn repeated(&self, position: Position) -> Option<Repeated> {
        let entry = &self.entries[self.find(position.sequence)?];
        entry.repeated.get(entry.message.frame_of(position)).copied().filter(|repeated| repeated.at > 0)
    }

    /// The first entry that has not begun to go.
    fn begun(&self) -> usize {
        let going = self.entries.get(self.cursor).is_some_and(|entry| entry.sent > 0);
        self.cursor + usize::from(going)
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

    /// The entry with this sequence.
    fn find(&self, sequence: u64) -> Option<usize> {
        let index = self.entries.partition_point(|entry| entry.message.last() < sequence);
        self.entries.get(index).filter(|entry| entry.message.first() <= sequence).map(|_| index)
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
            if self.entries.is_empty() {
                self.repairs.clear();
            }
        }
    }
}

//! The writer's state of a topic: the next frame and its time, and the feedback of readers.

use gdp_wire::Name;

use super::black_hole::{FrameLimit, LEAST_PAYLOAD};
use super::history::{History, Overflow, Reliability};
use super::meter::{Meter, Recent, nanoseconds};
use super::outbox::{Chosen, Outbox};
use super::peers::{Peers, ReaderState, Report, SILENCE_STEP};
use super::repair_budget::Fresh;
use super::sent_log::{Sent, SentLog};
use super::{MS, Position, Sealed};
use crate::feedback_wire::{Feedback, MAX_MISSING, Missing};

/// Heartbeats start this long after the last frame. The interval doubles up to
/// [`SLOWEST_HEARTBEAT`].
const FIRST_HEARTBEAT: u64 = 100 * MS;
const SLOWEST_HEARTBEAT: u64 = 1_000 * MS;

/// Burst that compensates for late timers. [`MOST_LATE`] is for threads.
const BURST: u64 = MS / 4;
const BURST_BYTES: u64 = 2 * 1500;

/// A thread that had no processor sends at once what it would have sent meanwhile, of this time in
/// nanoseconds at most. Otherwise a thread with a third of a processor would send at a third of the
/// rate. The rate measured next would be lower still.
const MOST_LATE: u64 = 25 * MS;

/// If other topics of the uplink delay a topic for longer, its samples say nothing about the path.
const HELD_UP: u64 = 20 * MS;

/// The options of a publisher for its topic.
#[derive(Clone, Copy, Debug)]
pub struct TopicOptions {
    pub reliability: Reliability,
    pub history: History,
    /// 0 to 7; higher ones go first.
    pub class: u8,
    /// Whether frames are also sent on a second uplink.
    pub doubled: bool,
}

impl TopicOptions {
    /// Returns options for the newest message, with a lifetime of 200 ms.
    pub fn best_effort() -> Self {
        let history = History { messages: 8, bytes: 64 << 20 };
        Self { reliability: Reliability::BestEffort { lifetime: 200 * MS }, history, class: 3, doubled: false }
    }

    /// Returns options for the last 1024 messages. The publisher waits when the history is full.
    pub fn reliable() -> Self {
        let history = History { messages: 1024, bytes: 64 << 20 };
        Self { reliability: Reliability::Reliable { overflow: Overflow::Block }, history, class: 3, doubled: false }
    }
}

/// The time of a topic's next action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TopicTurn {
    pub may_send: bool,
    /// Time of the next poll or timer. `u64::MAX`: only after another input.
    pub at: u64,
}

#[derive(Debug)]
pub struct TopicState {
    pub name: Name,
    pub session: [u8; 16],
    pub options: TopicOptions,
    pub outbox: Outbox,
    peers: Peers,
    /// Represents the readers while none of them is live.
    nobody: ReaderState,
    log: SentLog,
    /// Bytes of payload sent.
    sent: u64,
    sent_at: u64,
    pauses: u64,
    paused: bool,
    pace: Meter,
    /// The time at which the pace allows the next frame, if the topic waits for nothing else.
    paced_until: Option<u64>,
    /// Nanoseconds by which the sending thread came late for it, until they are made up for.
    late: u64,
    /// Bytes to send without pacing after a pause.
    at_once: u64,
    /// Bytes of first transmissions, in all and of late.
    fresh: u64,
    recent: Recent,
    /// The reader whose path determines the pace.
    leader: Option<Name>,
    heartbeat_at: u64,
    heartbeat_interval: u64,
    look_at: u64,
    waiting: Option<Waiting>,
    /// A publisher waits until its next message would not replace another.
    wants_turn: bool,
    limit: FrameLimit,
    /// Large frames were sent since the last report of a reception.
    large_unheard: bool,
}

/// The request of a publisher that waits for room.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    /// Number of messages that need room; `bytes` is their size.
    messages: u64,
    bytes: usize,
    /// When the publisher stops waiting for the next slow reader.
    again_at: u64,
}

/// The results of a topic's timers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Due {
    /// The sequence of the next message, and the oldest sequence that can be repaired.
    pub heartbeat: Option<(u64, u64)>,
    pub room: bool,
}

impl TopicState {
    pub fn new(now: u64, name: Name, session: [u8; 16], options: TopicOptions) -> Self {
        Self {
            name,
            session,
            options: TopicOptions { class: options.class.min(7), ..options },
            outbox: Outbox::new(options.reliability, options.history),
            peers: Peers::default(),
            nobody: ReaderState::new(now, 0, 0, 0),
            log: SentLog::default(),
            sent: 0,
            sent_at: now,
            pauses: 0,
            paused: true,
            pace: Meter::new(now),
            paced_until: None,
            late: 0,
            at_once: 0,
            fresh: 0,
            recent: Recent::new(now),
            leader: None,
            heartbeat_at: u64::MAX,
            heartbeat_interval: FIRST_HEARTBEAT,
            look_at: u64::MAX,
            waiting: None,
            wants_turn: false,
            limit: FrameLimit::default(),
            large_unheard: false,
        }
    }

    /// Returns the maximum payload of this topic's frames, on a link that supports `of_link` bytes.
    pub fn max_payload(&self, now: u64, of_link: usize) -> usize {
        of_link.min(self.limit.max_payload(now))
    }

    pub fn push(&mut self, now: u64, message: Sealed) -> Result<(), Sealed> {
        let result = self.outbox.push(now, message, self.peers.acknowledged(), self.peers.acknowledged_by_all());
        self.waiting = result.as_ref().err().map(|message| Waiting {
            messages: message.last() - message.first() + 1,
            bytes: message.total_bytes(),
            again_at: u64::MAX,
        });
        self.wait(now);
        if self.peers.is_empty() {
            self.outbox.skip_all();
        }
        result
    }

    /// Returns whether a new message would directly follow the current one. If not,
    /// [`Self::take_turn`] returns true when it would.
    pub fn has_turn(&mut self) -> bool {
        self.wants_turn = self.outbox.has_waiting();
        !self.wants_turn
    }

    /// Returns whether a publisher that waits for its turn has it now.
    pub fn take_turn(&mut self) -> bool {
        self.wants_turn && self.has_turn()
    }

    /// Returns the number of unsent messages, and the live readers with the number of messages they
    /// have not acknowledged.
    pub fn unfinished(&self) -> (u64, Vec<(Name, u64)>) {
        (self.outbox.unsent(), self.peers.lacking(self.outbox.last()).collect())
    }

    pub fn join(&mut self, now: u64, reader: Name) -> bool {
        let known = self.outbox.last();
        self.peers.join(reader, ReaderState::new(now, known, self.sent, self.fresh))
    }

    /// Starts the state of a restarted reader anew, which gets the messages from sequence `from`
    /// (at least 1) on. Returns true if this makes room for a waiting publisher.
    pub fn restart(&mut self, now: u64, reader: &Name, from: u64) -> bool {
        if !self.peers.restart(reader, ReaderState::new(now, from.saturating_sub(1), self.sent, self.fresh)) {
            return false;
        }
        self.leader = None;
        if self.peers.len() == 1 {
            // Nobody else wants what waited for the reader of before.
            self.outbox.skip_before(from);
        }
        self.wait(now);
        self.take_room()
    }

    /// Removes a reader. Returns true if this makes room for a waiting publisher.
    pub fn leave(&mut self, reader: &Name) -> bool {
        self.peers.leave(reader);
        self.leader = None;
        if self.peers.is_empty() {
            self.outbox.skip_all();
        }
        self.take_room()
    }

    /// Returns when the topic may send or needs its timers.
    pub fn turn(&mut self, now: u64, max_payload: usize) -> TopicTurn {
        let timers = self.heartbeat_at.min(self.look_at).min(self.waiting.map_or(u64::MAX, |waiting| waiting.again_at));
        if self.outbox.choose(now, max_payload).is_none() {
            if !self.paused {
                (self.paused, self.pauses) = (true, self.pauses + 1);
            }
            self.forget_lateness();
            return TopicTurn { may_send: false, at: timers };
        }
        let Some(rate) = self.find_rate(now) else {
            self.forget_lateness();
            return TopicTurn { may_send: false, at: timers.min(self.overdue_at()) };
        };
        let at_once = if self.paused { self.at_once_after_pause(now) } else { self.at_once };
        let paced = if at_once > 0 { now } else { self.pace.ready_at(BURST.max(nanoseconds(BURST_BYTES, rate))) };
        let may_send = paced <= now;
        if !may_send {
            (self.paced_until, self.late) = (Some(paced), 0);
        }
        TopicTurn { may_send, at: if may_send { timers } else { timers.min(paced) } }
    }

    /// Returns the next frame payload, if it has at most `room` bytes. `waited` is the time since
    /// it could be sent.
    pub fn take(&mut self, now: u64, max_payload: usize, room: usize, waited: u64) -> Option<Chosen> {
        let rate = self.find_rate(now)?;
        let chosen = self.outbox.choose(now, max_payload)?;
        let bytes = chosen.message.len(chosen.frame);
        if bytes > room {
            return None;
        }
        if let Some(until) = self.paced_until.take() {
            let most = self.leader().map_or(MOST_LATE, |leader| leader.path().catch_up(rate).min(MOST_LATE));
            self.late = now.saturating_sub(until).min(most);
        }
        if waited > HELD_UP {
            self.pauses += 1;
        }
        if self.paused {
            self.at_once = self.at_once_after_pause(now);
        }
        self.sent_at = now;
        self.sent += bytes as u64;
        self.large_unheard |= bytes > LEAST_PAYLOAD;
        self.paused = false;
        self.pace.take_late(now, (bytes as u64).saturating_sub(self.at_once), rate, self.late);
        self.at_once = self.at_once.saturating_sub(bytes as u64);
        if !chosen.repair {
            self.fresh += bytes as u64;
            self.recent.add(now, bytes as u64);
            let position = chosen.message.position(chosen.frame);
            let under_way = self.leader().unwrap_or(&self.nobody).under_way(self.sent);
            self.log.add(Sent { position, at: now, total: self.sent, pauses: self.pauses }, under_way);
        }
        self.outbox.take(now, &chosen, self.sent);
        if self.outbox.is_reliable() {
            self.heartbeat_interval = FIRST_HEARTBEAT;
            self.heartbeat_at = now + FIRST_HEARTBEAT;
        }
        if self.look_at == u64::MAX {
            self.look_at = now + SILENCE_STEP;
        }
        Some(chosen)
    }

    /// Gives up the credit of a late thread. The topic may have waited for something else.
    pub fn forget_lateness(&mut self) {
        (self.paced_until, self.late) = (None, 0);
    }

    /// Processes timers that are due. Must be called at the time in [`TopicTurn`].
    pub fn on_timer(&mut self, now: u64) -> Due {
        let mut due = Due::default();
        if self.look_at <= now {
            self.look_at = u64::MAX;
            self.peers.look();
            self.leader = None;
        }
        if self.heartbeat_at <= now {
            let through = self.outbox.sent_through();
            if self.peers.lacks(through) {
                due.heartbeat = Some((through + 1, self.outbox.oldest()));
                self.heartbeat_interval = (2 * self.heartbeat_interval).min(SLOWEST_HEARTBEAT);
                self.heartbeat_at = now + self.heartbeat_interval;
                if self.look_at == u64::MAX {
                    self.look_at = now + SILENCE_STEP;
                }
            } else {
                self.heartbeat_at = u64::MAX;
            }
        }
        self.wait(now);
        due.room = self.take_room();
        if self.find_rate(now).is_none() {
            let (sent, last) = (self.sent, self.sent_at);
            let blocked = self.peers.live().chain([&mut self.nobody]);
            let mut unheard = false;
            for peer in blocked.filter(|peer| peer.overdue_at(last) <= now) {
                // A single silence may be accidental.
                unheard |= peer.path().is_silent();
                peer.forget_under_way(now, sent);
            }
            if unheard && self.large_unheard && !self.peers.is_empty() {
                self.limit.set(now);
            }
        }
        due
    }

    /// Processes feedback of a reader. Returns the oldest sequence that can be repaired, if the
    /// reader requested an older one. Also returns whether a waiting publisher now has room.
    pub fn on_feedback(&mut self, now: u64, reader: &Name, feedback: &Feedback) -> (Option<u64>, bool) {
        match feedback {
            Feedback::Report {
                session,
                acknowledged,
                received_bytes,
                needless_bytes,
                ce,
                echo,
                echo_index,
                delay_us,
                ..
            } if *session == self.session => {
                let Some(peer) = self.peers.get_mut(reader) else { return (None, false) };
                let echo = (*echo > 0).then_some(Position { sequence: *echo, index: *echo_index });
                let delay = u64::from(*delay_us) * 1000;
                // Both copies of a doubled frame may arrive.
                let needless_bytes = if self.options.doubled { 0 } else { *needless_bytes };
                let (acknowledged, received_bytes) = (*acknowledged, *received_bytes);
                let report = Report { acknowledged, received_bytes, needless_bytes, ce: *ce, echo, delay };
                let (marked, slowed) = peer.on_report(now, &report, &self.log, &self.outbox, self.sent);
                self.outbox.count_congestion(marked, slowed);
                self.large_unheard &= echo.is_none();
                echo.and_then(|echo| self.outbox.len_of(echo))
                    .into_iter()
                    .for_each(|len| peer.suspicion.on_received(len));
                self.leader = None;
                let awaited = peer.acknowledged() + 1;
                self.wait(now);
                (self.outbox.skips(awaited), self.take_room())
            }
            Feedback::Nack { session, highest, highest_index, waited_us, missing, .. } if *session == self.session => {
                let highest = Position { sequence: *highest, index: *highest_index };
                let waited = u64::from(*waited_us) * 1000;
                // This thread may process the request late. What was sent since then is in flight,
                // or was in a queue of the path.
                let queue = self.peers.get(reader).map_or(0, |peer| peer.path().rtt() / 2);
                let before = self.log.find(highest).map(|sent| (sent.at + waited).saturating_sub(queue));
                let in_flight = before.and_then(|before| self.log.first_after(before));
                let behind = Position { index: highest.index.saturating_add(1), ..highest };
                let in_flight = in_flight.map(|position| position.max(behind));
                (self.on_nack(now, reader, missing, in_flight), false)
            }
            _ => (None, false),
        }
    }

    /// Queues repairs. Segments from `in_flight` on were sent after the request.
    fn on_nack(&mut self, now: u64, reader: &Name, missing: &[Missing], in_flight: Option<Position>) -> Option<u64> {
        let fresh = Fresh { total: self.fresh, recent: self.recent.get(now) };
        let peer = self.peers.get_mut(reader)?;
        let too_early = now.saturating_sub(peer.path().rtt() * 3 / 4);
        for range in missing.iter().take(MAX_MISSING) {
            let queued = self.outbox.ask(range, too_early, in_flight, |bytes| peer.pay(now, bytes, fresh));
            let first = Position { sequence: range.sequence, index: range.first };
            peer.on_lost(queued, self.log.find(first).map_or(0, |sent| sent.at));
        }
        if peer.suspicion.asked(now, missing, too_early) {
            self.limit.set(now);
        }
        let (first, acknowledged) = (missing.first()?.sequence, peer.acknowledged());
        let oldest = self.outbox.oldest();
        // A message that was never sent is reported once no earlier message is outstanding.
        let skipped = self.outbox.skips(first).filter(|_| acknowledged + 1 >= first);
        Some(oldest).filter(|oldest| first < *oldest).or(skipped).filter(|_| self.outbox.is_reliable())
    }

    /// Returns whether a waiting publisher now has room.
    fn take_room(&mut self) -> bool {
        let Some(Waiting { messages, bytes, .. }) = self.waiting else { return false };
        let room = self.outbox.has_room(messages, bytes, self.peers.acknowledged());
        if room {
            self.waiting = None;
        }
        room
    }

    /// Updates the time when a waiting publisher stops waiting for a slow reader.
    fn wait(&mut self, now: u64) {
        if let Some(waiting) = &mut self.waiting {
            waiting.again_at = match self.outbox.oldest_sent() {
                Some(last) => self.peers.wait(now, last),
                None => u64::MAX,
            };
        }
    }

    fn overdue_at(&mut self) -> u64 {
        let last = self.sent_at;
        self.peers.live().map(|peer| peer.overdue_at(last)).min().unwrap_or_else(|| self.nobody.overdue_at(last))
    }

    /// Returns the rate to the fastest reader with room. Without live readers, a small amount is
    /// sent anyway.
    fn find_rate(&mut self, now: u64) -> Option<u64> {
        let sent = self.sent;
        if self.leader().is_none_or(|leader| !leader.has_room(sent)) {
            self.leader = self.peers.leader(now, sent);
        }
        match self.leader() {
            Some(leader) => Some(leader.path().rate(now)),
            None if self.peers.any_live() || !self.nobody.has_room(sent) => None,
            None => Some(self.nobody.path().rate(now)),
        }
    }

    /// Returns the bytes of the burst after a pause.
    fn at_once_after_pause(&self, now: u64) -> u64 {
        let leader = self.leader().unwrap_or(&self.nobody);
        let is_idle = leader.under_way(self.sent) == 0 && now.saturating_sub(self.sent_at) >= leader.path().rtt();
        if is_idle { leader.path().burst() } else { 0 }
    }

    fn leader(&self) -> Option<&ReaderState> {
        self.peers.get(&self.leader?)
    }
}

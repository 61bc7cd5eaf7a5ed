//! Updates that tell each attached entity of its counterparts for a name. After the entity's
//! statement it receives the full list in parts, then changes, and the full list again after a
//! failure.
//!
//! Each name and role of an entity is one stream of messages with at most one in flight. The
//! streams of one switch share a window. Entities that do not answer thus delay no other switch,
//! and their own switch little. Idle streams, which are almost all, are not stored.
//! [`sent_update`](super::names::Registration::sent_update) then holds the generation that the
//! entity has.

use crate::rib::model::RegistrationKey;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::time::Duration;

use gdp_proto::control::{Peers, PeersExtent, PeersPush, Record};
use gdp_wire::Name;

use super::names::{Names, RECORDS_SIZE};
use super::revocations::Revocations;
use super::wrapped_keys::WrappedKeyStore;
use crate::rib::model::UpdateId;
use crate::rib::registration::Registration;

/// Maximum number of messages in flight to the entities at one switch, and to one entity.
pub(super) const AT_ONCE: usize = 64;
const AT_ONCE_TO_ONE: usize = 4;

/// Initial and maximum delay before a full resend after a lost message. The delay doubles each
/// time.
const RETRY: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(32));

/// Bytes of a departed entity's entry in a message.
const GONE_SIZE: usize = 40;

/// Sources from which updates are composed.
#[derive(Clone, Copy)]
pub(super) struct UpdateSource<'a> {
    pub run: u64,
    /// The RIB may not know all registrations yet.
    pub settling: bool,
    pub now: Duration,
    pub names: &'a Names,
    pub boxes: &'a WrappedKeyStore,
    pub revocations: &'a Revocations,
}

#[derive(Debug, Default)]
pub(super) struct PeerUpdates {
    streams: BTreeMap<RegistrationKey, Box<Stream>>,
    switches: BTreeMap<Name, Turns>,
    retries: BTreeSet<(Duration, RegistrationKey)>,
    generation: u64,
}

#[derive(Debug)]
struct Stream {
    switch: Name,
    phase: Phase,
    /// Counterparts whose records changed or ended, and counterparts of which only key boxes
    /// changed.
    records: BTreeSet<Name>,
    boxes: BTreeSet<Name>,
    revocation: bool,
    /// Generation of the last message.
    sent: u64,
    /// A message is in flight.
    is_out: bool,
    is_queued: bool,
    /// The full list was sent while the RIB settled and must be sent again.
    is_unsettled: bool,
    wait: Duration,
    /// Earliest time at which a failure may move the stream to another switch. This is limited to
    /// once per [wait](Self::wait), so that an entity that accepts nothing anywhere does not
    /// receive messages without end.
    turns_from: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Part `part` of the full list is next, starting behind counterpart `after`.
    Whole {
        part: u32,
        after: Option<Name>,
    },
    /// The entity holds everything except the marked changes.
    Following,
    Failed {
        retry: Duration,
    },
    /// The entity is to learn that its credential was revoked, and nothing after that.
    Farewell,
}

/// Streams to one switch with pending messages, and the number of messages in flight.
#[derive(Debug, Default)]
struct Turns {
    entities: VecDeque<Name>,
    desks: HashMap<Name, EntityQueue>,
    out: usize,
}

#[derive(Debug, Default)]
struct EntityQueue {
    queue: VecDeque<RegistrationKey>,
    out: usize,
    is_listed: bool,
}

impl PeerUpdates {
    /// Starts a stream of updates about all counterparts.
    ///
    /// Returns the first part, which answers the entity's statement. If no further part is pending,
    /// also returns the generation that the entity then holds. `only` states that no other switch
    /// leads to the entity.
    pub fn begin(
        &mut self,
        registration_key: RegistrationKey,
        switch: Name,
        only: bool,
        source: UpdateSource,
    ) -> (Peers, Option<u64>) {
        let mut stream = Stream::new(switch, Phase::Whole { part: 0, after: None });
        self.generation += 1;
        let peers = stream.message(&registration_key, self.generation, source);
        // The answer to a message in flight is ignored. A queued stream keeps its turn.
        let old = self.streams.get(&registration_key);
        stream.is_queued = old.is_some_and(|old| old.is_queued && old.switch == switch);
        self.streams.insert(registration_key, stream.into());
        (peers, self.go_on(registration_key, only))
    }

    /// Returns the first part as [`Self::begin`] does, for a tool that receives no later updates.
    pub fn once(&mut self, registration_key: RegistrationKey, switch: Name, source: UpdateSource) -> Peers {
        self.generation += 1;
        Stream::new(switch, Phase::Whole { part: 0, after: None }).message(&registration_key, self.generation, source)
    }

    /// Sends the full list of counterparts again. A RIB that replaces another one does so.
    pub fn resume(&mut self, registration_key: RegistrationKey, switch: Name) {
        self.streams
            .entry(registration_key)
            .or_insert_with(|| Stream::new(switch, Phase::Whole { part: 0, after: None }).into());
        self.queue(registration_key);
    }

    /// Stops the updates through `switch` and restarts them through `other`, if given.
    pub fn follow(&mut self, registration_key: &RegistrationKey, switch: &Name, other: Option<Name>) {
        if self.streams.get(registration_key).is_none_or(|stream| stream.switch != *switch) {
            return;
        }
        let ended = self.streams.remove(registration_key).map(|stream| *stream);
        if let (Some(Stream { wait, turns_from, .. }), Some(other)) = (ended, other) {
            let stream = Stream::new(other, Phase::Whole { part: 0, after: None });
            self.streams.insert(*registration_key, Stream { wait, turns_from, ..stream }.into());
            self.queue(*registration_key);
        }
    }

    /// Notifies an entity once that its credential is revoked. An entity that misses the message is
    /// refused at its next request.
    pub fn farewell(&mut self, registration_key: RegistrationKey, switch: Name) {
        self.streams.insert(registration_key, Stream::new(switch, Phase::Farewell).into());
        self.queue(registration_key);
    }

    /// Marks a counterpart that appeared, departed or changed its credential.
    pub fn record_changed(&mut self, names: &Names, registration_key: RegistrationKey, counterpart: Name) {
        self.mark(names, registration_key, |stream| _ = stream.records.insert(counterpart));
    }

    /// Marks a counterpart that has new key boxes for the entity.
    pub fn boxes_changed(&mut self, names: &Names, registration_key: RegistrationKey, counterpart: Name) {
        self.mark(names, registration_key, |stream| _ = stream.boxes.insert(counterpart));
    }

    /// Marks a counterpart that has key boxes for the entity's inbox. The first of them starts the
    /// stream.
    pub fn inbox_boxes_changed(
        &mut self,
        names: &Names,
        registration_key: RegistrationKey,
        switch: Name,
        counterpart: Name,
    ) {
        self.resume(registration_key, switch);
        self.boxes_changed(names, registration_key, counterpart);
    }

    pub fn revocation_changed(&mut self, names: &Names, registration_key: RegistrationKey) {
        self.mark(names, registration_key, |stream| stream.revocation = true);
    }

    fn mark(&mut self, names: &Names, registration_key: RegistrationKey, mark: impl FnOnce(&mut Stream)) {
        let stream = match self.streams.entry(registration_key) {
            Entry::Occupied(stream) => stream.into_mut(),
            Entry::Vacant(vacant) => {
                let Some((switch, sent)) = names.last_update(&registration_key) else { return };
                vacant.insert(Stream { sent, ..Stream::new(switch, Phase::Following) }.into())
            }
        };
        mark(stream);
        self.queue(registration_key);
    }

    /// Returns the updates to send now. Each must be answered with [`Self::answered`].
    pub fn next(&mut self, source: UpdateSource) -> Vec<PeersPush> {
        let mut pushes = Vec::new();
        for (switch, turns) in &mut self.switches {
            while let Some(registration_key) = turns.next() {
                // The stream may have ended in the meantime and started again, here or elsewhere.
                let here =
                    self.streams.get_mut(&registration_key).filter(|stream| stream.switch == *switch && !stream.is_out);
                let ready = here.and_then(|stream| {
                    stream.is_queued = false;
                    stream.has_more().then_some(stream)
                });
                let Some(stream) = ready else {
                    turns.done(&registration_key.entity);
                    continue;
                };
                self.generation += 1;
                stream.is_out = true;
                let peers = stream.message(&registration_key, self.generation, source);
                let (entity, name, role) =
                    (registration_key.entity, Name::from_bytes(registration_key.name), registration_key.role);
                pushes.push(PeersPush { switch: *switch, entity, name, role, peers });
            }
        }
        self.switches.retain(|_, turns| !turns.is_idle());
        pushes
    }

    /// Records whether a message arrived. After a loss, the stream resends the full list: through
    /// `other` at most once per [wait](Stream::wait), else later through the same switch.
    ///
    /// Returns the generation that the entity holds, if nothing more is pending.
    pub fn answered(&mut self, now: Duration, told: UpdateId, arrived: bool, other: Option<Name>) -> Option<u64> {
        let UpdateId { switch, registration_key, generation } = told;
        if let Some(turns) = self.switches.get_mut(&switch) {
            turns.done(&registration_key.entity);
        }
        let stream =
            self.streams.get_mut(&registration_key).filter(|stream| stream.is_out && stream.sent == generation)?;
        stream.is_out = false;
        if stream.phase == Phase::Farewell {
            self.streams.remove(&registration_key);
        } else if arrived {
            stream.wait = RETRY.0;
            return self.go_on(registration_key, other.is_none());
        } else if other.is_some() && now >= stream.turns_from {
            stream.turns_from = now + stream.wait;
            self.follow(&registration_key, &switch, other);
        } else {
            let retry = now + stream.wait;
            stream.wait = (stream.wait * 2).min(RETRY.1);
            stream.phase = Phase::Failed { retry };
            self.retries.insert((retry, registration_key));
        }
        None
    }

    /// Queues the stream's pending updates. An idle stream to an entity with only one switch ends
    /// instead, and its generation is returned.
    fn go_on(&mut self, registration_key: RegistrationKey, only: bool) -> Option<u64> {
        if only
            && !registration_key.is_inbox()
            && self.streams.get(&registration_key).is_some_and(|stream| stream.is_at_rest())
        {
            return self.streams.remove(&registration_key).map(|stream| stream.sent);
        }
        self.queue(registration_key);
        None
    }

    /// Returns the time at which [`Self::tick`] next has work.
    pub fn retry_at(&self) -> Option<Duration> {
        self.retries.first().map(|(retry, _)| *retry)
    }

    /// Resends the updates whose retry time has passed.
    pub fn tick(&mut self, now: Duration) {
        while let Some((retry, registration_key)) = self.retries.first().copied().filter(|(retry, _)| *retry <= now) {
            self.retries.pop_first();
            self.retry(registration_key, |phase| phase == Phase::Failed { retry });
        }
    }

    /// Retries failed streams at once because their switch has reconnected.
    pub fn reconnected(&mut self, switch: &Name) {
        let failed = |stream: &Stream| stream.switch == *switch && matches!(stream.phase, Phase::Failed { .. });
        let stakes: Vec<_> = self
            .streams
            .iter()
            .filter(|(_, stream)| failed(stream))
            .map(|(registration_key, _)| *registration_key)
            .collect();
        stakes.into_iter().for_each(|registration_key| self.retry(registration_key, |_| true));
    }

    /// Resends the full lists that were sent while the RIB settled.
    pub fn settled(&mut self) {
        let unsettled = self
            .streams
            .iter()
            .filter(|(_, stream)| stream.is_unsettled)
            .map(|(registration_key, _)| *registration_key);
        let stakes: Vec<_> = unsettled.collect();
        stakes.into_iter().for_each(|registration_key| self.retry(registration_key, |phase| phase != Phase::Farewell));
    }

    #[cfg(test)]
    pub fn streams(&self) -> usize {
        self.streams.len()
    }

    fn retry(&mut self, registration_key: RegistrationKey, due: impl FnOnce(Phase) -> bool) {
        if let Some(stream) = self.streams.get_mut(&registration_key).filter(|stream| due(stream.phase)) {
            stream.phase = Phase::Whole { part: 0, after: None };
            self.queue(registration_key);
        }
    }

    fn queue(&mut self, registration_key: RegistrationKey) {
        let Some(stream) = self.streams.get_mut(&registration_key) else { return };
        if !stream.is_queued && !stream.is_out && stream.has_more() {
            stream.is_queued = true;
            self.switches.entry(stream.switch).or_default().queue(registration_key);
        }
    }
}

impl Turns {
    fn queue(&mut self, registration_key: RegistrationKey) {
        self.desks.entry(registration_key.entity).or_default().queue.push_back(registration_key);
        self.list(&registration_key.entity);
    }

    /// Returns the next stream. Entities take turns, however many streams each has queued.
    fn next(&mut self) -> Option<RegistrationKey> {
        if self.out >= AT_ONCE {
            return None;
        }
        let entity = self.entities.pop_front()?;
        let desk = self.desks.get_mut(&entity)?;
        desk.is_listed = false;
        let registration_key = desk.queue.pop_front()?;
        desk.out += 1;
        self.out += 1;
        self.list(&entity);
        Some(registration_key)
    }

    fn done(&mut self, entity: &Name) {
        let Some(desk) = self.desks.get_mut(entity).filter(|desk| desk.out > 0) else { return };
        desk.out -= 1;
        self.out -= 1;
        if desk.out == 0 && desk.queue.is_empty() {
            self.desks.remove(entity);
        } else {
            self.list(entity);
        }
    }

    fn list(&mut self, entity: &Name) {
        let desk = self.desks.get_mut(entity);
        if let Some(desk) = desk.filter(|d| !d.is_listed && !d.queue.is_empty() && d.out < AT_ONCE_TO_ONE) {
            desk.is_listed = true;
            self.entities.push_back(*entity);
        }
    }

    fn is_idle(&self) -> bool {
        self.desks.is_empty()
    }
}

impl Stream {
    fn new(switch: Name, phase: Phase) -> Self {
        let (records, boxes) = Default::default();
        let (revocation, sent, is_out, is_queued, is_unsettled) = (false, 0, false, false, false);
        let (wait, turns_from) = (RETRY.0, Duration::ZERO);
        Self { switch, phase, records, boxes, revocation, sent, is_out, is_queued, is_unsettled, wait, turns_from }
    }

    fn has_more(&self) -> bool {
        match self.phase {
            Phase::Whole { .. } | Phase::Farewell => true,
            Phase::Following => !self.records.is_empty() || !self.boxes.is_empty() || self.revocation,
            Phase::Failed { .. } => false,
        }
    }

    /// Returns whether the entity holds all updates.
    fn is_at_rest(&self) -> bool {
        self.phase == Phase::Following && !self.has_more() && !self.is_unsettled
    }

    /// Composes the next message. Call it if [more is pending](Self::has_more).
    fn message(&mut self, registration_key: &RegistrationKey, generation: u64, source: UpdateSource) -> Peers {
        let extent = PeersExtent::Whole { part: 0, last: true };
        let (records, gone, boxes) = (Vec::new(), Vec::new(), Vec::new());
        let UpdateSource { run, settling, .. } = source;
        let mut peers = Peers { run, settling, generation, extent, records, gone, revocation: None, boxes };
        let before = std::mem::replace(&mut self.sent, generation);
        match self.phase {
            Phase::Whole { part, after } => {
                let end = source.fill(&mut peers, registration_key, after);
                // This part covers all marked changes in its range. Changes before it wait for a
                // later message.
                let settled =
                    |name: &Name| after.is_none_or(|after| *name > after) && end.is_none_or(|end| *name <= end);
                self.records.retain(|name| !settled(name));
                self.boxes.retain(|name| !settled(name));
                peers.extent = PeersExtent::Whole { part, last: end.is_none() };
                if part == 0 {
                    (self.revocation, self.is_unsettled) = (true, settling);
                }
                self.phase = match end {
                    Some(_) => Phase::Whole { part: part + 1, after: end },
                    None => Phase::Following,
                };
            }
            Phase::Following | Phase::Failed { .. } => {
                peers.extent = PeersExtent::After(before);
                self.changes(&mut peers, registration_key, source);
            }
            Phase::Farewell => self.revocation = true,
        }
        if std::mem::take(&mut self.revocation) {
            peers.revocation =
                source.revocations.get(&registration_key.name).map(|stored| stored.signed.revocation.clone());
        }
        peers
    }

    fn changes(&mut self, peers: &mut Peers, registration_key: &RegistrationKey, source: UpdateSource) {
        let mut room = RECORDS_SIZE;
        while let Some(name) = self.records.first().into_iter().chain(self.boxes.first()).min().copied() {
            let size = source.size(registration_key, &name);
            if size > room {
                break;
            }
            room -= size;
            if self.records.remove(&name) {
                match source.record(registration_key, &name) {
                    Some(record) => peers.records.push(record),
                    None => peers.gone.push(name),
                }
            }
            self.boxes.remove(&name);
            peers.boxes.extend(source.boxes.between(registration_key, &name).cloned());
        }
    }
}

impl UpdateSource<'_> {
    /// Adds the counterparts behind `after`, as many as fit. Returns the last of them if more
    /// follow.
    fn fill(self, peers: &mut Peers, registration_key: &RegistrationKey, after: Option<Name>) -> Option<Name> {
        let (mut room, mut end) = (RECORDS_SIZE, after);
        let mut add = |counterpart: Name| {
            let size = self.size(registration_key, &counterpart);
            if size > room {
                return false;
            }
            room -= size;
            peers.records.extend(self.record(registration_key, &counterpart));
            peers.boxes.extend(self.boxes.between(registration_key, &counterpart).cloned());
            end = Some(counterpart);
            true
        };
        let all = match registration_key.is_inbox() {
            true => self.boxes.writers(&registration_key.name, after).all(&mut add),
            false => self
                .names
                .behind_entity(&registration_key.name, registration_key.role.counterpart(), after)
                .all(&mut add),
        };
        if all { None } else { end }
    }

    /// Returns the bytes of a counterpart's entry in a message.
    fn size(self, registration_key: &RegistrationKey, counterpart: &Name) -> usize {
        let registration = self.names.get(&registration_key.name, counterpart, registration_key.role.counterpart());
        registration.map_or(GONE_SIZE, Registration::size) + self.boxes.size(registration_key, counterpart)
    }

    /// Returns the record of a counterpart, if the entity may know it.
    fn record(self, registration_key: &RegistrationKey, counterpart: &Name) -> Option<Record> {
        self.names.record_for(self.now, registration_key, counterpart)
    }
}

//! Updates that tell each attached entity of its counterparts for a name. After the entity's
//! statement it receives the full list in parts, then changes, and the full list again after a
//! failure.
//!
//! Each name and role of an entity is one stream of messages with at most one in flight. The
//! streams of one switch share a window. Entities that do not answer thus delay no other switch,
//! and their own switch little. Idle streams, which are almost all, are not stored.
//! [`sent_update`](super::names::Registration::sent_update) then holds the generation that the
//! entity has.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::time::Duration;

use gdp_proto::control::{Peers, PeersExtent, PeersPush, Record};
use gdp_util::backoff::Backoff;
use gdp_wire::Name;

use super::names::{Names, RECORDS_SIZE};
use super::revocations::Revocations;
use super::wrapped_keys::WrappedKeyStore;
use crate::delta_sync::{DeltaSync, NextMessage};
use crate::rib::model::{RegistrationKey, UpdateId};
use crate::rib::registration::Registration;

/// Maximum number of messages in flight to the entities at one switch, and to one entity.
pub(super) const AT_ONCE: usize = 64;
const AT_ONCE_TO_ONE: usize = 4;

/// Delays before a full resend after lost messages.
const RETRY: Backoff = Backoff::new(Duration::from_millis(500), Duration::from_secs(32));

/// Bytes of a departed entity's entry in a message.
const DEPARTED_SIZE: usize = 40;

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
    switches: BTreeMap<Name, SwitchQueue>,
    retries: BTreeSet<(Duration, RegistrationKey)>,
    generation: u64,
}

#[derive(Debug)]
struct Stream {
    switch: Name,
    /// The entity's copy of the list of its counterparts.
    sync: DeltaSync<Name, CounterpartChange>,
    /// The entity is to learn that its credential was revoked, and nothing after that.
    is_farewell: bool,
    revocation: bool,
    /// Generation of the last message.
    sent: u64,
    /// A message is in flight.
    is_out: bool,
    is_queued: bool,
    /// The full list was sent while the RIB settled and must be sent again.
    is_unsettled: bool,
    backoff: Backoff,
    /// Earliest time at which a failure may move the stream to another switch. This is limited to
    /// once per [backoff](Self::backoff), so that an entity that accepts nothing anywhere does not
    /// receive messages without end.
    moves_from: Duration,
}

/// What changed of a counterpart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum CounterpartChange {
    /// Only its key boxes changed.
    Boxes,
    /// Its record changed or ended. Its key boxes may have changed as well.
    Record,
}

/// Streams to one switch with pending messages, and the number of messages in flight.
#[derive(Debug, Default)]
struct SwitchQueue {
    /// Entities with a stream that may be sent, in turn.
    entities: VecDeque<Name>,
    queues: HashMap<Name, EntityQueue>,
    out: usize,
}

#[derive(Debug, Default)]
struct EntityQueue {
    keys: VecDeque<RegistrationKey>,
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
        let mut stream = Stream::new(switch, DeltaSync::new());
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
        Stream::new(switch, DeltaSync::new()).message(&registration_key, self.generation, source)
    }

    /// Sends the full list of counterparts again. A RIB that replaces another one does so.
    pub fn resume(&mut self, registration_key: RegistrationKey, switch: Name) {
        self.streams.entry(registration_key).or_insert_with(|| Stream::new(switch, DeltaSync::new()).into());
        self.queue(registration_key);
    }

    /// Stops the updates through `switch` and restarts them through `other`, if given.
    pub fn follow(&mut self, registration_key: &RegistrationKey, switch: &Name, other: Option<Name>) {
        if self.streams.get(registration_key).is_none_or(|stream| stream.switch != *switch) {
            return;
        }
        let ended = self.streams.remove(registration_key).map(|stream| *stream);
        if let (Some(Stream { backoff, moves_from, .. }), Some(other)) = (ended, other) {
            let stream = Stream::new(other, DeltaSync::new());
            self.streams.insert(*registration_key, Stream { backoff, moves_from, ..stream }.into());
            self.queue(*registration_key);
        }
    }

    /// Notifies an entity once that its credential is revoked. An entity that misses the message is
    /// refused at its next request.
    pub fn farewell(&mut self, registration_key: RegistrationKey, switch: Name) {
        let stream = Stream { is_farewell: true, ..Stream::new(switch, DeltaSync::following()) };
        self.streams.insert(registration_key, stream.into());
        self.queue(registration_key);
    }

    /// Marks a counterpart that appeared, departed or changed its credential.
    pub fn record_changed(&mut self, names: &Names, registration_key: RegistrationKey, counterpart: Name) {
        self.mark(names, registration_key, |stream| stream.sync.change(counterpart, CounterpartChange::Record));
    }

    /// Marks a counterpart that has new key boxes for the entity.
    pub fn boxes_changed(&mut self, names: &Names, registration_key: RegistrationKey, counterpart: Name) {
        self.mark(names, registration_key, |stream| stream.sync.change(counterpart, CounterpartChange::Boxes));
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
                vacant.insert(Stream { sent, ..Stream::new(switch, DeltaSync::following()) }.into())
            }
        };
        mark(stream);
        self.queue(registration_key);
    }

    /// Returns the updates to send now. Each must be answered with [`Self::answered`].
    pub fn next(&mut self, source: UpdateSource) -> Vec<PeersPush> {
        let mut pushes = Vec::new();
        for (switch, queue) in &mut self.switches {
            while let Some(registration_key) = queue.next() {
                // The stream may have ended in the meantime and started again, here or elsewhere.
                let here =
                    self.streams.get_mut(&registration_key).filter(|stream| stream.switch == *switch && !stream.is_out);
                let ready = here.and_then(|stream| {
                    stream.is_queued = false;
                    stream.has_more().then_some(stream)
                });
                let Some(stream) = ready else {
                    queue.done(&registration_key.entity);
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
        self.switches.retain(|_, queue| !queue.is_idle());
        pushes
    }

    /// Records whether a message arrived. After a loss, the stream resends the full list: through
    /// `other` at most once per [backoff](Stream::backoff), else later through the same switch.
    ///
    /// Returns the generation that the entity holds, if nothing more is pending.
    pub fn answered(&mut self, now: Duration, update: UpdateId, arrived: bool, other: Option<Name>) -> Option<u64> {
        let UpdateId { switch, registration_key, generation } = update;
        if let Some(queue) = self.switches.get_mut(&switch) {
            queue.done(&registration_key.entity);
        }
        let stream =
            self.streams.get_mut(&registration_key).filter(|stream| stream.is_out && stream.sent == generation)?;
        stream.is_out = false;
        if stream.is_farewell {
            self.streams.remove(&registration_key);
        } else if arrived {
            stream.backoff.reset();
            return self.go_on(registration_key, other.is_none());
        } else if other.is_some() && now >= stream.moves_from {
            stream.moves_from = now + stream.backoff.delay();
            self.follow(&registration_key, &switch, other);
        } else {
            let retry = now + stream.backoff.next_delay();
            stream.sync.failed(retry);
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
            self.restart(registration_key, |stream| stream.sync.retry_at() == Some(retry));
        }
    }

    /// Retries failed streams at once because their switch has reconnected.
    pub fn reconnected(&mut self, switch: &Name) {
        self.restart_all(|stream| stream.switch == *switch && stream.sync.retry_at().is_some());
    }

    /// Resends the full lists that were sent while the RIB settled.
    pub fn settled(&mut self) {
        self.restart_all(|stream| stream.is_unsettled && !stream.is_farewell);
    }

    #[cfg(test)]
    pub fn streams(&self) -> usize {
        self.streams.len()
    }

    fn restart_all(&mut self, is_due: impl Fn(&Stream) -> bool) {
        let due: Vec<_> = self.streams.iter().filter(|(_, stream)| is_due(stream)).map(|(key, _)| *key).collect();
        due.into_iter().for_each(|registration_key| self.restart(registration_key, |_| true));
    }

    fn restart(&mut self, registration_key: RegistrationKey, is_due: impl FnOnce(&Stream) -> bool) {
        if let Some(stream) = self.streams.get_mut(&registration_key).filter(|stream| is_due(stream)) {
            stream.sync.restart();
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

impl SwitchQueue {
    fn queue(&mut self, registration_key: RegistrationKey) {
        self.queues.entry(registration_key.entity).or_default().keys.push_back(registration_key);
        self.list(&registration_key.entity);
    }

    /// Returns the next stream. Entities take turns, however many streams each has queued.
    fn next(&mut self) -> Option<RegistrationKey> {
        if self.out >= AT_ONCE {
            return None;
        }
        let entity = self.entities.pop_front()?;
        let queue = self.queues.get_mut(&entity)?;
        queue.is_listed = false;
        let registration_key = queue.keys.pop_front()?;
        queue.out += 1;
        self.out += 1;
        self.list(&entity);
        Some(registration_key)
    }

    fn done(&mut self, entity: &Name) {
        let Some(queue) = self.queues.get_mut(entity).filter(|queue| queue.out > 0) else { return };
        queue.out -= 1;
        self.out -= 1;
        if queue.out == 0 && queue.keys.is_empty() {
            self.queues.remove(entity);
        } else {
            self.list(entity);
        }
    }

    fn list(&mut self, entity: &Name) {
        let may_send =
            |queue: &&mut EntityQueue| !queue.is_listed && !queue.keys.is_empty() && queue.out < AT_ONCE_TO_ONE;
        if let Some(queue) = self.queues.get_mut(entity).filter(may_send) {
            queue.is_listed = true;
            self.entities.push_back(*entity);
        }
    }

    fn is_idle(&self) -> bool {
        self.queues.is_empty()
    }
}

impl Stream {
    fn new(switch: Name, sync: DeltaSync<Name, CounterpartChange>) -> Self {
        Self {
            switch,
            sync,
            is_farewell: false,
            revocation: false,
            sent: 0,
            is_out: false,
            is_queued: false,
            is_unsettled: false,
            backoff: RETRY,
            moves_from: Duration::ZERO,
        }
    }

    fn has_more(&self) -> bool {
        self.is_farewell || self.sync.next_message().is_some() || (self.revocation && self.sync.is_following())
    }

    /// Returns whether the entity holds all updates.
    fn is_at_rest(&self) -> bool {
        self.sync.is_following() && !self.has_more() && !self.is_unsettled
    }

    /// Composes the next message. Call it if [more is pending](Self::has_more).
    fn message(&mut self, registration_key: &RegistrationKey, generation: u64, source: UpdateSource) -> Peers {
        let extent = PeersExtent::Whole { part: 0, last: true };
        let (records, departed, boxes) = (Vec::new(), Vec::new(), Vec::new());
        let UpdateSource { run, settling, .. } = source;
        let mut peers = Peers { run, settling, generation, extent, records, departed, revocation: None, boxes };
        let before = std::mem::replace(&mut self.sent, generation);
        match self.sync.next_message() {
            _ if self.is_farewell => self.revocation = true,
            Some(NextMessage::Part { after }) => {
                let part = self.sync.part_composed(source.fill(&mut peers, registration_key, after));
                peers.extent = PeersExtent::Whole { part: part.number, last: part.is_last };
                if part.number == 0 {
                    (self.revocation, self.is_unsettled) = (true, settling);
                }
            }
            Some(NextMessage::Delta) | None => {
                peers.extent = PeersExtent::After(before);
                self.changes(&mut peers, registration_key, source);
            }
        }
        if std::mem::take(&mut self.revocation) {
            peers.revocation =
                source.revocations.get(&registration_key.name).map(|stored| stored.signed.revocation.clone());
        }
        peers
    }

    fn changes(&mut self, peers: &mut Peers, registration_key: &RegistrationKey, source: UpdateSource) {
        let mut room = RECORDS_SIZE;
        let mut fits = |name: &Name| {
            let left = room.checked_sub(source.size(registration_key, name));
            room = left.unwrap_or(room);
            left.is_some()
        };
        while let Some((name, change)) = self.sync.next_change(&mut fits) {
            if change == CounterpartChange::Record {
                match source.record(registration_key, &name) {
                    Some(record) => peers.records.push(record),
                    None => peers.departed.push(name),
                }
            }
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
        registration.map_or(DEPARTED_SIZE, Registration::size) + self.boxes.size(registration_key, counterpart)
    }

    /// Returns the record of a counterpart, if the entity may know it.
    fn record(self, registration_key: &RegistrationKey, counterpart: &Name) -> Option<Record> {
        self.names.record_for(self.now, registration_key, counterpart)
    }
}

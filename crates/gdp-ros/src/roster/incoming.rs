//! The receiving side of rosters. It stores the publishers of each writer of a name, and queues
//! messages until their publisher is known.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use gdp_e2e::seal::Message;
use gdp_wire::Name;

use super::{Kind, LEASE, Offer, ROSTER, Roster, RosterError, Writer, number};

/// Maximum number of writers of a name.
const MAX_PEERS: usize = 256;

/// Maximum number of queued messages, for all writers of a name. `MAX_PENDING_BYTES` bounds their
/// size. Beyond either bound the oldest messages are dropped.
const MAX_PENDING: usize = 1024;
const MAX_PENDING_BYTES: usize = 32 << 20;

/// The rosters of one name that is read.
#[derive(Default)]
pub struct Incoming {
    peers: HashMap<Name, RosterPeer>,
    /// Messages that wait for a roster, each with its time of arrival.
    pending: VecDeque<(Instant, Message)>,
    pending_bytes: usize,
}

struct RosterPeer {
    kind: Kind,
    definition: Option<Arc<str>>,
    writers: BTreeMap<u32, Listed>,
    /// Session and sequence number of the message that carried the roster.
    said: ([u8; 16], u64),
    last_seen: Instant,
}

struct Listed {
    node: Arc<str>,
    offers: Offer,
    /// Whether nothing arrived within the lease, or the publisher is not alive.
    is_silent: bool,
}

/// A change to a publisher's counterpart in the local ROS graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// The counterpart must exist with this type and QoS. If it exists with another type or QoS, it
    /// must be replaced.
    Joined {
        writer: Name,
        number: u32,
        kind: Kind,
        definition: Option<Arc<str>>,
        /// The full name of the publisher's node, or an empty text.
        node: Arc<str>,
        offers: Offer,
    },
    /// Nothing arrived from the publisher within its lease, or its graph says that it is not alive.
    /// It may have left, or may join again as the same.
    Silent {
        writer: Name,
        number: u32,
    },
    Left {
        writer: Name,
        number: u32,
    },
}

/// An event on a name that is read.
#[derive(Debug, PartialEq, Eq)]
pub enum RosterEvent {
    /// The publishers changed.
    Changes(Vec<Change>),
    /// A message of the publisher with this number, which has [joined](Change::Joined).
    Message(u32, Message),
    /// A message without a publisher number, because its writer assigns none.
    Plain(Message),
    /// This number of messages was dropped, because no roster named their publishers in time.
    Unannounced(usize),
    /// A writer sent a roster that cannot be used.
    Malformed(Name, RosterError),
}

impl Incoming {
    /// Returns what a received message, which may be a roster, leads to.
    pub fn receive(&mut self, now: Instant, message: Message) -> Vec<RosterEvent> {
        if message.encoding != ROSTER {
            return self.message(now, message).into_iter().collect();
        }
        match self.roster(now, &message) {
            Ok((changes, released)) => {
                let released = released.into_iter().filter_map(|message| self.message(now, message));
                changes_event(changes).into_iter().chain(released).collect()
            }
            Err(error) => vec![RosterEvent::Malformed(message.writer, error)],
        }
    }

    /// Applies a received roster. Returns the changes, and the queued messages that can now be
    /// delivered, in their order.
    pub(super) fn roster(
        &mut self,
        now: Instant,
        message: &Message,
    ) -> Result<(Vec<Change>, Vec<Message>), RosterError> {
        let Roster { kind, definition, writers, .. } = Roster::from_bytes(&message.body)?;
        let (writer, said) = (message.writer, (message.session, message.sequence));
        let mut changes = Vec::new();
        if !self.peers.contains_key(&writer) && self.peers.len() >= MAX_PEERS {
            match self.forget_silent(now) {
                Some(left) => changes = left,
                None => {
                    return Err(RosterError::TooMuch {
                        what: "writers of a name",
                        got: MAX_PEERS + 1,
                        most: MAX_PEERS,
                    });
                }
            }
        }
        let before = self.peers.get(&writer);
        let same_session = before.is_some_and(|peer| peer.said.0 == said.0);
        if before.is_some_and(|peer| same_session && peer.said.1 > said.1) {
            return Ok((vec![], vec![]));
        }
        let same_kind = before.is_some_and(|peer| same_session && peer.kind == kind);
        let known = before.filter(|_| same_kind).and_then(|peer| peer.definition.clone());
        // A brief roster leaves the definition unchanged.
        let definition_is_new = definition.is_some() && definition.as_deref() != known.as_deref();
        let definition = definition.map(Arc::from).or(known);
        let listed = |writer: Writer| {
            let Writer { number, node, alive, offers } = writer;
            (number, Listed { node: node.into(), offers, is_silent: !alive })
        };
        let writers: BTreeMap<u32, Listed> = writers.into_iter().map(listed).collect();
        let empty = BTreeMap::new();
        let there = before.map_or(&empty, |peer| &peer.writers);
        // Another session numbers its publishers anew.
        let stays = |number: &u32| same_session && writers.contains_key(number);
        let left = there.keys().filter(|number| !stays(number)).map(|number| Change::Left { writer, number: *number });
        let stands = same_kind && !definition_is_new;
        let was_heard = |number: &u32| there.get(number).is_some_and(|before| !before.is_silent);
        let silent = writers.iter().filter(|(number, now)| now.is_silent && was_heard(number) && stays(number));
        let silent = silent.map(|(number, _)| Change::Silent { writer, number: *number });
        let is_as_before = |number: &u32, now: &Listed| {
            let same = |before: &Listed| (&before.node, before.offers) == (&now.node, now.offers);
            stands && was_heard(number) && there.get(number).is_some_and(same)
        };
        let joined = writers.iter().filter(|(number, now)| !now.is_silent && !is_as_before(number, now));
        let joined = joined.map(|(number, now)| {
            let (kind, definition, node) = (kind.clone(), definition.clone(), now.node.clone());
            Change::Joined { writer, number: *number, kind, definition, node, offers: now.offers }
        });
        changes.extend(left.chain(silent).chain(joined));
        self.peers.insert(writer, RosterPeer { kind, definition, writers, said, last_seen: now });
        Ok((changes, self.release(writer)))
    }

    /// Classifies a received message that is not a roster. Returns `None` if it waits for a roster.
    pub(super) fn message(&mut self, now: Instant, message: Message) -> Option<RosterEvent> {
        let Some(number) = number(&message.origin) else { return Some(RosterEvent::Plain(message)) };
        if let Some(peer) = self.peers.get_mut(&message.writer)
            && peer.said.0 == message.session
            && peer.writers.get(&number).is_some_and(|from| !from.is_silent)
        {
            peer.last_seen = now;
            return Some(RosterEvent::Message(number, message));
        }
        // The next roster will announce a silent publisher again. Other messages wait for their
        // first roster.
        self.pending_bytes += message.body.len();
        self.pending.push_back((now, message));
        let mut dropped = 0;
        while self.pending.len() > MAX_PENDING || (self.pending_bytes > MAX_PENDING_BYTES && self.pending.len() > 1) {
            self.drop_oldest();
            dropped += 1;
        }
        unannounced_event(dropped)
    }

    /// Marks publishers as silent whose lease has expired, and drops messages that waited for
    /// [`LEASE`].
    pub fn poll(&mut self, now: Instant) -> Vec<RosterEvent> {
        let mut changes = Vec::new();
        for (writer, peer) in &mut self.peers {
            let silence = now.saturating_duration_since(peer.last_seen);
            for (number, listed) in &mut peer.writers {
                if !listed.is_silent && silence >= listed.offers.lease() {
                    listed.is_silent = true;
                    changes.push(Change::Silent { writer: *writer, number: *number });
                }
            }
        }
        let before = self.pending.len();
        while self.pending.front().is_some_and(|(came, _)| now.saturating_duration_since(*came) >= LEASE) {
            self.drop_oldest();
        }
        changes_event(changes).into_iter().chain(unannounced_event(before - self.pending.len())).collect()
    }

    /// Returns the session whose messages of this publisher are delivered, unless the publisher is
    /// unknown or silent.
    pub fn session(&self, writer: &Name, number: u32) -> Option<[u8; 16]> {
        let peer = self.peers.get(writer)?;
        peer.writers.get(&number).filter(|listed| !listed.is_silent).map(|_| peer.said.0)
    }

    /// Records that a message of the writer arrived at `at`, other than by [`Self::receive`].
    pub fn refresh(&mut self, writer: &Name, at: Instant) {
        if let Some(peer) = self.peers.get_mut(writer) {
            peer.last_seen = peer.last_seen.max(at);
        }
    }

    /// Removes all publishers, and returns the changes.
    pub fn clear(&mut self) -> Vec<Change> {
        let numbers = |(writer, peer): (Name, RosterPeer)| {
            peer.writers.into_keys().map(move |number| Change::Left { writer, number })
        };
        std::mem::take(self).peers.into_iter().flat_map(numbers).collect()
    }

    /// Removes one writer that has been silent for [`LEASE`], to make room for another. Returns the
    /// changes, or `None` if there is no such writer.
    fn forget_silent(&mut self, now: Instant) -> Option<Vec<Change>> {
        let is_silent = |peer: &RosterPeer| {
            now.saturating_duration_since(peer.last_seen) >= LEASE
                && peer.writers.values().all(|listed| listed.is_silent)
        };
        let writer = *self.peers.iter().find(|(_, peer)| is_silent(peer))?.0;
        let numbers = self.peers.remove(&writer)?.writers.into_keys();
        Some(numbers.map(|number| Change::Left { writer, number }).collect())
    }

    fn drop_oldest(&mut self) {
        self.pending_bytes -= self.pending.pop_front().map_or(0, |(_, oldest)| oldest.body.len());
    }

    /// Returns the queued messages of `writer` whose publishers are now known. Messages of other
    /// publishers or sessions stay queued.
    fn release(&mut self, writer: Name) -> Vec<Message> {
        let Some(peer) = self.peers.get(&writer) else { return vec![] };
        let is_known = |(_, message): &(Instant, Message)| {
            message.writer == writer
                && message.session == peer.said.0
                && number(&message.origin)
                    .and_then(|number| peer.writers.get(&number))
                    .is_some_and(|from| !from.is_silent)
        };
        let (released, pending) = std::mem::take(&mut self.pending).into_iter().partition::<VecDeque<_>, _>(is_known);
        self.pending = pending;
        self.pending_bytes = self.pending.iter().map(|(_, message)| message.body.len()).sum();
        released.into_iter().map(|(_, message)| message).collect()
    }
}

fn changes_event(changes: Vec<Change>) -> Option<RosterEvent> {
    (!changes.is_empty()).then_some(RosterEvent::Changes(changes))
}

fn unannounced_event(dropped: usize) -> Option<RosterEvent> {
    (dropped > 0).then_some(RosterEvent::Unannounced(dropped))
}

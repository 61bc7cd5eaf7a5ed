//! Who publishes and who reads each name, with the certificates that prove it, and which switches need a route for it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp::cert::{Advert, Signed};
use gdp::control::{Credential, Record, Refusal, RefusalCode, Response, Route, WritersPush};
use gdp::name::{NamePrefix, NameProof};
use gdp_wire::Name;

use super::limit_reached;

/// A name by which maps are ordered as its hex digits are.
pub(super) type Key = [u8; 32];

/// Bytes of records in one message; what is left of 64 KiB is for what encloses them.
const RECORDS_SIZE: usize = 56 * 1024;

/// What an encoded record has besides certificate and statement: two proofs, two names, field names.
const RECORD_OVERHEAD: usize = 384;

/// One entity's part in a name.
#[derive(Debug)]
pub(super) struct Registration {
    pub entity: NameProof,
    pub switch: Name,
    pub credential: Credential,
    pub advert: Signed<Advert>,
    pub ends: Duration,
    /// Ends with the attachment of its entity.
    pub bound: bool,
}

impl Registration {
    pub fn reads(&self) -> bool {
        matches!(self.credential, Credential::Reader(_))
    }

    fn size(&self) -> usize {
        RECORD_OVERHEAD + self.certificate().len() + self.advert.as_bytes().len()
    }

    fn certificate(&self) -> &[u8] {
        match &self.credential {
            Credential::Writer(cert) => cert.as_bytes(),
            Credential::Reader(grant) => grant.as_bytes(),
        }
    }

    fn record(&self, now: Duration, name: Name, proof: NameProof) -> Record {
        Record {
            name,
            proof,
            entity: self.entity,
            switch: self.switch,
            credential: self.credential.clone(),
            advert: self.advert.clone(),
            expires_in: self.ends.saturating_sub(now).as_secs(),
        }
    }
}

#[derive(Debug)]
struct Topic {
    proof: NameProof,
    writers: BTreeMap<Name, Registration>,
    /// One, as long as data is unicast.
    reader: Option<(Name, Registration)>,
    /// Switches that were given a route.
    routed: BTreeSet<Name>,
}

/// What an insertion changed.
pub(super) struct Change {
    pub ends: Duration,
    pub replaced_ends: Option<Duration>,
    pub writers_changed: bool,
}

#[derive(Debug, Default)]
pub(super) struct Names(BTreeMap<Key, Topic>);

impl Names {
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether one more registration is allowed.
    pub fn check_room(&self, name: &Name, entity: &Name, new: &Registration, limit: usize) -> Result<(), Refusal> {
        let Some(topic) = self.0.get(name.as_bytes()) else {
            return if self.0.len() < limit { Ok(()) } else { Err(limit_reached(format!("{limit} names are known"))) };
        };
        if new.reads() {
            return match &topic.reader {
                Some((reader, _)) if reader != entity => Err(Refusal::new(
                    RefusalCode::SecondSubscriber,
                    format!(
                        "{name} already has the subscriber {reader}, and a name is delivered to one subscriber so far; \
                         withdraw that one first"
                    ),
                )),
                _ => Ok(()),
            };
        }
        let others = topic.writers.iter().filter(|(writer, _)| *writer != entity);
        let size = others.map(|(_, registration)| registration.size()).sum::<usize>() + new.size();
        if size > RECORDS_SIZE {
            return Err(limit_reached(format!(
                "{name} has {} writers, whose records fill a message",
                topic.writers.len()
            )));
        }
        Ok(())
    }

    /// Stores what [`Self::check_room`] allowed.
    pub fn insert(&mut self, name: Name, proof: NameProof, entity: Name, new: Registration) -> Change {
        let topic = self.0.entry(name.to_bytes()).or_insert_with(|| Topic {
            proof,
            writers: BTreeMap::new(),
            reader: None,
            routed: BTreeSet::new(),
        });
        let ends = new.ends;
        if new.reads() {
            let old = topic.reader.replace((entity, new));
            return Change { ends, replaced_ends: old.map(|(_, r)| r.ends), writers_changed: false };
        }
        let certificate = new.certificate().to_vec();
        let old = topic.writers.insert(entity, new);
        let same = old.as_ref().is_some_and(|old| old.certificate() == certificate);
        Change { ends, replaced_ends: old.map(|r| r.ends), writers_changed: !same }
    }

    pub fn remove(&mut self, name: &Key, entity: &Name, reads: bool) -> Option<Registration> {
        let topic = self.0.get_mut(name)?;
        if !reads {
            return topic.writers.remove(entity);
        }
        topic.reader.take_if(|(reader, _)| reader == entity).map(|(_, registration)| registration)
    }

    /// Drops a name that nobody has any part in.
    pub fn sweep(&mut self, name: &Key) {
        if self.0.get(name).is_some_and(|t| t.writers.is_empty() && t.reader.is_none()) {
            self.0.remove(name);
        }
    }

    pub fn has(&self, name: &Key, entity: &Name) -> bool {
        self.0.get(name).is_some_and(|topic| {
            topic.writers.contains_key(entity) || topic.reader.as_ref().is_some_and(|(reader, _)| reader == entity)
        })
    }

    /// Switches that a route for the name is for.
    pub fn routed(&self, name: &Key) -> impl Iterator<Item = &Name> {
        self.0.get(name).into_iter().flat_map(|topic| &topic.routed)
    }

    pub fn is_read(&self, name: &Key) -> bool {
        self.0.get(name).is_some_and(|topic| topic.reader.is_some())
    }

    /// Those of an entity's registrations that end with its attachment: name, and whether it reads.
    pub fn bound_of(&self, entity: &Name, names: &BTreeSet<Key>) -> Vec<(Key, bool)> {
        let topics = names.iter().filter_map(|name| Some((name, self.0.get(name)?)));
        topics
            .flat_map(|(name, topic)| {
                let writes = topic.writers.get(entity).is_some_and(|r| r.bound);
                let reads = topic.reader.as_ref().is_some_and(|(reader, r)| reader == entity && r.bound);
                [writes.then_some((*name, false)), reads.then_some((*name, true))]
            })
            .flatten()
            .collect()
    }

    /// All registrations through one switch: name, entity, whether it reads.
    pub fn registered_at(&self, switch: &Name) -> Vec<(Key, Name, bool)> {
        let mut found = Vec::new();
        for (name, topic) in &self.0 {
            let writers = topic.writers.iter().filter(|(_, r)| r.switch == *switch);
            found.extend(writers.map(|(entity, _)| (*name, *entity, false)));
            let reader = topic.reader.as_ref().filter(|(_, r)| r.switch == *switch);
            found.extend(reader.map(|(entity, _)| (*name, *entity, true)));
        }
        found
    }

    /// Names whose reader is at this switch.
    pub fn read_at(&self, switch: &Name) -> impl Iterator<Item = Key> {
        let switch = *switch;
        let at = move |topic: &Topic| topic.reader.as_ref().is_some_and(|(_, r)| r.switch == switch);
        self.0.iter().filter(move |(_, topic)| at(topic)).map(|(name, _)| *name)
    }

    /// The routes that a name needs now, by switch, and all switches that need one or were given one before.
    ///
    /// There are none unless somebody writes the name and somebody reads it.
    pub fn routes(&mut self, name: &Key, bit: impl Fn(&Name) -> Option<u8>) -> (BTreeMap<Name, Route>, BTreeSet<Name>) {
        let mut routes = BTreeMap::new();
        let Some(topic) = self.0.get_mut(name) else { return (routes, BTreeSet::new()) };
        if let Some((reader, registration)) = &topic.reader
            && let Some(bit) = bit(&registration.switch)
            && !topic.writers.is_empty()
        {
            let name = Name::from_bytes(*name);
            let route = |egress_bits| Route { name, egress_bits, local: None, writers: Vec::new() };
            for (writer, registration) in &topic.writers {
                let here = routes.entry(registration.switch).or_insert_with(|| route(1 << bit));
                here.writers.push(*writer);
            }
            routes.entry(registration.switch).or_insert_with(|| route(0)).local = Some(*reader);
        }
        let needed: BTreeSet<Name> = routes.keys().copied().collect();
        let before = std::mem::replace(&mut topic.routed, needed);
        let affected = before.into_iter().chain(routes.keys().copied()).collect();
        (routes, affected)
    }

    /// The writers of a name, as a subscriber is told.
    pub fn writers(&self, now: Duration, name: &Key) -> Response {
        let records = self.0.get(name).map_or_else(Vec::new, |topic| writer_records(now, name, topic));
        Response::Records { records, truncated: false }
    }

    pub fn writers_push(&self, now: Duration, key: &Key) -> Option<WritersPush> {
        let topic = self.0.get(key)?;
        let (reader, registration) = topic.reader.as_ref()?;
        let (switch, entity, name) = (registration.switch, *reader, Name::from_bytes(*key));
        Some(WritersPush { switch, entity, name, records: writer_records(now, key, topic) })
    }

    /// All records of the names that begin so, as far as one message holds them.
    pub fn query(&self, now: Duration, prefix: &NamePrefix) -> Response {
        let padded: Option<Name> = format!("{:0<64}", prefix.as_str()).parse().ok();
        let from = padded.unwrap_or_default().to_bytes();
        let mut matching = self.0.range(from..).take_while(|(key, _)| prefix.matches(&Name::from_bytes(**key)));
        let mut room = RECORDS_SIZE;
        let mut records = Vec::new();
        let truncated = matching.any(|(key, topic)| {
            topic.registrations().any(|registration| match room.checked_sub(registration.size()) {
                Some(rest) => {
                    room = rest;
                    records.push(registration.record(now, Name::from_bytes(*key), topic.proof));
                    false
                }
                None => true,
            })
        });
        Response::Records { records, truncated }
    }

    /// The records of names behind `after`, whole names until there are `limit`; and whether there are more.
    pub fn records(&self, now: Duration, after: Option<&Key>, limit: usize) -> (Vec<Record>, bool) {
        use std::ops::Bound::{Excluded, Unbounded};
        let mut rest = self.0.range::<Key, _>((after.map_or(Unbounded, Excluded), Unbounded));
        let mut records = Vec::new();
        for (key, topic) in rest.by_ref() {
            records.extend(topic.registrations().map(|r| r.record(now, Name::from_bytes(*key), topic.proof)));
            if records.len() >= limit {
                break;
            }
        }
        (records, rest.next().is_some())
    }
}

impl Topic {
    fn registrations(&self) -> impl Iterator<Item = &Registration> {
        self.writers.values().chain(self.reader.iter().map(|(_, registration)| registration))
    }
}

fn writer_records(now: Duration, key: &Key, topic: &Topic) -> Vec<Record> {
    topic.writers.values().map(|r| r.record(now, Name::from_bytes(*key), topic.proof)).collect()
}

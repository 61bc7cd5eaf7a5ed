//! Who publishes and who reads each name, with the certificates that prove it, and which switches need a route for it.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound;
use std::time::Duration;

use gdp::cert::{Advert, Signed};
use gdp::control::{Credential, Record, RecordPlace, Refusal, Response, Route, WritersPush};
use gdp::name::{NamePrefix, NameProof};
use gdp_wire::Name;

use super::{Limits, limit_reached};

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
        RECORD_OVERHEAD + self.credential.size() + self.advert.as_bytes().len()
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
    writers: Registrations,
    readers: Registrations,
    /// The egress bits of the readers' switches, as of the last [`Names::reroute`]; 0 while there are no routes.
    egress_bits: u64,
}

/// Those who write a name, or those who read it.
#[derive(Debug, Default)]
struct Registrations {
    by_entity: BTreeMap<Name, Registration>,
    by_switch: BTreeMap<Name, BTreeSet<Name>>,
}

/// What an insertion changed.
pub(super) struct Change {
    pub ends: Duration,
    pub replaced: Option<Registration>,
    pub writers_changed: bool,
}

#[derive(Debug, Default)]
pub(super) struct Names(BTreeMap<Key, Topic>);

impl Names {
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether one more registration is allowed.
    pub fn check_room(&self, name: &Name, entity: &Name, new: &Registration, limits: &Limits) -> Result<(), Refusal> {
        let Some(topic) = self.0.get(name.as_bytes()) else {
            let limit = limits.names;
            return if self.0.len() < limit { Ok(()) } else { Err(limit_reached(format!("{limit} names are known"))) };
        };
        if new.reads() {
            let limit = limits.readers_per_switch;
            let here = topic.readers.by_switch.get(&new.switch);
            return match here {
                Some(here) if here.len() >= limit && !here.contains(entity) => {
                    Err(limit_reached(format!("{name} has {limit} subscribers at switch {}", new.switch)))
                }
                _ => Ok(()),
            };
        }
        let others = topic.writers.by_entity.iter().filter(|(writer, _)| *writer != entity);
        let size = others.map(|(_, registration)| registration.size()).sum::<usize>() + new.size();
        if size > RECORDS_SIZE {
            let count = topic.writers.by_entity.len();
            return Err(limit_reached(format!("{name} has {count} writers, whose records fill a message")));
        }
        Ok(())
    }

    /// Stores what [`Self::check_room`] allowed.
    pub fn insert(&mut self, name: Name, proof: NameProof, entity: Name, new: Registration) -> Change {
        let topic = self.0.entry(name.to_bytes()).or_insert_with(|| Topic {
            proof,
            writers: Registrations::default(),
            readers: Registrations::default(),
            egress_bits: 0,
        });
        let (ends, reads, credential) = (new.ends, new.reads(), new.credential.clone());
        let replaced = topic.part(reads).insert(entity, new);
        let same = replaced.as_ref().is_some_and(|old| old.credential == credential);
        Change { ends, replaced, writers_changed: !reads && !same }
    }

    pub fn remove(&mut self, name: &Key, entity: &Name, reads: bool) -> Option<Registration> {
        self.0.get_mut(name)?.part(reads).remove(entity)
    }

    /// Drops a name that nobody has any part in.
    pub fn sweep(&mut self, name: &Key) {
        if self.0.get(name).is_some_and(|t| t.writers.is_empty() && t.readers.is_empty()) {
            self.0.remove(name);
        }
    }

    pub fn has(&self, name: &Key, entity: &Name) -> bool {
        self.0.get(name).is_some_and(|topic| topic.parts().any(|part| part.by_entity.contains_key(entity)))
    }

    /// Switches that a route for the name is for.
    pub fn routed(&self, name: &Key) -> impl Iterator<Item = &Name> {
        let topic = self.0.get(name).filter(|topic| topic.egress_bits != 0);
        topic.into_iter().flat_map(Topic::switches)
    }

    /// Those who read a name.
    pub fn readers(&self, name: &Key) -> impl Iterator<Item = &Name> {
        self.0.get(name).into_iter().flat_map(|topic| topic.readers.by_entity.keys())
    }

    /// Those of an entity's registrations that end with its attachment: name, and whether it reads.
    pub fn bound_of(&self, entity: &Name, names: &BTreeSet<Key>) -> Vec<(Key, bool)> {
        let topics = names.iter().filter_map(|name| Some((name, self.0.get(name)?)));
        let both = topics.flat_map(|(name, topic)| [(*name, false, &topic.writers), (*name, true, &topic.readers)]);
        let bound = both.filter(|(_, _, part)| part.by_entity.get(entity).is_some_and(|r| r.bound));
        bound.map(|(name, reads, _)| (name, reads)).collect()
    }

    /// All registrations through one switch: name, entity, whether it reads.
    pub fn registered_at(&self, switch: &Name) -> Vec<(Key, Name, bool)> {
        let mut found = Vec::new();
        for (name, topic) in &self.0 {
            for (reads, part) in [(false, &topic.writers), (true, &topic.readers)] {
                found.extend(part.at(switch).map(|entity| (*name, *entity, reads)));
            }
        }
        found
    }

    /// Names with readers at this switch, and those.
    pub fn read_at(&self, switch: &Name) -> impl Iterator<Item = (Key, Name)> {
        self.0.iter().flat_map(|(name, topic)| topic.readers.at(switch).map(|reader| (*name, *reader)))
    }

    /// The routes that change because registrations of the name `at` this switch did; `None` for one that goes.
    ///
    /// There are none unless somebody writes the name and somebody reads it. One more reader at a switch concerns that
    /// switch alone; the first or the last one there also those of the writers.
    pub fn reroute(&mut self, name: &Key, at: &Name, bit: impl Fn(&Name) -> Option<u8>) -> Vec<(Name, Option<Route>)> {
        let Some(topic) = self.0.get_mut(name) else { return Vec::new() };
        let readers_at = topic.readers.by_switch.keys().filter_map(bit);
        let now = if topic.writers.is_empty() { 0 } else { readers_at.fold(0, |bits, bit| bits | 1 << bit) };
        let mut affected = BTreeSet::from([*at]);
        match (std::mem::replace(&mut topic.egress_bits, now), now) {
            (before, now) if before == now => {}
            (0, _) | (_, 0) => affected.extend(topic.switches()),
            _ => affected.extend(topic.writers.by_switch.keys()),
        }
        affected.into_iter().map(|switch| (switch, topic.route(name, &switch))).collect()
    }

    /// The writers of a name, as a subscriber is told.
    pub fn writers(&self, now: Duration, name: &Key) -> Response {
        let records = self.0.get(name).map_or_else(Vec::new, |topic| writer_records(now, name, topic));
        Response::Records { records, truncated: false }
    }

    /// What one reader of a name is told of its writers.
    pub fn writers_push(&self, now: Duration, key: &Key, reader: &Name) -> Option<WritersPush> {
        let topic = self.0.get(key)?;
        let switch = topic.readers.by_entity.get(reader)?.switch;
        let records = writer_records(now, key, topic);
        Some(WritersPush { switch, entity: *reader, name: Name::from_bytes(*key), records })
    }

    /// The records of the names that begin so and lie behind `after`, as far as one message holds them.
    pub fn query(&self, now: Duration, prefix: &NamePrefix, after: Option<&RecordPlace>) -> Response {
        let padded: Option<Name> = format!("{:0<64}", prefix.as_str()).parse().ok();
        let begin = padded.unwrap_or_default();
        let matching = self.behind(after, begin).take_while(|(name, ..)| prefix.matches(name));
        let mut room = RECORDS_SIZE;
        let mut records = Vec::new();
        for (name, topic, registration) in matching {
            match room.checked_sub(registration.size()) {
                Some(rest) => room = rest,
                None => return Response::Records { records, truncated: true },
            }
            records.push(registration.record(now, name, topic.proof));
        }
        Response::Records { records, truncated: false }
    }

    /// At most `limit` records behind `after`, and whether there are more.
    pub fn records(&self, now: Duration, after: Option<&RecordPlace>, limit: usize) -> (Vec<Record>, bool) {
        let mut rest = self.behind(after, Name::default());
        let records = rest.by_ref().take(limit);
        let records = records.map(|(name, topic, registration)| registration.record(now, name, topic.proof)).collect();
        (records, rest.next().is_some())
    }

    /// All registrations of names from `begin` on and behind `after`, in the order of their places.
    fn behind<'a>(
        &'a self,
        after: Option<&RecordPlace>,
        begin: Name,
    ) -> impl Iterator<Item = (Name, &'a Topic, &'a Registration)> {
        let after = after.copied();
        let from = after.map_or(begin, |after| after.name.max(begin)).to_bytes();
        self.0.range(from..).flat_map(move |(key, topic)| {
            let name = Name::from_bytes(*key);
            [(false, &topic.writers), (true, &topic.readers)].into_iter().flat_map(move |(reads, part)| {
                let first = match after {
                    Some(after) if after.name == name && after.reads && !reads => None,
                    Some(after) if after.name == name && after.reads == reads => Some(Bound::Excluded(after.entity)),
                    _ => Some(Bound::Unbounded),
                };
                let listed = first.map(|first| part.by_entity.range((first, Bound::Unbounded)));
                listed.into_iter().flatten().map(move |(_, registration)| (name, topic, registration))
            })
        })
    }
}

impl Topic {
    fn part(&mut self, reads: bool) -> &mut Registrations {
        if reads { &mut self.readers } else { &mut self.writers }
    }

    fn parts(&self) -> impl Iterator<Item = &Registrations> {
        [&self.writers, &self.readers].into_iter()
    }

    /// Where there are writers or readers; some twice.
    fn switches(&self) -> impl Iterator<Item = &Name> {
        self.parts().flat_map(|part| part.by_switch.keys())
    }

    /// The route at one switch, if it needs any.
    fn route(&self, name: &Key, switch: &Name) -> Option<Route> {
        let writers: Vec<Name> = self.writers.at(switch).copied().collect();
        let locals: Vec<Name> = self.readers.at(switch).copied().collect();
        if self.egress_bits == 0 || writers.is_empty() && locals.is_empty() {
            return None;
        }
        let egress_bits = if writers.is_empty() { 0 } else { self.egress_bits };
        Some(Route { name: Name::from_bytes(*name), egress_bits, locals, writers })
    }
}

impl Registrations {
    fn is_empty(&self) -> bool {
        self.by_entity.is_empty()
    }

    fn insert(&mut self, entity: Name, new: Registration) -> Option<Registration> {
        let old = self.remove(&entity);
        self.by_switch.entry(new.switch).or_default().insert(entity);
        self.by_entity.insert(entity, new);
        old
    }

    fn remove(&mut self, entity: &Name) -> Option<Registration> {
        let old = self.by_entity.remove(entity)?;
        if let Some(here) = self.by_switch.get_mut(&old.switch) {
            here.remove(entity);
            if here.is_empty() {
                self.by_switch.remove(&old.switch);
            }
        }
        Some(old)
    }

    fn at(&self, switch: &Name) -> impl Iterator<Item = &Name> {
        self.by_switch.get(switch).into_iter().flatten()
    }
}

fn writer_records(now: Duration, key: &Key, topic: &Topic) -> Vec<Record> {
    topic.writers.by_entity.values().map(|r| r.record(now, Name::from_bytes(*key), topic.proof)).collect()
}

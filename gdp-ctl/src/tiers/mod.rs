//! Tiers: how the RIBs of different domains tell each other who publishes and reads which name. Sans-IO: time, what the own RIB knows
//! and what neighbours say go in; messages to neighbours ([`Effect`]) and what the own RIB may know of other domains ([`Change`])
//! come out. No sockets, no clock; the daemon moves what travels.
//!
//! A domain has parents, in order, and children; any depth. To each it tells what [`spread`] chooses, kept the same at both ends by a
//! [`Feed`](crate::feed::Feed). Each record carries the domains it came through: a domain that finds itself there refuses it, as it
//! refuses a parent that it is above of. Nothing is believed because of who says it: [`judge`] verifies all again.
//!
//! What a neighbour that lies can do is to withhold, and to say what its own domain alone may say.

mod judge;
pub mod peering;
mod queries;
mod side;
mod spread;
mod table;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use gdp::cert::{CertError, Locator, Membership, Signed};
use gdp::control::{
    Credential, MAX_ANCESTORS, MAX_PATH, Record, RecordPlace, Refusal, RefusalCode, TierEntry, TierHolds, TierKey,
    TierPush, TierRequest, TierResponse,
};
use gdp::keys::KeyBox;
use gdp_wire::Name;

use crate::feed::Room;
use crate::rib::Now;
use judge::{Judge, check_path};
use queries::{Climbing, PATIENCE, Queries};
use side::{HELLO, HELLO_AGAIN, Side, Told};
use table::Table;

pub use judge::{Revoked, TierRefusal};
pub use side::{HOLD, Kind, SILENCE, Standing};
pub use table::{Held, Item};

/// What one push takes: a message has at most 64 KiB, and the rest is for what encloses the entries. A single one always fits.
const ROOM: Room = Room { entries: 512, bytes: 48 * 1024 };

/// Bytes of a key that is removed.
const KEY_SIZE: usize = 160;

/// Bytes of the records in an answer.
const ANSWER_SIZE: usize = 48 * 1024;

/// What is kept of neighbours at most.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub children: usize,
    /// Of each neighbour: records, key boxes and locators together.
    pub entries: usize,
    /// Of each neighbour.
    pub bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { children: 1024, entries: 1 << 20, bytes: 1 << 30 }
    }
}

/// What is to be sent.
#[derive(Debug)]
pub enum Effect {
    /// To the RIB of a neighbouring domain. To be answered with [`Tiers::answered`].
    Ask { to: Name, sent: Sent, request: TierRequest },
    /// To who waits for this ticket.
    Answer { ticket: Ticket, response: TierResponse },
}

/// Which message it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    Hello,
    Push { generation: u64 },
    Query(Ticket),
}

/// Of a query that is answered later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(u64);

#[derive(Debug)]
pub enum Reply {
    Now(TierResponse),
    /// An [`Effect::Answer`] comes.
    Later(Ticket),
}

/// What the own RIB may know of other domains now.
#[derive(Clone, Debug)]
pub enum Change {
    Set(Item),
    Remove(TierKey),
}

/// A neighbouring domain, as `gdp-ctl` shows it.
#[derive(Clone, Debug)]
pub struct Neighbour {
    pub domain: Name,
    pub kind: Kind,
    pub standing: Standing,
    /// Entries that it says, and that it is told.
    pub entries_in: usize,
    pub entries_out: usize,
    /// What was refused of it, by reason.
    pub refused: BTreeMap<&'static str, u64>,
    /// Why it takes in only a part of what it is told.
    pub lacking: Option<String>,
}

/// The tiers as one domain's RIB sees them.
#[derive(Debug)]
pub struct Tiers {
    home: Name,
    run: u64,
    limits: Limits,
    /// In the order in which they are asked.
    parents: Vec<Name>,
    /// Domains that there is a border link to now.
    adjacent: BTreeSet<Name>,
    sides: BTreeMap<Name, Side>,
    /// What the own RIB says, and what it may know.
    own: Table,
    known: Told,
    changed_names: BTreeSet<Name>,
    changed_writers: BTreeSet<Name>,
    changed_locators: BTreeSet<Name>,
    endings: Endings,
    queries: Queries,
    answers: Vec<(Ticket, TierResponse)>,
    /// Messages of domains that are neither parent nor child.
    strangers: u64,
}

/// When what neighbours said ends.
#[derive(Debug, Default)]
struct Endings {
    at: BTreeSet<(Duration, Name, TierKey)>,
    of: BTreeMap<(Name, TierKey), Duration>,
}

impl Endings {
    fn set(&mut self, domain: Name, key: TierKey, ends: Option<Duration>) {
        let before = match ends {
            Some(ends) => self.of.insert((domain, key), ends),
            None => self.of.remove(&(domain, key)),
        };
        if let Some(before) = before {
            self.at.remove(&(before, domain, key));
        }
        if let Some(ends) = ends {
            self.at.insert((ends, domain, key));
        }
    }

    fn take_ended(&mut self, now: Duration) -> Option<(Name, TierKey)> {
        let (ends, domain, key) = self.at.first().copied().filter(|(ends, ..)| *ends <= now)?;
        self.at.remove(&(ends, domain, key));
        self.of.remove(&(domain, key));
        Some((domain, key))
    }
}

/// What the own domain says of itself.
impl Tiers {
    /// Of domain `home`, in this run of its RIB: another number each time.
    pub fn new(home: Name, run: u64, limits: Limits) -> Self {
        Self {
            home,
            run,
            limits,
            parents: Vec::new(),
            adjacent: BTreeSet::new(),
            sides: BTreeMap::new(),
            own: Table::default(),
            known: Told::default(),
            changed_names: BTreeSet::new(),
            changed_writers: BTreeSet::new(),
            changed_locators: BTreeSet::new(),
            endings: Endings::default(),
            queries: Queries::default(),
            answers: Vec::new(),
            strangers: 0,
        }
    }

    /// The domains whose RIBs are above this one, in the order in which they are asked.
    pub fn set_parents(&mut self, now: Now, parents: Vec<Name>) {
        if self.parents == parents {
            return;
        }
        let is_other = |(domain, side): &(&Name, &Side)| side.kind.is_parent() != parents.contains(domain);
        let others: Vec<Name> = self.sides.iter().filter(is_other).map(|(domain, _)| *domain).collect();
        for domain in others {
            self.clear(domain);
            self.sides.remove(&domain);
        }
        for (index, parent) in parents.iter().enumerate().filter(|(_, parent)| **parent != self.home) {
            let kind = Kind::Parent(index);
            self.sides.entry(*parent).or_insert_with(|| Side::new(now.clock, kind)).kind = kind;
        }
        self.parents = parents;
        self.all_changed();
    }

    /// The domains that there is a link to now.
    pub fn set_adjacent(&mut self, now: Now, adjacent: BTreeSet<Name>) {
        for (domain, side) in &mut self.sides {
            match (self.adjacent.contains(domain), adjacent.contains(domain)) {
                (true, false) => side.lose(now.clock),
                (false, true) => side.hello_at = now.clock,
                _ => {}
            }
        }
        self.adjacent = adjacent;
    }

    /// What an entity has stated in this domain, verified by its RIB, with the membership of the switch it is attached to.
    pub fn set_own(&mut self, now: Now, record: Record, host: Membership) -> Result<(), CertError> {
        let place = record.place()?;
        let scope = match &record.credential {
            Credential::Writer(cert) => cert.cert.claims_unverified()?.scope,
            Credential::Reader(_) => Vec::new(),
        };
        let ends = now.clock + Duration::from_secs(record.expires_in);
        let held = Held { place, record, host, path: Vec::new(), scope, ends };
        let key = TierKey::Part(place);
        if self.own.insert(key, Item::part(Arc::new(held))) {
            self.changed(key);
        }
        Ok(())
    }

    pub fn remove_own(&mut self, place: RecordPlace) {
        let key = TierKey::Part(place);
        if self.own.remove(&key).is_some() {
            self.changed(key);
        }
    }

    /// All keys of a writer in this domain, each wrapped for one reader.
    pub fn set_own_boxes(&mut self, writer: Name, boxes: Vec<Signed<KeyBox>>) -> Result<(), CertError> {
        let mut left: BTreeSet<TierKey> = self.own.boxes_of(writer).map(|(key, _)| *key).collect();
        for signed in boxes {
            let KeyBox { name, reader, epoch, .. } = signed.claims_unverified()?;
            let key = TierKey::Box { writer, reader, name, epoch };
            left.remove(&key);
            self.own.insert(key, Item::Box(Arc::new(signed)));
        }
        left.iter().for_each(|key| drop(self.own.remove(key)));
        self.changed_writers.insert(writer);
        Ok(())
    }

    /// Where this domain can be reached.
    pub fn set_own_locator(&mut self, locator: Locator) {
        let (key, domain) = (TierKey::Locator(self.home), self.home);
        if self.own.insert(key, Item::Locator { domain, locator: Arc::new(locator) }) {
            self.changed(key);
        }
    }

    /// What the own RIB may know of other domains, as far as it has changed.
    pub fn take_changes(&mut self, now: Now) -> Vec<Change> {
        self.spread();
        let everything = Room { entries: usize::MAX, bytes: usize::MAX };
        let Some(parcel) = self.known.feed.next(now.clock, everything, |_| 0) else { return Vec::new() };
        self.known.feed.answered(now.clock, parcel.generation, true);
        let removed = parcel.remove.into_iter().map(Change::Remove);
        removed.chain(parcel.set.into_iter().map(Change::Set)).collect()
    }

    /// The parts of an entity of another domain that the own RIB may know, each with whether it only passes through this domain, and
    /// the keys it has for readers here.
    pub fn known_of(&self, entity: Name) -> (Vec<(Arc<Held>, bool)>, Vec<Signed<KeyBox>>) {
        self.known.of(entity)
    }

    pub fn parents(&self) -> &[Name] {
        &self.parents
    }

    /// Where another domain can be reached, as far as the own RIB is to know.
    pub fn locator(&self, domain: Name) -> Option<&Locator> {
        match self.known.feed.entries().get(&TierKey::Locator(domain)) {
            Some(Item::Locator { locator, .. }) => Some(locator),
            _ => None,
        }
    }

    /// The domains in which somebody exchanges messages with somebody in this one.
    pub fn concerned(&self) -> impl Iterator<Item = &Name> {
        self.known.origins()
    }

    pub fn neighbours(&self) -> impl Iterator<Item = Neighbour> {
        self.sides.iter().map(|(domain, side)| Neighbour {
            domain: *domain,
            kind: side.kind,
            standing: side.standing.clone(),
            entries_in: side.table.len(),
            entries_out: side.told.feed.entries().len(),
            refused: side.refused.clone(),
            lacking: side.lacking.clone(),
        })
    }

    /// Messages of domains that are neither parent nor child.
    pub fn strangers(&self) -> u64 {
        self.strangers
    }
}

/// What neighbours ask.
impl Tiers {
    /// Answers a neighbouring domain's RIB.
    pub fn request(&mut self, now: Now, from: Name, request: TierRequest, revoked: &impl Revoked) -> Reply {
        self.tick(now);
        let answer = match request {
            TierRequest::Hello { run, holds } => self.hello(now, from, run, holds),
            TierRequest::Push(push) => self.push(now, from, *push, revoked),
            TierRequest::Query { name, path } => return self.asked(now, from, name, path),
        };
        Reply::Now(answer.unwrap_or_else(TierResponse::Refused))
    }

    fn hello(&mut self, now: Now, from: Name, run: u64, holds: Option<TierHolds>) -> Result<TierResponse, Refusal> {
        if self.parents.contains(&from) || from == self.home {
            let reason = format!(
                "domains {:#} and {from:#} each have the other for their parent: take `parent: true` away from one of them",
                self.home
            );
            self.count(from, "cycle");
            return Err(Refusal::new(RefusalCode::Unsupported, reason));
        }
        let limit = self.limits.children;
        if !self.sides.contains_key(&from) {
            if self.sides.len() - self.parents.len() >= limit {
                let reason = format!("domain {:#} has {limit} children, and that is the limit", self.home);
                return Err(Refusal::new(RefusalCode::Limit, reason));
            }
            self.sides.insert(from, Side::new(now.clock, Kind::Child));
            self.all_changed();
        }
        let mut above: BTreeSet<Name> = BTreeSet::new();
        for (parent, side) in &self.sides {
            if side.kind.is_parent() && matches!(side.standing, Standing::Up | Standing::Lost(_)) {
                above.insert(*parent);
                above.extend(&side.ancestors);
            }
        }
        let Some(side) = self.sides.get_mut(&from) else { return Err(not_a_neighbour(from)) };
        side.hello(now.clock, self.run, run, holds);
        if above.len() > MAX_ANCESTORS {
            let reason = format!("more than {MAX_ANCESTORS} domains are above domain {:#}", self.home);
            return Err(Refusal::new(RefusalCode::Limit, reason));
        }
        let ancestors = above.into_iter().collect();
        Ok(TierResponse::Hello { run: self.run, holds: side.table.holds(), ancestors })
    }

    fn push(&mut self, now: Now, from: Name, push: TierPush, revoked: &impl Revoked) -> Result<TierResponse, Refusal> {
        let Some(side) = self.sides.get_mut(&from) else {
            self.strangers += 1;
            return Err(not_a_neighbour(from));
        };
        if let Standing::Refused { reason, .. } = &side.standing {
            return Ok(TierResponse::Partly { refused: push.set.len() as u32, reason: reason.clone() });
        }
        if !side.table.begin(TierHolds { run: push.run, generation: push.generation }, push.extent) {
            side.count("generation");
            let reason = "it does not follow what is held: send the whole";
            return Err(Refusal::new(RefusalCode::ReplayedSerial, reason));
        }
        side.heard = now.clock;
        let judge = Judge { home: self.home, now, revoked };
        let (mut changed, mut refusals) = (BTreeSet::new(), Vec::new());
        for key in push.remove {
            if side.table.remove(&key).is_some() {
                self.endings.set(from, key, None);
                changed.insert(key);
            }
        }
        for entry in push.set {
            // What it said before about the same it says no more, even if what it says now is refused.
            let key = key_of(&entry);
            let judged = judge.entry(from, &side.table, entry).and_then(|(key, item, ends)| {
                let is_new = side.table.get(&key).is_none();
                let Limits { entries, bytes, .. } = self.limits;
                for (what, held, limit) in
                    [("entries", side.table.len(), entries), ("bytes", side.table.bytes() + item.size(), bytes)]
                {
                    if is_new && held >= limit {
                        return Err(TierRefusal::Full { what, limit });
                    }
                }
                Ok((key, item, ends))
            });
            match judged {
                Ok((key, item, ends)) => {
                    self.endings.set(from, key, (ends != Duration::MAX).then_some(ends));
                    if side.table.insert(key, item) {
                        changed.insert(key);
                    }
                }
                Err(refusal) => {
                    side.count(refusal.as_str());
                    refusals.push(refusal);
                    if let Some(key) = key.filter(|key| side.table.remove(key).is_some()) {
                        self.endings.set(from, key, None);
                        changed.insert(key);
                    }
                }
            }
        }
        for key in side.table.end(push.extent) {
            side.table.remove(&key);
            self.endings.set(from, key, None);
            changed.insert(key);
        }
        changed.into_iter().for_each(|key| self.changed(key));
        Ok(match refusals.first() {
            None => TierResponse::Done,
            Some(first) => TierResponse::Partly { refused: refusals.len() as u32, reason: first.to_string() },
        })
    }

    fn asked(&mut self, now: Now, from: Name, name: Name, path: Vec<Name>) -> Reply {
        let is_child = self.sides.get(&from).is_some_and(|side| side.kind == Kind::Child && !side.is_refused());
        if !is_child {
            self.strangers += 1;
            return Reply::Now(TierResponse::Refused(not_a_neighbour(from)));
        }
        if let Err(refusal) = check_path(self.home, from, &path) {
            self.count(from, refusal.as_str());
            let refusal = Refusal::new(RefusalCode::Unsupported, refusal.to_string());
            return Reply::Now(TierResponse::Refused(refusal));
        }
        self.climb(now, name, path, Some(from))
    }

    /// What other domains know of a name, as far as this one may hear it: each record is verified.
    pub fn query(&mut self, now: Now, name: Name) -> Reply {
        self.tick(now);
        self.climb(now, name, Vec::new(), None)
    }

    fn climb(&mut self, now: Now, name: Name, mut path: Vec<Name>, asked_by: Option<Name>) -> Reply {
        let asker = path.first().copied().unwrap_or(self.home);
        let (entries, truncated) = self.hear(now, name, asker, asked_by);
        if !entries.is_empty() || path.len() >= MAX_PATH || self.queries.has_missed(name, asker) {
            return Reply::Now(TierResponse::Answer { entries, truncated });
        }
        let is_asked = |parent: &&Name| {
            let is_up = self.sides.get(*parent).is_some_and(|side| side.standing == Standing::Up);
            is_up && self.adjacent.contains(*parent) && !path.contains(*parent)
        };
        let left: Vec<Name> = self.parents.iter().rev().filter(is_asked).copied().collect();
        if left.is_empty() {
            return Reply::Now(TierResponse::Answer { entries, truncated });
        }
        if !self.queries.has_room(asked_by) {
            let reason = "too many queries are on their way; try again in a moment";
            return Reply::Now(TierResponse::Refused(Refusal::new(RefusalCode::Limit, reason)));
        }
        path.push(self.home);
        let climbing = Climbing { name, path, asked_by, left, at: None, until: now.clock };
        Reply::Later(self.queries.begin(climbing))
    }

    /// What is known of a name that `asker` may hear, and did not say itself.
    fn hear(&self, now: Now, name: Name, asker: Name, asked_by: Option<Name>) -> (Vec<TierEntry>, bool) {
        let (mut entries, mut room) = (Vec::new(), ANSWER_SIZE);
        let mut said = BTreeSet::new();
        let own = asked_by.is_some().then_some(&self.own);
        let others = self.sides.iter().filter(|(domain, side)| Some(**domain) != asked_by && !side.is_refused());
        for table in own.into_iter().chain(others.map(|(_, side)| &side.table)) {
            for held in table.parts_of(name) {
                if !may_hear(held, asker, self.home) || !said.insert(held.place) {
                    continue;
                }
                match room.checked_sub(Item::part(held.clone()).size()) {
                    Some(rest) => room = rest,
                    None => return (entries, true),
                }
                entries.push(TierEntry::Part(Box::new(held.told(now.clock, self.home))));
            }
        }
        (entries, false)
    }
}

/// What goes to neighbours.
impl Tiers {
    /// Takes out what is to be sent now.
    pub fn effects(&mut self, now: Now) -> Vec<Effect> {
        self.tick(now);
        self.spread();
        let mut effects = Vec::new();
        for (domain, side) in self.sides.iter_mut().filter(|(domain, _)| self.adjacent.contains(*domain)) {
            if side.is_asked {
                continue;
            }
            let (to, home) = (*domain, self.home);
            if side.kind.is_parent() && side.hello_at <= now.clock {
                (side.is_asked, side.hello_at) = (true, now.clock + HELLO);
                let request = TierRequest::Hello { run: self.run, holds: side.table.holds() };
                effects.push(Effect::Ask { to, sent: Sent::Hello, request });
            } else if side.is_followed()
                && let Some(parcel) = side.told.feed.next(now.clock, ROOM, |item| item.map_or(KEY_SIZE, Item::size))
            {
                side.is_asked = true;
                let (generation, extent) = (parcel.generation, parcel.extent);
                let set = parcel.set.iter().map(|item| item.told(now.clock, home)).collect();
                let push = TierPush { run: self.run, generation, extent, set, remove: parcel.remove };
                let (sent, request) = (Sent::Push { generation }, TierRequest::Push(Box::new(push)));
                effects.push(Effect::Ask { to, sent, request });
            }
        }
        let idle: Vec<Ticket> = self.queries.climbing.iter().filter(|(_, c)| c.at.is_none()).map(|(t, _)| *t).collect();
        effects.extend(idle.into_iter().filter_map(|ticket| self.ask_next(now, ticket)));
        let answers = std::mem::take(&mut self.answers);
        effects.extend(answers.into_iter().map(|(ticket, response)| Effect::Answer { ticket, response }));
        effects
    }

    /// Sends a query to the next parent; if there is none, nobody knows.
    fn ask_next(&mut self, now: Now, ticket: Ticket) -> Option<Effect> {
        let climbing = self.queries.climbing.get_mut(&ticket)?;
        let Some(to) = climbing.left.pop() else {
            let Climbing { name, path, .. } = self.queries.climbing.remove(&ticket)?;
            let asker = path.first().copied().unwrap_or(self.home);
            self.queries.miss(now.clock, name, asker);
            self.answers.push((ticket, TierResponse::Answer { entries: Vec::new(), truncated: false }));
            return None;
        };
        (climbing.at, climbing.until) = (Some(to), now.clock + PATIENCE);
        let request = TierRequest::Query { name: climbing.name, path: climbing.path.clone() };
        Some(Effect::Ask { to, sent: Sent::Query(ticket), request })
    }

    /// What became of a message: the answer, or none.
    pub fn answered(&mut self, now: Now, to: Name, sent: Sent, response: Option<TierResponse>, revoked: &impl Revoked) {
        self.tick(now);
        if let Sent::Query(ticket) = sent {
            return self.query_answered(now, to, ticket, response, revoked);
        }
        let Some(side) = self.sides.get_mut(&to) else { return };
        side.is_asked = false;
        match (sent, response) {
            (Sent::Hello, Some(TierResponse::Hello { run, holds, ancestors })) => {
                side.hello(now.clock, self.run, run, holds);
                side.lacking = None;
                self.judge_parent(now, to, ancestors);
            }
            (Sent::Hello, Some(TierResponse::Refused(refusal))) => {
                side.lacking = Some(refusal.reason);
                side.lose(now.clock);
            }
            (Sent::Hello, _) => {
                side.hello_at = now.clock + HELLO_AGAIN;
                side.lose(now.clock);
            }
            (Sent::Push { generation }, response) => {
                let done = matches!(response, Some(TierResponse::Done | TierResponse::Partly { .. }));
                side.told.feed.answered(now.clock, generation, done);
                match response {
                    Some(TierResponse::Done) => side.lacking = None,
                    Some(TierResponse::Partly { reason, .. }) => side.lacking = Some(reason),
                    Some(TierResponse::Refused(refusal)) => side.lacking = Some(refusal.reason),
                    _ => {}
                }
            }
            (Sent::Query(_), _) => {}
        }
    }

    /// A parent that this domain is above of is none.
    fn judge_parent(&mut self, now: Now, parent: Name, ancestors: Vec<Name>) {
        let Some(side) = self.sides.get_mut(&parent) else { return };
        side.ancestors = ancestors.into_iter().take(MAX_ANCESTORS).collect();
        let is_below = side.ancestors.contains(&self.home);
        match &side.standing {
            Standing::Refused { until, .. } if !is_below && *until <= now.clock => side.standing = Standing::Up,
            Standing::Refused { .. } => return,
            _ if is_below => {
                side.cycles += 1;
                side.count("cycle");
                // All domains of the cycle may find it at once; not all are to try again at once.
                let until = now.clock + HOLD + spread_out(self.home, side.cycles);
                let reason = format!(
                    "a cycle: domain {:#} is above domain {parent:#}, which can be no parent of it: take `parent: true` away \
                     from one of them",
                    self.home
                );
                side.standing = Standing::Refused { until, reason };
                self.clear(parent);
            }
            _ => return,
        }
        self.all_changed();
    }

    fn query_answered(
        &mut self,
        now: Now,
        from: Name,
        ticket: Ticket,
        response: Option<TierResponse>,
        revoked: &impl Revoked,
    ) {
        let Some(climbing) = self.queries.climbing.get_mut(&ticket).filter(|climbing| climbing.at == Some(from)) else {
            return;
        };
        climbing.at = None;
        let Some(TierResponse::Answer { entries, truncated }) = response else { return };
        let asker = climbing.path.first().copied().unwrap_or(self.home);
        let (name, home) = (climbing.name, self.home);
        let judge = Judge { home, now, revoked };
        let (mut told, nothing) = (Vec::new(), Table::default());
        for entry in entries {
            match judge.entry(from, &nothing, entry) {
                Ok((_, Item::Part { held, .. }, _)) if held.place.name == name && may_hear(&held, asker, home) => {
                    told.push(TierEntry::Part(Box::new(held.told(now.clock, home))));
                }
                Ok(_) => self.count(from, "not_asked"),
                Err(refusal) => self.count(from, refusal.as_str()),
            }
        }
        if !told.is_empty() {
            self.queries.climbing.remove(&ticket);
            self.answers.push((ticket, TierResponse::Answer { entries: told, truncated }));
        }
    }

    /// An owner of a name, or a domain, has taken something back: what rests on it goes.
    pub fn reconsider(&mut self, now: Now, about: Name, revoked: &impl Revoked) {
        let judge = Judge { home: self.home, now, revoked };
        let mut gone = Vec::new();
        for (domain, side) in &self.sides {
            let concerned = |held: &&Arc<Held>| held.place.name == about || held.origin(self.home) == about;
            for held in side.table.parts().filter(concerned) {
                if let Err(refusal) = judge.still_holds(held) {
                    gone.push((*domain, TierKey::Part(held.place), refusal));
                }
            }
        }
        for (domain, key, refusal) in gone {
            self.count(domain, refusal.as_str());
            self.forget(domain, key);
        }
    }
}

/// What ends by itself.
impl Tiers {
    pub fn tick(&mut self, now: Now) {
        while let Some((domain, key)) = self.endings.take_ended(now.clock) {
            self.forget(domain, key);
        }
        let mut gone = Vec::new();
        for (domain, side) in &mut self.sides {
            if side.kind == Kind::Child && now.clock >= side.heard + SILENCE {
                side.lose(now.clock);
            }
            if matches!(side.standing, Standing::Lost(since) if now.clock >= since + HOLD) {
                gone.push(*domain);
            }
        }
        for domain in gone {
            self.clear(domain);
            match self.sides.get_mut(&domain) {
                Some(side) if side.kind.is_parent() => {
                    side.standing = Standing::Waiting;
                    side.ancestors.clear();
                }
                _ => drop(self.sides.remove(&domain)),
            }
        }
        self.queries.expire(now.clock);
        for ticket in self.queries.overdue(now.clock) {
            if let Some(climbing) = self.queries.climbing.get_mut(&ticket) {
                (climbing.at, climbing.until) = (None, now.clock + PATIENCE);
            }
        }
    }

    /// When [`Self::effects`] has something to do, if nothing else happens before.
    pub fn next_tick(&self) -> Option<Duration> {
        let sides = self.sides.iter().flat_map(|(domain, side)| {
            let can_ask = self.adjacent.contains(domain) && !side.is_asked;
            let hello = (can_ask && side.kind.is_parent()).then_some(side.hello_at);
            let retry = side.told.feed.retry_at().filter(|_| can_ask && side.is_followed());
            let silence = (side.kind == Kind::Child && side.standing == Standing::Up).then(|| side.heard + SILENCE);
            let hold = match side.standing {
                Standing::Lost(since) => Some(since + HOLD),
                _ => None,
            };
            [hello, retry, silence, hold].into_iter().flatten()
        });
        sides.chain(self.endings.at.first().map(|(ends, ..)| *ends)).chain(self.queries.next_tick()).min()
    }

    /// Forgets all that a neighbour said.
    fn clear(&mut self, domain: Name) {
        let Some(side) = self.sides.get_mut(&domain) else { return };
        for key in std::mem::take(&mut side.table).keys() {
            self.endings.set(domain, *key, None);
            self.changed(*key);
        }
    }

    fn forget(&mut self, domain: Name, key: TierKey) {
        if self.sides.get_mut(&domain).is_some_and(|side| side.table.remove(&key).is_some()) {
            self.endings.set(domain, key, None);
            self.changed(key);
        }
    }

    fn changed(&mut self, key: TierKey) {
        match key {
            TierKey::Part(place) => {
                self.queries.heard_of(place.name);
                self.changed_names.insert(place.name);
            }
            TierKey::Box { writer, .. } => drop(self.changed_writers.insert(writer)),
            TierKey::Locator(domain) => drop(self.changed_locators.insert(domain)),
        }
    }

    /// A neighbour came or went, or is another than before.
    fn all_changed(&mut self) {
        let tables = self.sides.values().map(|side| &side.table).chain([&self.own]);
        let names = tables.flat_map(Table::parts).map(|held| held.place.name);
        self.changed_names.extend(names);
    }

    fn count(&mut self, of: Name, what: &'static str) {
        if let Some(side) = self.sides.get_mut(&of) {
            side.count(what);
        }
    }
}

/// Whether somebody in domain `asker` who knows the name may hear of a part in it: writers have a scope.
fn may_hear(held: &Held, asker: Name, home: Name) -> bool {
    held.origin(home) != asker && (!held.place.role.is_writer() || held.scope.contains(&asker))
}

/// What an entry is about, believed by nobody.
fn key_of(entry: &TierEntry) -> Option<TierKey> {
    match entry {
        TierEntry::Part(abroad) => abroad.record.place().ok().map(TierKey::Part),
        TierEntry::Box(signed) => signed.claims_unverified().ok().map(|claims| TierKey::Box {
            writer: claims.writer,
            reader: claims.reader,
            name: claims.name,
            epoch: claims.epoch,
        }),
        TierEntry::Locator { domain, .. } => Some(TierKey::Locator(*domain)),
    }
}

fn not_a_neighbour(domain: Name) -> Refusal {
    let reason = format!("domain {domain:#} is neither parent nor child here: say hello first");
    Refusal::new(RefusalCode::NotAttached, reason)
}

/// Up to 60 s, another time for each domain and attempt.
fn spread_out(domain: Name, attempt: u64) -> Duration {
    let mixed = (domain.words()[0] ^ attempt).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    Duration::from_millis((mixed >> 32) % 60_000)
}

//! Requests of neighbours: hellos of children, pushes of children and parents, and queries.

use std::collections::BTreeSet;
use std::time::Duration;

use gdp_proto::control::{
    MAX_ANCESTORS, MAX_PATH, Refusal, RefusalCode, TierEntry, TierHolds, TierKey, TierPush, TierRequest, TierResponse,
};
use gdp_wire::Name;

use super::queries::Climbing;
use super::side::{DomainRelation, SessionState, Side};
use super::table::{Item, TableRecord};
use super::verification::{Announced, Judged, Revoked, Verification, check_path};
use super::{Reply, Tiers};
use crate::rib::Now;

/// Maximum bytes of the records in an answer.
const ANSWER_SIZE: usize = 48 * 1024;

impl Tiers {
    /// Answers a request of a neighbouring domain's RIB.
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
                "domains {:#} and {from:#} each have the other for their parent: take `parent: true` away from one \
                 of them",
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
            self.run += 1;
            self.sides.insert(from, Side::new(now.clock, DomainRelation::Child, self.run));
            self.all_changed();
        }
        let mut above: BTreeSet<Name> = BTreeSet::new();
        for (parent, side) in &self.sides {
            if side.kind.is_parent() && matches!(side.session, SessionState::Up | SessionState::Lost(_)) {
                above.insert(*parent);
                above.extend(&side.ancestors);
            }
        }
        let Some(side) = self.sides.get_mut(&from) else { return Err(not_a_neighbour(from)) };
        side.hello(now.clock, run, holds);
        if above.len() > MAX_ANCESTORS {
            let reason = format!("more than {MAX_ANCESTORS} domains are above domain {:#}", self.home);
            return Err(Refusal::new(RefusalCode::Limit, reason));
        }
        let ancestors = above.into_iter().collect();
        Ok(TierResponse::Hello { run: side.run, holds: side.table.holds(), ancestors })
    }

    fn push(&mut self, now: Now, from: Name, push: TierPush, revoked: &impl Revoked) -> Result<TierResponse, Refusal> {
        let Some(side) = self.sides.get_mut(&from) else {
            self.unknown_domains += 1;
            return Err(not_a_neighbour(from));
        };
        if let SessionState::Refused { reason, .. } = &side.session {
            return Ok(TierResponse::Partly { refused: push.set.len() as u32, reason: reason.clone() });
        }
        if !side.table.begin(TierHolds { run: push.run, generation: push.generation }, push.extent) {
            side.count("generation");
            let reason = "it does not follow what is held: send the whole";
            return Err(Refusal::new(RefusalCode::ReplayedSerial, reason));
        }
        side.last_seen = now.clock;
        let judge = Verification { home: self.home, now, revoked };
        let (mut changed, mut refusals) = (BTreeSet::new(), Vec::new());
        // Names whose revocations the neighbour does not know and is told.
        let mut unaware = BTreeSet::new();
        for key in push.remove {
            if side.table.remove(&key).is_some() {
                self.endings.set((from, key), None);
                changed.insert(key);
            }
        }
        for entry in push.set {
            let entry = match entry {
                TierEntry::Revocation { proof, revocation } => {
                    match judge.revocation(proof, revocation) {
                        Ok(Announced::News(kept)) => self.received_revocations.push(kept),
                        Ok(Announced::Known) => {}
                        Ok(Announced::Older(name)) => drop(unaware.insert(name)),
                        Err(refusal) => {
                            side.count(refusal.as_str());
                            refusals.push(refusal);
                        }
                    }
                    continue;
                }
                entry => entry,
            };
            // A new statement replaces the neighbour's earlier one for the same key, even if the
            // new one is refused.
            let key = key_of(&entry);
            let judged = judge.entry(from, &side.table, entry);
            let fits = |judged: &Judged| side.table.check_room(&judged.key, &judged.item, &self.limits);
            match judged.and_then(|judged| fits(&judged).map(|()| judged)) {
                Ok(Judged { key, item, ends, left_out }) => {
                    left_out.iter().for_each(|refusal| side.count(refusal.as_str()));
                    refusals.extend(left_out);
                    self.endings.set((from, key), (ends != Duration::MAX).then_some(ends));
                    if side.table.insert(key, item) {
                        changed.insert(key);
                    }
                }
                Err(refusal) => {
                    side.count(refusal.as_str());
                    unaware.extend(refusal.revoked());
                    refusals.push(refusal);
                    if let Some(key) = key.filter(|key| side.table.remove(key).is_some()) {
                        self.endings.set((from, key), None);
                        changed.insert(key);
                    }
                }
            }
        }
        for key in side.table.end(push.extent) {
            side.table.remove(&key);
            self.endings.set((from, key), None);
            changed.insert(key);
        }
        for (name, kept) in unaware.iter().filter_map(|name| Some((name, revoked.signed(name)?))) {
            side.sent.tell_revoked(*name, kept);
        }
        changed.into_iter().for_each(|key| self.changed(key));
        Ok(match refusals.first() {
            None => TierResponse::Done,
            Some(first) => TierResponse::Partly { refused: refusals.len() as u32, reason: first.to_string() },
        })
    }

    fn asked(&mut self, now: Now, from: Name, name: Name, path: Vec<Name>) -> Reply {
        let is_child =
            self.sides.get(&from).is_some_and(|side| side.kind == DomainRelation::Child && !side.is_refused());
        if !is_child {
            self.unknown_domains += 1;
            return Reply::Now(TierResponse::Refused(not_a_neighbour(from)));
        }
        if let Err(refusal) = check_path(self.home, from, &path) {
            self.count(from, refusal.as_str());
            let refusal = Refusal::new(RefusalCode::Unsupported, refusal.to_string());
            return Reply::Now(TierResponse::Refused(refusal));
        }
        self.climb(now, name, path, Some(from))
    }

    /// Queries other domains for a name. The answer holds the verified records that this domain may
    /// know.
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
            let is_up = self.sides.get(*parent).is_some_and(|side| side.session == SessionState::Up);
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

    /// Returns the known records of a name that `asker` may know, except those that `asked_by`
    /// announced.
    fn hear(&self, now: Now, name: Name, asker: Name, asked_by: Option<Name>) -> (Vec<TierEntry>, bool) {
        let (mut entries, mut room) = (Vec::new(), ANSWER_SIZE);
        let mut said = BTreeSet::new();
        let own = asked_by.is_some().then_some(&self.own);
        let others = self.sides.iter().filter(|(domain, side)| Some(**domain) != asked_by && !side.is_refused());
        for table in own.into_iter().chain(others.map(|(_, side)| &side.table)) {
            for held in table.parts_of(name) {
                if !may_hear(held, asker, self.home) || !said.insert(held.key) {
                    continue;
                }
                match room.checked_sub(Item::part(held.clone()).size()) {
                    Some(rest) => room = rest,
                    None => return (entries, true),
                }
                entries.push(TierEntry::Part(Box::new(held.to_remote(now.clock, self.home))));
            }
        }
        (entries, false)
    }
}

/// Returns whether domain `asker`, if it knows the name, may know a registration. Registrations of
/// writers have a scope.
pub(super) fn may_hear(held: &TableRecord, asker: Name, home: Name) -> bool {
    held.origin(home) != asker && (!held.key.role.is_writer() || held.scope.contains(&asker))
}

/// Returns the key of an entry without verifying it.
fn key_of(entry: &TierEntry) -> Option<TierKey> {
    match entry {
        TierEntry::Part(abroad) => abroad.record.key().ok().map(TierKey::Part),
        TierEntry::Box(signed) => signed.claims_unverified().ok().map(|claims| TierKey::Box {
            writer: claims.writer,
            reader: claims.reader,
            name: claims.name,
            epoch: claims.epoch,
        }),
        TierEntry::Locator { domain, .. } => Some(TierKey::Locator(*domain)),
        TierEntry::Revocation { .. } => None,
    }
}

fn not_a_neighbour(domain: Name) -> Refusal {
    let reason = format!("domain {domain:#} is neither parent nor child here: say hello first");
    Refusal::new(RefusalCode::NotAttached, reason)
}

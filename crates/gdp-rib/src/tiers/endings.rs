//! Expiry and removal of announced entries: by time, with a lost neighbour, or by revocation.

use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::Locator;
use gdp_proto::control::{TierEntry, TierKey};
use gdp_wire::Name;

use super::Tiers;
use super::queries::TIMEOUT;
use super::side::{DomainRelation, RESTART_TIME, SILENCE, SessionState};
use super::table::{Item, TableRecord};
use super::verification::{Judged, Revoked, Verification};
use crate::rib::Now;

impl Tiers {
    /// Applies a revocation by the owner of the name `about`, or by the domain `about`. Invalid
    /// entries are removed. Neighbours concerned with the name are told, except the one that
    /// announced the revocation.
    pub fn reconsider(&mut self, now: Now, about: Name, said_by: Option<Name>, revoked: &impl Revoked) {
        for (_, side) in self.sides.iter_mut().filter(|(domain, _)| said_by != Some(**domain)) {
            if let Some(kept) = revoked.signed(&about)
                && (side.sent.tells_of(about) || side.table.parts_of(about).next().is_some())
            {
                side.sent.tell_revoked(about, kept);
            }
        }
        let judge = Verification { home: self.home, now, revoked };
        let (mut gone, mut fewer) = (Vec::new(), Vec::new());
        let is_domain = revoked.signed(&about).is_none();
        for (domain, side) in &self.sides {
            if let Some(Item::Locator { locator, .. }) = side.table.get(&TierKey::Locator(about)) {
                let entry = TierEntry::Locator { domain: about, locator: (**locator).clone() };
                match judge.entry(*domain, &side.table, entry) {
                    Ok(judged) if judged.left_out.is_empty() => {}
                    Ok(judged) => fewer.push((*domain, judged)),
                    Err(refusal) => gone.push((*domain, TierKey::Locator(about), refusal)),
                }
            }
            let is_of_member = |held: &&Arc<TableRecord>| {
                let member = held.record.credential.member();
                member.is_some_and(|member| member.domain.name().is_ok_and(|domain| domain == about))
            };
            let elsewhere = |held: &&Arc<TableRecord>| held.key.name != about && held.path.first() != Some(&about);
            // No index finds readers whose role is of another domain than the one they are in,
            // because domains revoke rarely.
            let all = is_domain.then(|| side.table.parts()).into_iter().flatten();
            let of_members = all.filter(elsewhere).filter(is_of_member);
            for held in side.table.parts_about(about).chain(of_members) {
                if let Err(refusal) = judge.still_holds(held) {
                    gone.push((*domain, TierKey::Part(held.key), refusal));
                }
            }
        }
        for (domain, key, refusal) in gone {
            self.count(domain, refusal.as_str());
            self.forget(domain, key);
        }
        for (domain, Judged { key, item, ends, left_out }) in fewer {
            let Some(side) = self.sides.get_mut(&domain) else { continue };
            left_out.iter().for_each(|refusal| side.count(refusal.as_str()));
            if side.table.insert(key, item) {
                self.endings.set((domain, key), Some(ends));
                self.changed(key);
            }
        }
    }

    pub fn tick(&mut self, now: Now) {
        while let Some((domain, key)) = self.endings.take_due(now.clock) {
            match key {
                TierKey::Locator(about) => self.border_ended(now, domain, about),
                key => self.forget(domain, key),
            }
        }
        let mut gone = Vec::new();
        for (domain, side) in &mut self.sides {
            if side.kind == DomainRelation::Child && now.clock >= side.last_seen + SILENCE {
                side.lose(now.clock);
            }
            if matches!(side.session, SessionState::Lost(since) if now.clock >= since + RESTART_TIME) {
                gone.push(*domain);
            }
        }
        for domain in gone {
            self.clear(domain);
            match self.sides.get_mut(&domain) {
                Some(side) if side.kind.is_parent() => {
                    side.session = SessionState::Waiting;
                    side.ancestors.clear();
                }
                _ => drop(self.sides.remove(&domain)),
            }
        }
        self.queries.expire(now.clock);
        for ticket in self.queries.overdue(now.clock) {
            if let Some(climbing) = self.queries.climbing.get_mut(&ticket) {
                (climbing.at, climbing.until) = (None, now.clock + TIMEOUT);
            }
        }
    }

    /// Returns the time at which [`Self::effects`] next has work, if nothing else happens before.
    pub fn next_tick(&self) -> Option<Duration> {
        let sides = self.sides.iter().flat_map(|(domain, side)| {
            let can_ask = self.adjacent.contains(domain) && !side.is_asked;
            let hello = (can_ask && side.kind.is_parent()).then_some(side.hello_at);
            let retry = side.sent.feed.retry_at().filter(|_| can_ask && side.is_followed());
            let silence = (side.kind == DomainRelation::Child && side.session == SessionState::Up)
                .then(|| side.last_seen + SILENCE);
            let hold = match side.session {
                SessionState::Lost(since) => Some(since + RESTART_TIME),
                _ => None,
            };
            [hello, retry, silence, hold].into_iter().flatten()
        });
        sides.chain(self.endings.next()).chain(self.queries.next_tick()).min()
    }

    /// Removes the expired borders from a neighbour's locator of domain `about`. Revoked borders
    /// are already gone.
    fn border_ended(&mut self, now: Now, domain: Name, about: Name) {
        let key = TierKey::Locator(about);
        let Some(side) = self.sides.get_mut(&domain) else { return };
        let Some(Item::Locator { locator, .. }) = side.table.get(&key) else { return };
        let verified = locator.verify(about, None, now.unix).unwrap_or_default();
        let (mut borders, mut ends) = (Vec::new(), Duration::MAX);
        for (border, verified) in locator.borders.iter().zip(verified) {
            if let Ok(statement) = verified {
                borders.push(border.clone());
                ends = ends.min(now.clock_at(statement.not_after));
            }
        }
        if borders.is_empty() {
            return self.forget(domain, key);
        }
        side.table.insert(key, Item::Locator { domain: about, locator: Arc::new(Locator { borders }) });
        self.endings.set((domain, key), Some(ends));
        self.changed(key);
    }

    /// Removes all entries that a neighbour announced.
    pub(super) fn clear(&mut self, domain: Name) {
        let Some(side) = self.sides.get_mut(&domain) else { return };
        for key in std::mem::take(&mut side.table).keys() {
            self.endings.set((domain, *key), None);
            self.changed(*key);
        }
    }

    fn forget(&mut self, domain: Name, key: TierKey) {
        if self.sides.get_mut(&domain).is_some_and(|side| side.table.remove(&key).is_some()) {
            self.endings.set((domain, key), None);
            self.changed(key);
        }
    }
}

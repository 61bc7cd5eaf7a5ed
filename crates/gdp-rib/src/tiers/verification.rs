//! Verifies the announcements of neighbours before they are stored: paths, signatures, hosts,
//! scopes, limits. Each refusal has a reason that is counted.

pub use crate::tiers::refusal::TierRefusal;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::{CertError, Host, Locator, Revocation, Signed, SwitchStatement};
use gdp_core::name::NameProof;
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control::{MAX_PATH, RemoteRecord, TierEntry, TierKey};
use gdp_wire::Name;

use super::table::{Hosted, Item, RecordTable, TableRecord};
use crate::rib::Now;

/// Known revocations by owners of names and by domains.
pub trait Revoked {
    /// Returns the newest revocation of a name, which may be that of a domain.
    fn newest(&self, name: &Name) -> Option<&Revocation>;

    /// Returns the signed revocation of a name that is not a domain's.
    fn signed(&self, name: &Name) -> Option<&SignedRevocation>;
}

/// Result of checking an announced revocation.
#[derive(Debug)]
pub enum Announced {
    News(SignedRevocation),
    Known,
    /// A newer revocation of this name is known.
    Older(Name),
}

/// Context of a verification: the own domain, the time and the known revocations.
pub struct Verification<'a, R> {
    pub home: Name,
    pub now: Now,
    pub revoked: &'a R,
}

/// Verified entry.
#[derive(Debug)]
pub struct Judged {
    pub key: TierKey,
    pub item: Item,
    pub ends: Duration,
    /// Reasons why borders of a locator were left out.
    pub left_out: Vec<TierRefusal>,
}

impl<R: Revoked> Verification<'_, R> {
    /// Verifies an entry that `from` announced and `table` will store.
    /// [Revocations](Self::revocation) are not stored in tables.
    pub fn entry(&self, from: Name, table: &RecordTable, entry: TierEntry) -> Result<Judged, TierRefusal> {
        match entry {
            TierEntry::Part(abroad) => {
                let held = self.part(from, table, *abroad)?;
                let (key, ends) = (TierKey::Part(held.key), held.ends);
                Ok(Judged { key, item: Item::part(Arc::new(held)), ends, left_out: Vec::new() })
            }
            TierEntry::Box(signed) => {
                let unreadable = |source: CertError| TierRefusal::Box { writer: from, source: source.into() };
                let claims = signed.claims_unverified().map_err(unreadable)?;
                let writer = claims.writer;
                let key = TierKey::Box { writer, reader: claims.reader, name: claims.name, epoch: claims.epoch };
                let item = Item::Box(Arc::new(signed.clone()));
                let part = table.part_by(&writer).ok_or(TierRefusal::NoWriter(writer))?;
                if table.get(&key) != Some(&item) {
                    let wrong = |source: CertError| TierRefusal::Box { writer, source: source.into() };
                    let signer = part.record.entity.verify_key().map_err(|error| wrong(error.into()))?;
                    signed.verify_signature(&signer).map_err(wrong)?;
                }
                Ok(Judged { key, item, ends: Duration::MAX, left_out: Vec::new() })
            }
            TierEntry::Locator { domain, locator } => self.locator(table, domain, locator),
            TierEntry::Revocation { .. } => Err(TierRefusal::Misplaced(from)),
        }
    }

    /// Verifies an announced revocation. Only the owner can have signed it, so any neighbour may
    /// announce it.
    pub fn revocation(&self, proof: NameProof, revocation: Signed<Revocation>) -> Result<Announced, TierRefusal> {
        let unnamed = |source: CertError| TierRefusal::Revocation { name: Name::default(), source: source.into() };
        let name = proof.name().map_err(|error| unnamed(error.into()))?;
        let held = self.revoked.signed(&name);
        if held.is_some_and(|held| held.revocation == revocation) {
            return Ok(Announced::Known);
        }
        let kept = SignedRevocation { proof, revocation, origin: None };
        let claims = kept.verify().map_err(|source| TierRefusal::Revocation { name, source: source.into() })?;
        Ok(match claims.check_replaces(self.revoked.newest(&name)) {
            Ok(()) => Announced::News(kept),
            Err(_) => Announced::Older(name),
        })
    }

    fn locator(&self, table: &RecordTable, domain: Name, locator: Locator) -> Result<Judged, TierRefusal> {
        let wrong = |source: CertError| TierRefusal::Locator { domain, source: source.into() };
        if domain == self.home {
            return Err(TierRefusal::Cycle(domain));
        }
        let key = TierKey::Locator(domain);
        let verified = locator.verify(domain, self.revoked.newest(&domain), self.now.unix).map_err(wrong)?;
        let mut floors = BTreeMap::new();
        if let Some(Item::Locator { locator: held, .. }) = table.get(&key) {
            for held in &held.borders {
                let held = held.statement.claims_unverified().map_err(wrong)?;
                floors.insert(held.switch, held.serial);
            }
        }
        let (mut borders, mut left_out, mut until) = (Vec::new(), Vec::new(), u64::MAX);
        for (border, verified) in locator.borders.into_iter().zip(verified) {
            let is_older = |new: &SwitchStatement| floors.get(&new.switch).copied().filter(|floor| new.serial < *floor);
            match verified.and_then(|new| match is_older(&new) {
                Some(floor) => Err(CertError::ReplayedSerial { got: new.serial, floor }),
                None => Ok(new.not_after),
            }) {
                Ok(not_after) => {
                    until = until.min(not_after);
                    borders.push(border);
                }
                Err(source) => left_out.push(wrong(source)),
            }
        }
        if borders.is_empty() {
            return Err(left_out.into_iter().next().unwrap_or(TierRefusal::Nowhere(domain)));
        }
        let item = Item::Locator { domain, locator: Arc::new(Locator { borders }) };
        Ok(Judged { key, item, ends: self.now.clock_at(until), left_out })
    }

    /// Checks that nothing the record rests on has been revoked since its verification. Its expiry
    /// is tracked separately.
    pub fn still_holds(&self, held: &TableRecord) -> Result<(), TierRefusal> {
        let (name, switch, domain) = (held.key.name, held.key.switch, held.origin(self.home));
        let wrong_host = |source: CertError| TierRefusal::Host { switch, domain, source: source.into() };
        held.host.host.membership.check_revoked(self.revoked.newest(&domain)).map_err(wrong_host)?;
        let wrong = |source: CertError| TierRefusal::Record { name, source: source.into() };
        held.record.credential.check_member(|domain| self.revoked.newest(domain)).map_err(wrong)?;
        let Some(revocation) = self.revoked.newest(&name) else { return Ok(()) };
        let serials = held.record.credential.serials();
        let check = |serials: Vec<_>| serials.into_iter().try_for_each(|(what, serial)| revocation.check(what, serial));
        serials.and_then(check).map_err(wrong)
    }

    fn part(&self, from: Name, table: &RecordTable, abroad: RemoteRecord) -> Result<TableRecord, TierRefusal> {
        let name = abroad.record.name;
        check_path(self.home, from, &abroad.path)?;
        let origin = abroad.path[0];
        let place =
            abroad.record.key().map_err(|source: CertError| TierRefusal::Record { name, source: source.into() })?;
        let said = self.now.clock + Duration::from_secs(abroad.record.expires_in.min(u32::MAX.into()));
        if let Some(Item::Part { record: held, .. }) = table.get(&TierKey::Part(place))
            && held.origin(self.home) == origin
            && held.states_the_same(&abroad)
            && held.ends > self.now.clock
        {
            return Ok(TableRecord { path: abroad.path, ends: held.ends.min(said), ..(**held).clone() });
        }
        let host = self.host(table, abroad.record.switch, abroad.host, origin)?;
        let verified = abroad
            .record
            .verify(self.revoked.newest(&name), self.now.unix)
            .map_err(|source: CertError| TierRefusal::Record { name, source: source.into() })?;
        let (lifetime, until) = (verified.advert.lifetime, verified.not_after.min(host.not_after));
        let wrong = |source: CertError| TierRefusal::Record { name, source: source.into() };
        abroad.record.credential.check_member(|domain| self.revoked.newest(domain)).map_err(wrong)?;
        let scope = abroad.record.credential.scope().map_err(wrong)?;
        let stated = self.now.clock + Duration::from_secs(lifetime.into());
        let ends = said.min(stated).min(self.now.clock_at(until));
        if ends <= self.now.clock {
            return Err(TierRefusal::Ended(name));
        }
        let held = TableRecord { key: place, record: abroad.record, host, path: abroad.path, scope, ends };
        if !held.may_leave(self.home) {
            return Err(TierRefusal::OutOfScope { name, origin });
        }
        Ok(held)
    }

    /// Returns the verified switch of a record, reusing the verification of an earlier record.
    fn host(&self, table: &RecordTable, switch: Name, host: Host, domain: Name) -> Result<Arc<Hosted>, TierRefusal> {
        let wrong = |source: CertError| TierRefusal::Host { switch, domain, source: source.into() };
        let revocation = self.revoked.newest(&domain);
        if let Some(known) = table.host(&switch)
            && (known.domain, &known.host) == (domain, &host)
            && self.now.unix <= known.not_after
        {
            host.membership.check_revoked(revocation).map_err(wrong)?;
            return Ok(known.clone());
        }
        let (_, claims) = host.verify(domain, revocation, self.now.unix).map_err(wrong)?;
        if claims.switch != switch {
            return Err(wrong(CertError::WrongSwitch { expected: switch, got: claims.switch }));
        }
        Ok(Arc::new(Hosted { host, domain, not_after: claims.not_after }))
    }
}

/// Checks the path by which `from` announced a record to `home`. Its length must be 1 to
/// [`MAX_PATH`] domains, `from` must come last, and it must contain no cycle.
pub fn check_path(home: Name, from: Name, path: &[Name]) -> Result<(), TierRefusal> {
    let (1..=MAX_PATH, Some(last)) = (path.len(), path.last()) else {
        return Err(TierRefusal::PathLength(path.len()));
    };
    if *last != from {
        return Err(TierRefusal::NotItsOwn { from, got: *last });
    }
    let again = |(index, domain): &(usize, &Name)| **domain == home || path[..*index].contains(domain);
    match path.iter().enumerate().find(again) {
        Some((_, domain)) => Err(TierRefusal::Cycle(*domain)),
        None => Ok(()),
    }
}

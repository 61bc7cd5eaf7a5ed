//! The join service without I/O: it verifies requests, keeps the members, and makes the directory.
//!
//! Its own key cannot admit or enroll anybody: members verify the domain's signatures. The key
//! renews members, and lets them read the directory and the lists of topics that they delegate to
//! it. It owns the names of the directory and of the service.

use std::collections::{BTreeMap, BTreeSet};

use gdp_core::card::{CardError, NameCard};
use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_core::cert::enrollment::{check_label, check_lists};
use gdp_core::cert::{
    BACKDATED, CertError, Claims as _, Delegation, Enrollment, Issued, Membership, ReadGrant, RenewalDelegation,
    Revocation, Signed, issue,
};
use gdp_core::identity::{SigningKey, VerifyKey};
use gdp_wire::Name;
use serde::{Deserialize, Serialize};

use crate::directory::{Directory, MAX_DIRECTORY, MAX_MEMBERS, MAX_METADATA, Member, MemberEntry};
use crate::entity;
use crate::messages::{Application, Decision, Join, JoinReply, JoinRequest, OfferedCatalog};
use crate::{directory_card, join_card};

/// Validity in seconds of the grants for catalogs. They are issued again after half of it.
const GRANT_LIFETIME: u64 = 24 * 3600;

/// Maximum size of the stored members, in bytes.
pub const MAX_STORED: usize = 4 * MAX_DIRECTORY;

/// Maximum size of a membership's renewal in bytes, as the join service makes it.
const MAX_RENEWAL: usize = 1024;

/// Minimum time in nanoseconds between two changes of a member's entry.
const CHANGE_INTERVAL: u64 = 2_000_000_000;

/// Maximum number of applications that wait.
const MAX_APPLICATIONS: usize = 64;

/// The join service of one domain.
pub struct JoinService {
    key: SigningKey,
    domain: Name,
    members: BTreeMap<Name, Enrolled>,
    /// Serials of members that have left.
    left: BTreeSet<u64>,
    /// Times of the members' last changes in Unix nanoseconds.
    changed: BTreeMap<Name, u64>,
    /// Grants for catalogs, by catalog and reader.
    grants: BTreeMap<(Name, Name), IssuedGrant>,
    /// The newest enrollments that the domain's key signed, by the serial of the member.
    newest: BTreeMap<u64, Signed<Enrollment>>,
    /// What the domain lets this service renew, by the serial of the member.
    renewals: BTreeMap<u64, Signed<RenewalDelegation>>,
    revocation: Option<Revocation>,
    applications: Applications,
    decisions: BTreeMap<Name, Decision>,
}

/// The applications that wait, by the applicant's entity.
pub type Applications = BTreeMap<Name, Application>;

/// A member as the join service stores it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Enrolled {
    membership: Membership,
    enrollment: Signed<Enrollment>,
    catalog: Option<OfferedCatalog>,
}

/// The members, as they are stored.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    members: Vec<(Name, Enrolled)>,
    /// Serials of members that have left.
    left: Vec<u64>,
}

struct IssuedGrant {
    grant: Issued<ReadGrant>,
    /// Time of issue in Unix seconds.
    issued: u64,
}

/// A row of the directory, for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MemberRow {
    pub entity: Name,
    pub enrollment: Enrollment,
    pub catalog: Option<Name>,
    pub role: String,
    /// The domain's key that signed the membership or its invitation.
    pub signer: Option<VerifyKey>,
    /// End of the membership without a further renewal, in Unix seconds.
    pub until: u64,
}

impl JoinService {
    pub fn new(key: SigningKey, domain: Name) -> Self {
        let (members, grants, newest, renewals, left, changed) = Default::default();
        Self {
            key,
            domain,
            members,
            grants,
            newest,
            renewals,
            left,
            changed,
            revocation: None,
            applications: BTreeMap::new(),
            decisions: BTreeMap::new(),
        }
    }

    /// Restores the members from [`Self::to_bytes`].
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), CborError> {
        let Stored { members, left } = cbor::decode(bytes, MAX_STORED)?;
        (self.members, self.left) = (members.into_iter().collect(), left.into_iter().collect());
        Ok(())
    }

    /// Returns the members in a form to be stored.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CborError> {
        let members = self.members.iter().map(|(entity, enrolled)| (*entity, enrolled.clone())).collect();
        cbor::encode(&Stored { members, left: self.left.iter().copied().collect() })
    }

    /// Applies the newest revocation of the domain. Returns true if it removes a member.
    pub fn revoke(&mut self, revocation: Revocation) -> bool {
        let before = self.members.len();
        self.members.retain(|_, enrolled| enrolled.membership.check_revoked(Some(&revocation)).is_ok());
        self.revocation = Some(revocation);
        before != self.members.len()
    }

    /// Takes an enrollment that the domain signed for a member, which may not have joined yet.
    /// Returns true if it replaces the enrollment of one that has.
    pub fn enroll(&mut self, enrollment: Signed<Enrollment>) -> bool {
        let Ok(claims) = enrollment.claims_unverified() else { return false };
        let older = |known: &Signed<Enrollment>| {
            known.claims_unverified().is_ok_and(|known| known.member == claims.member && known.serial < claims.serial)
        };
        if self.newest.get(&claims.member).is_some_and(|known| !older(known)) {
            return false;
        }
        let replaced = self.members.values_mut().find(|enrolled| older(&enrolled.enrollment));
        let is_member = replaced.map(|enrolled| enrolled.enrollment = enrollment.clone()).is_some();
        self.newest.insert(claims.member, enrollment);
        is_member
    }

    /// Takes a membership that the domain's key signed in exchange for that of a member, whose new
    /// enrollment was taken before. Returns true if it replaces one.
    pub fn readmit(&mut self, membership: Membership) -> bool {
        let Ok(claims) = membership.verify_signatures(self.domain) else { return false };
        let (Some(enrolled), Some(enrollment)) =
            (self.members.get_mut(&claims.entity), self.newest.get(&claims.serial))
        else {
            return false;
        };
        if enrolled.membership.serial_unverified().is_ok_and(|known| known >= claims.serial) {
            return false;
        }
        (enrolled.membership, enrolled.enrollment) = (membership, enrollment.clone());
        true
    }

    /// Takes what the domain lets this service renew.
    pub fn delegate(&mut self, renewal: Signed<RenewalDelegation>) {
        if let Ok(claims) = renewal.claims_unverified() {
            self.renewals.insert(claims.member, renewal);
        }
    }

    /// Renews the memberships of which half has passed at `now` (Unix nanoseconds). Members take
    /// theirs from the directory. Returns true if there are any.
    pub fn renew_due(&mut self, now: u64) -> bool {
        let mut renewed = false;
        for enrolled in self.members.values_mut() {
            let Ok(claims) = enrolled.enrollment.claims_unverified() else { continue };
            let Some(delegation) = self.renewals.get(&claims.member) else { continue };
            if enrolled.membership.is_half_over(now / 1_000_000_000) == Ok(true)
                && let Ok(membership) = enrolled.membership.renew(&self.key, delegation, now)
            {
                enrolled.membership = membership;
                renewed = true;
            }
        }
        renewed
    }

    /// Takes the applications that were stored.
    pub fn restore_applications(&mut self, applications: Applications) {
        self.applications = applications;
    }

    /// Takes the decisions of a person. Their applications no longer wait. Returns true if any did.
    pub fn decide(&mut self, decisions: BTreeMap<Name, Decision>) -> bool {
        let before = self.applications.len();
        self.applications.retain(|entity, _| !decisions.contains_key(entity));
        self.decisions = decisions;
        before != self.applications.len()
    }

    pub fn applications(&self) -> &Applications {
        &self.applications
    }

    /// Answers a request of `caller` at `now` (Unix nanoseconds). The caller of this function
    /// stores and publishes the directory before it sends a reply other than a refusal.
    pub fn answer(&mut self, caller: Name, request: JoinRequest, now: u64) -> JoinReply {
        let answered = match request {
            JoinRequest::Join(join) => self.join(caller, *join, now),
            JoinRequest::Apply(application) => self.apply(caller, *application),
            JoinRequest::Leave => {
                if let Some(enrolled) = self.members.remove(&caller) {
                    self.left.extend(enrolled.enrollment.claims_unverified().ok().map(|claims| claims.member));
                }
                return JoinReply::Left;
            }
        };
        answered.unwrap_or_else(JoinReply::Refused)
    }

    fn apply(&mut self, caller: Name, application: Application) -> Result<JoinReply, String> {
        let Application { label, expose, import, read, .. } = &application;
        check_label(label).map_err(|error| error.to_string())?;
        check_lists(expose, import, read).map_err(|error| error.to_string())?;
        match self.decisions.get(&caller) {
            Some(Decision::Approved(approval)) => return Ok(JoinReply::Approved(approval.clone())),
            Some(Decision::Denied) => return Err("the domain's administrator denied it".into()),
            None => {}
        }
        if self.applications.len() >= MAX_APPLICATIONS && !self.applications.contains_key(&caller) {
            return Err(format!("{MAX_APPLICATIONS} machines wait already; have some approved or denied"));
        }
        self.applications.insert(caller, application);
        Ok(JoinReply::Pending)
    }

    fn join(&mut self, caller: Name, join: Join, now: u64) -> Result<JoinReply, String> {
        let Join { mut membership, mut enrollment, catalog } = join;
        let said = |error: CertError| error.to_string();
        let (_, invited) = enrollment.verify_for(self.domain, &membership, now / 1_000_000_000).map_err(said)?;
        // The domain may have signed other topics since the invitation.
        if let Some(newest) = self.newest.get(&invited.member) {
            enrollment = newest.clone();
        }
        let (member, claims) = enrollment.verify_for(self.domain, &membership, now / 1_000_000_000).map_err(said)?;
        membership.check_revoked(self.revocation.as_ref()).map_err(said)?;
        if member != caller {
            return Err(format!("the membership is of {member:#}, and {caller:#} shows it"));
        }
        if claims.join_service != self.key.verify_key() {
            return Err("the enrollment names another join service; have another invitation made".into());
        }
        if self.left.contains(&claims.member) {
            return Err("this member has left; have another invitation made".into());
        }
        let same = |enrolled: &Enrolled| {
            enrolled.enrollment.claims_unverified().is_ok_and(|other| other.member == claims.member)
        };
        if let Some((other, _)) = self.members.iter().find(|(entity, enrolled)| **entity != caller && same(enrolled)) {
            return Err(format!("the invitation has enrolled {other:#}, and it enrolls one; have another one made"));
        }
        if let Some(known) = self.members.get(&caller).filter(|known| same(known)) {
            let until = |membership: &Membership| membership.until_unverified().map_err(said);
            if until(&known.membership)? > until(&membership)? {
                membership = known.membership.clone();
            }
        }
        if let Some(catalog) = &catalog {
            check_catalog(catalog, caller, &claims, self.key.verify_key(), now / 1_000_000_000)?;
        }
        self.change(caller, Enrolled { membership, enrollment, catalog }, now)?;
        let key = self.key.verify_key();
        let grant = |card: Result<NameCard, CardError>| {
            let name = card.map_err(|error| error.to_string())?.name();
            Ok::<_, String>(Box::new(self.issue(name, caller, now, claims.not_after, now).map_err(said)?.into()))
        };
        Ok(JoinReply::Joined { directory: grant(directory_card(key))?, call: grant(join_card(key))? })
    }

    /// Replaces the entry of a member, if the directory then still has its bounds.
    fn change(&mut self, caller: Name, enrolled: Enrolled, now: u64) -> Result<(), String> {
        let known = self.members.get(&caller);
        if known == Some(&enrolled) {
            return Ok(());
        }
        let last = self.changed.get(&caller).copied().unwrap_or(0);
        if known.is_some() && now.saturating_sub(last) < CHANGE_INTERVAL {
            return Err("its entry changed a moment ago; try again in some seconds".into());
        }
        let before = self.members.insert(caller, enrolled);
        let valid: BTreeSet<Name> = self.members(now / 1_000_000_000).iter().map(|(member, _)| member.entity).collect();
        self.members.retain(|entity, _| valid.contains(entity));
        // Memberships grow when they are renewed.
        let renewals = self.members.values().filter(|enrolled| enrolled.membership.renewal.is_none()).count();
        let size = self.directory(now).to_bytes().map(|bytes| bytes.len() + renewals * MAX_RENEWAL);
        if self.members.len() <= MAX_MEMBERS && size.is_ok_and(|size| size <= MAX_DIRECTORY) {
            self.changed.insert(caller, now);
            return Ok(());
        }
        match before {
            Some(before) => self.members.insert(caller, before),
            None => self.members.remove(&caller),
        };
        Err(format!("the directory of the domain is full with {} members", self.members.len()))
    }

    /// Whether the member with this serial has left.
    pub fn has_left(&self, member: u64) -> bool {
        self.left.contains(&member)
    }

    /// Makes the directory at `now` (Unix nanoseconds), without expired members. Grants for
    /// catalogs are issued again after half of their validity.
    pub fn directory(&mut self, now: u64) -> Directory {
        let members = self.members(now / 1_000_000_000);
        let mut grants = std::mem::take(&mut self.grants);
        let (mut kept, mut entries) = (BTreeMap::new(), Vec::new());
        for (member, enrolled) in &members {
            let mut entry = MemberEntry {
                membership: enrolled.membership.clone(),
                enrollment: enrolled.enrollment.clone(),
                catalog: enrolled.catalog.as_ref().map(|catalog| catalog.name.clone()),
                grants: Vec::new(),
            };
            let (Some(catalog), Some(offered)) = (&member.catalog, &enrolled.catalog) else {
                entries.push(entry);
                continue;
            };
            let is_reader =
                |reader: &&Member| reader.entity != member.entity && !member.readable_by(&reader.enrollment).is_empty();
            for reader in members.iter().map(|(reader, _)| reader).filter(is_reader) {
                let key = (catalog.name(), reader.entity);
                let known = grants.remove(&key).filter(|grant| !grant.is_old(now));
                let until = now / 1_000_000_000 + GRANT_LIFETIME;
                let issue = || {
                    // A delegation that has ended grants nothing.
                    let grant = self.grant(&offered.delegation, reader.entity, until, now).ok()?;
                    Some(IssuedGrant { grant, issued: now / 1_000_000_000 })
                };
                if let Some(grant) = known.or_else(issue) {
                    entry.grants.push(grant.grant.clone());
                    kept.insert(key, grant);
                }
            }
            entries.push(entry);
        }
        self.grants = kept;
        Directory::new(entries)
    }

    /// Returns the members whose certificates hold at `now` (Unix seconds).
    pub fn rows(&self, now: u64) -> Vec<MemberRow> {
        let row = |(Member { entity, enrollment, catalog, .. }, enrolled): (Member, Enrolled)| MemberRow {
            entity,
            enrollment,
            catalog: catalog.map(|card| card.name()),
            role: enrolled.membership.cert.claims_unverified().map(|claims| claims.role).unwrap_or_default(),
            signer: enrolled.membership.signer_unverified().ok(),
            until: enrolled.membership.until_unverified().unwrap_or_default(),
        };
        self.members(now).into_iter().map(row).collect()
    }

    fn members(&self, now: u64) -> Vec<(Member, Enrolled)> {
        let member = |(entity, enrolled): (&Name, &Enrolled)| {
            let (_, enrollment) = enrolled.enrollment.verify_for(self.domain, &enrolled.membership, now).ok()?;
            let catalog = enrolled.catalog.as_ref().and_then(|offered| offered.name.card().ok());
            Some((Member { entity: *entity, enrollment, catalog, grant: None }, enrolled.clone()))
        };
        self.members.iter().filter_map(member).collect()
    }

    /// Issues a grant under a delegation to this service's key. `now` is in Unix nanoseconds.
    fn grant(
        &self,
        delegation: &Signed<Delegation>,
        to: Name,
        not_after: u64,
        now: u64,
    ) -> Result<Issued<ReadGrant>, CertError> {
        let delegated = delegation.claims_unverified()?;
        let (serial, not_after) = (now.max(delegated.serial), not_after.min(delegated.validity().not_after));
        let cert = self.issue(delegated.name, to, serial, not_after, now)?;
        Ok(Issued { cert, delegation: Some(delegation.clone()) })
    }

    fn issue(
        &self,
        name: Name,
        to: Name,
        serial: u64,
        not_after: u64,
        now: u64,
    ) -> Result<Signed<ReadGrant>, CertError> {
        let not_before = (now / 1_000_000_000).saturating_sub(BACKDATED);
        issue(&self.key, &ReadGrant { name, to: entity(to), serial, not_before, not_after })
    }
}

/// Checks that a catalog is the caller's, and that the join service may grant it.
fn check_catalog(
    OfferedCatalog { name, right, delegation }: &OfferedCatalog,
    caller: Name,
    enrollment: &Enrollment,
    key: VerifyKey,
    now: u64,
) -> Result<(), String> {
    let card = name.card().map_err(|error| error.to_string())?;
    let size: usize = name.metadata.iter().map(|(key, value)| key.len() + value.len()).sum();
    if size > MAX_METADATA {
        return Err(format!("the catalog has {size} bytes of metadata, where at most {MAX_METADATA} are allowed"));
    }
    let said = |error: CertError| error.to_string();
    let right = right.verify(card.owner_key(), now).map_err(said)?;
    if (right.name, right.entity) != (card.name(), caller) {
        return Err("the catalog is of another member".into());
    }
    let delegation = delegation.verify(card.owner_key(), now).map_err(said)?;
    let lasts = delegation.not_after >= enrollment.not_after;
    if delegation.name != card.name() || delegation.delegate != key || !delegation.read || !lasts {
        return Err("the delegation does not let the join service grant the catalog for as long as it should".into());
    }
    Ok(())
}

impl IssuedGrant {
    /// Whether half of the validity has passed, or the clock was set back. `now` is in Unix
    /// nanoseconds.
    fn is_old(&self, now: u64) -> bool {
        !(self.issued..self.issued + GRANT_LIFETIME / 2).contains(&(now / 1_000_000_000))
    }
}

#[cfg(test)]
#[path = "../tests/unit/service.rs"]
mod tests;

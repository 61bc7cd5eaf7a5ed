//! Connects the RIB with other domains: passes changes between it and [`gdp_rib::tiers`], and
//! selects the peerings of its borders. Sans-IO.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::domain::roles;
use gdp_core::cert::{CertError, Host, Locator, MAX_LOCATED, MAX_LOCATOR, Revocation, Signed, SwitchStatement};
use gdp_core::domain::Trust;
use gdp_core::keys::KeyBox;
use gdp_core::revocations::SignedRevocation;
use gdp_proto::admin::status::TierStatus;
use gdp_proto::admin::words::{TierKind, TierState};
use gdp_proto::control::{RecordKey, Refusal, RefusalCode, Response, TierEntry, TierKey, TierResponse};
use gdp_wire::Name;
use tokio::sync::oneshot;

use super::core::follow_up::{FederationEffect, FollowUp};
use super::retries::Retries;
use gdp_rib::rib::{Foreign, Now, Rib};
use gdp_rib::tiers;
use gdp_rib::tiers::{
    Effect, Hosted, Item, Reply, Revoked, TableRecord, Ticket, TierChange, TierLimits, Tiers, peering::Peering,
    peering::Peerings, peering::WantedPeerings, peering::choose,
};

/// The delay before a border that lacks a wanted peering gets its list again.
const REMINDER: Duration = Duration::from_secs(10);

/// The local RIB's exchange with other domains.
pub struct Federation {
    pub(super) tiers: Tiers,
    /// The switches of this domain that the RIB knows, with their verified statements.
    hosts: BTreeMap<Name, StatedHost>,
    /// The records that entities have stated in this domain, by switch.
    stated: BTreeMap<Name, BTreeSet<RecordKey>>,
    /// The records to export again, besides those that the RIB reports as changed.
    due: BTreeSet<RecordKey>,
    /// The wrapped keys by entity, and by the records that they came with.
    boxes: BTreeMap<Name, BTreeMap<RecordKey, Vec<Signed<KeyBox>>>>,
    /// The records of other domains that the RIB refused.
    retries: Retries,
    waiting: HashMap<Ticket, oneshot::Sender<TierResponse>>,
    peerings: Peerings,
    /// The chosen peering for each domain.
    wanted_for: BTreeMap<Name, Peering>,
    /// The peerings wanted of each border, and the time to send them next.
    pub(super) wanted: BTreeMap<Name, (WantedPeerings, Option<Duration>)>,
}

/// A verified statement of a switch of the domain.
struct StatedHost {
    host: Arc<Hosted>,
    is_border: bool,
    /// When the statement expires, on the clock of the RIB.
    ends: Duration,
}

/// The revocations that trust and RIB know.
pub(super) struct Known<'a> {
    pub rib: &'a Rib,
    pub trust: &'a Trust,
}

impl Revoked for Known<'_> {
    fn newest(&self, name: &Name) -> Option<&Revocation> {
        self.trust.revocation(name).or_else(|| self.rib.revocation(name))
    }

    fn signed(&self, name: &Name) -> Option<&SignedRevocation> {
        if self.trust.knows(name) { None } else { self.rib.signed_revocation(name) }
    }
}

impl Federation {
    /// Creates the exchange for a RIB of domain `home`, in this run.
    pub fn new(home: Name, run: u64) -> Self {
        Self {
            tiers: Tiers::new(home, run, TierLimits::default()),
            hosts: BTreeMap::new(),
            stated: BTreeMap::new(),
            due: BTreeSet::new(),
            boxes: BTreeMap::new(),
            retries: Retries::default(),
            waiting: HashMap::new(),
            peerings: Peerings::default(),
            wanted_for: BTreeMap::new(),
            wanted: BTreeMap::new(),
        }
    }

    /// Returns the time of the next timer.
    pub fn next_tick(&self) -> Option<Duration> {
        let ends = self.hosts.values().map(|host| host.ends);
        let reminders = self.wanted.values().filter_map(|(_, due)| *due);
        ends.chain(reminders).chain(self.tiers.next_tick()).chain(self.retries.next_tick()).min()
    }

    /// Verifies a switch's proof of membership. The records of its entities may then be exported
    /// with it.
    pub(super) fn show(&mut self, now: Now, trust: &Trust, switch: Name, host: Host) -> Result<(), CertError> {
        // A restarted switch proves the same. Records that were exported with that need no new
        // export.
        if self.hosts.get(&switch).is_some_and(|held| held.host.host.says_the_same(&host)) {
            return Ok(());
        }
        let home = trust.home();
        let (member, claims) = host.verify(home, trust.revocation(&home), now.unix)?;
        if claims.switch != switch {
            return Err(CertError::WrongSwitch { expected: switch, got: claims.switch });
        }
        let (is_border, ends) = (member.role == roles::BORDER, now.clock_at(claims.not_after));
        let host = Arc::new(Hosted { host, domain: home, not_after: claims.not_after });
        self.hosts.insert(switch, StatedHost { host, is_border, ends });
        self.hosts_changed([switch]);
        Ok(())
    }

    /// Drops switches that the RIB no longer knows, and expired statements.
    pub(super) fn forget_hosts(&mut self, now: Now, rib: &Rib) {
        self.retain_hosts(|switch, shown| rib.knows(switch) && now.clock < shown.ends);
    }

    /// Drops switches whose membership the domain has revoked.
    pub(super) fn recheck_hosts(&mut self, revocation: Option<&Revocation>) {
        self.retain_hosts(|_, shown| shown.host.host.membership.check_revoked(revocation).is_ok());
    }

    fn retain_hosts(&mut self, stands: impl Fn(&Name, &StatedHost) -> bool) {
        let gone: Vec<Name> =
            self.hosts.iter().filter(|(name, shown)| !stands(name, shown)).map(|(name, _)| *name).collect();
        gone.iter().for_each(|switch| _ = self.hosts.remove(switch));
        self.hosts_changed(gone);
    }

    fn hosts_changed(&mut self, switches: impl IntoIterator<Item = Name>) {
        let mut switches = switches.into_iter().peekable();
        if switches.peek().is_some() {
            self.due.extend(switches.filter_map(|switch| self.stated.get(&switch)).flatten());
            self.tiers.set_own_locator(self.locator());
        }
    }

    fn locator(&self) -> Locator {
        let mut locator = Locator::default();
        for StatedHost { host, .. } in self.hosts.values().filter(|shown| shown.is_border) {
            locator.borders.push(host.host.clone());
            if locator.borders.len() > MAX_LOCATED || locator.size() > MAX_LOCATOR {
                locator.borders.pop();
            }
        }
        locator
    }

    /// Selects the peerings to make. `is_linked` returns whether a link to the domain exists other
    /// than by this peering.
    pub(super) fn want_peerings(&mut self, now: Now, trust: &Trust, is_linked: impl Fn(Name, &Peering) -> bool) {
        let claims = |locator: &Locator| -> Vec<SwitchStatement> {
            locator.borders.iter().filter_map(|border| border.statement.claims_unverified().ok()).collect()
        };
        let may_peer = |domain: &Name| {
            let certs = trust.credentials().peers.iter().filter_map(|cert| cert.claims_unverified().ok());
            certs.into_iter().any(|cert| cert.peer == *domain && cert.rights.peering)
        };
        let concerned: Vec<Name> = self.tiers.concerned().copied().collect();
        let needed = self.peerings.follow(now.clock, concerned.into_iter());
        if needed.is_empty() && self.wanted_for.is_empty() {
            return;
        }
        let own = claims(&self.locator());
        let mut wanted: BTreeMap<Name, WantedPeerings> =
            self.wanted.keys().map(|border| (*border, WantedPeerings::new())).collect();
        for domain in needed.into_iter().filter(may_peer) {
            let peering = self.tiers.locator(domain).and_then(|locator| choose(&own, &claims(locator)));
            // An idle peering stays as it was, because the domain's locator is no longer sent.
            let before = || self.wanted_for.get(&domain).cloned();
            let Some(peering) = peering.or_else(before).filter(|peering| !is_linked(domain, peering)) else { continue };
            wanted.entry(peering.border).or_default().insert(peering.peer, peering.addrs.clone());
            self.wanted_for.insert(domain, peering);
        }
        let all: BTreeSet<Name> = wanted.values().flat_map(BTreeMap::keys).copied().collect();
        self.wanted_for.retain(|_, peering| all.contains(&peering.peer));
        for (border, wanted) in wanted {
            let (held, due) = self.wanted.entry(border).or_default();
            if *held != wanted {
                (*held, *due) = (wanted, Some(now.clock));
            }
        }
    }

    /// Schedules a resend to borders that lack a wanted link. A border may have lost its list: it
    /// restarted, or another RIB sent a different list. `is_linked` takes a border and its peer.
    pub(super) fn remind_borders(&mut self, now: Duration, is_linked: impl Fn(Name, Name) -> bool) {
        for (border, (wanted, due)) in &mut self.wanted {
            if due.is_none() && wanted.keys().any(|peer| !is_linked(*border, *peer)) {
                *due = Some(now + REMINDER);
            }
        }
    }

    /// Passes the changes of the RIB to the tiers.
    pub(super) fn follow(&mut self, now: Now, rib: &mut Rib) {
        let mut writers = BTreeSet::new();
        let changed = rib.take_changed_keys().into_iter().chain(std::mem::take(&mut self.due));
        for place in changed.collect::<BTreeSet<_>>() {
            let boxes = self.boxes.entry(place.entity).or_default();
            let export = rib.export(now, &place).filter(|export| export.origin.is_none());
            let told_before = boxes.remove(&place).is_some();
            let Some(export) = export else {
                self.tiers.remove_own(place);
                if let Some(stated) = self.stated.get_mut(&place.switch) {
                    stated.remove(&place);
                }
                if told_before {
                    writers.insert(place.entity);
                }
                continue;
            };
            self.stated.entry(place.switch).or_default().insert(place);
            if told_before || !export.boxes.is_empty() {
                writers.insert(place.entity);
                boxes.insert(place, export.boxes);
            }
            // Export only after the switch has reported.
            let Some(shown) = self.hosts.get(&place.switch) else {
                self.tiers.remove_own(place);
                continue;
            };
            if let Err(error) = self.tiers.set_own(now, export.record, shown.host.clone()) {
                tracing::error!(%error, "the RIB holds a record that cannot be told to other domains");
            }
        }
        for writer in writers {
            let boxes = self.boxes.get(&writer).into_iter().flat_map(BTreeMap::values).flatten().cloned().collect();
            if let Err(error) = self.tiers.set_own_boxes(writer, boxes) {
                tracing::error!(%error, "the RIB holds a key box that cannot be told to other domains");
            }
        }
        self.boxes.retain(|_, boxes| !boxes.is_empty());
        self.stated.retain(|_, places| !places.is_empty());
    }

    /// Passes the changes from other domains to the RIB, and retries records that it refused
    /// before.
    pub(super) fn inform(&mut self, now: Now, rib: &mut Rib) {
        let mut places: BTreeSet<RecordKey> = self.retries.take_due(now.clock).into_iter().collect();
        for change in self.tiers.take_changes(now) {
            match change {
                TierChange::Remove(TierKey::Part(place)) => {
                    places.remove(&place);
                    self.retries.settled(&place);
                    rib.sources_of(&place).iter().for_each(|next| rib.remove_foreign(now, &place, next));
                }
                TierChange::Set(Item::Part { record: held, .. }) => drop(places.insert(held.key)),
                TierChange::Set(Item::Box(signed)) => {
                    let writer = signed.claims_unverified().map(|claims| claims.writer);
                    let parts = writer.into_iter().flat_map(|writer| self.tiers.known_of(writer).parts);
                    places.extend(parts.map(|(held, _)| held.key));
                }
                // The RIB drops wrapped keys by itself, and gets records together with their
                // wrapped keys.
                TierChange::Set(Item::Locator { .. } | Item::Revocation(_)) | TierChange::Remove(_) => {}
            }
        }
        let mut boxes = BTreeMap::new();
        for place in places {
            let boxes = boxes.entry(place.entity).or_insert_with(|| self.tiers.known_of(place.entity).boxes);
            match self.tiers.known_at(&place).and_then(|(held, only_passes)| foreign(now, held, only_passes, boxes)) {
                Some(foreign) => self.give(now, rib, place, foreign),
                None => self.retries.settled(&place),
            }
        }
    }

    /// Gives the RIB one record. Once accepted, it replaces the versions from other neighbours.
    fn give(&mut self, now: Now, rib: &mut Rib, place: RecordKey, foreign: Foreign) {
        let (domain, next) = (foreign.domain, foreign.next);
        let taken = rib.set_foreign(now, foreign);
        let is_refused = taken.is_err();
        // The version of another neighbour counts until the RIB accepts this one.
        if !is_refused {
            let others: Vec<Name> = rib.sources_of(&place).into_iter().filter(|other| *other != next).collect();
            others.iter().for_each(|other| rib.remove_foreign(now, &place, other));
        }
        let refusal = match taken.unwrap_or_else(Some) {
            Some(refusal) => refusal,
            None if rib.next_of(&place) == Some(next) => return self.retries.settled(&place),
            None => Refusal::new(RefusalCode::Limit, "there was no room when it was to take the place of another"),
        };
        let is_first = if may_be_taken_later(&refusal) {
            self.retries.refused(now.clock, next, place) == 1
        } else {
            self.retries.settled(&place);
            if is_refused {
                rib.remove_foreign(now, &place, &next);
            }
            true
        };
        let domain = format_args!("{domain:#}");
        match is_first {
            true => tracing::warn!(%refusal, %domain, "the RIB does not take all that another domain told"),
            false => tracing::debug!(%refusal, %domain, "nor does the RIB take it now"),
        }
    }

    /// Returns the messages to the RIBs of other domains. Passes their answers to the waiting
    /// clients.
    pub(super) fn messages(&mut self, now: Now) -> Vec<FederationEffect> {
        let mut messages = Vec::new();
        for effect in self.tiers.effects(now) {
            match effect {
                Effect::Answer { ticket, response } => {
                    if let Some(answer) = self.waiting.remove(&ticket) {
                        // The receiver may be dropped.
                        let _ = answer.send(response);
                    }
                }
                Effect::Ask { to, sent, request } => messages.push(FederationEffect::Message { to, sent, request }),
            }
        }
        messages
    }

    /// Asks the RIBs of other domains for a name that this one does not know.
    pub(super) fn query(&mut self, now: Now, name: Name) -> FollowUp {
        let reply = self.tiers.query(now, name);
        self.wait(reply, true)
    }

    pub(super) fn wait(&mut self, reply: Reply, is_query: bool) -> FollowUp {
        match reply {
            Reply::Now(response) if is_query => FollowUp::Answer(records(response)),
            Reply::Now(response) => FollowUp::Answer(Response::Tier(Box::new(response))),
            Reply::Later(ticket) => {
                let (answer, waiting) = oneshot::channel();
                self.waiting.insert(ticket, answer);
                FollowUp::Await { waiting, is_query }
            }
        }
    }

    /// What `gdp-ctl status` shows of the neighbouring domains.
    pub fn status(&self) -> Vec<TierStatus> {
        let shown = self.tiers.neighbours().map(|neighbour| {
            let (state, reason) = match neighbour.session {
                tiers::SessionState::Waiting => (TierState::Waiting, neighbour.lacking),
                tiers::SessionState::Up => (TierState::Up, neighbour.lacking),
                tiers::SessionState::Lost(_) => (TierState::Lost, None),
                tiers::SessionState::Refused { reason, .. } => (TierState::Refused, Some(reason)),
            };
            TierStatus {
                domain: neighbour.domain,
                kind: if neighbour.kind.is_parent() { TierKind::Parent } else { TierKind::Child },
                state,
                reason,
                entries_in: neighbour.entries_in,
                entries_out: neighbour.entries_out,
                refused: neighbour.refused.into_iter().map(|(why, count)| (why.to_owned(), count)).collect(),
            }
        });
        shown.collect()
    }
}

/// Converts the answer of other domains to a query into a response to an entity.
pub(super) fn records(response: TierResponse) -> Response {
    match response {
        TierResponse::Answer { entries, truncated } => {
            let records = entries.into_iter().filter_map(|entry| match entry {
                TierEntry::Part(remote) => Some(remote.record),
                _ => None,
            });
            Response::Records { records: records.collect(), truncated }
        }
        TierResponse::Refused(refusal) => refusal.into(),
        _ => Response::Records { records: Vec::new(), truncated: false },
    }
}

/// Converts a record of another domain for the RIB. Returns `None` if its path is empty.
fn foreign(now: Now, held: Arc<TableRecord>, only_passes: bool, boxes: &[Signed<KeyBox>]) -> Option<Foreign> {
    let (domain, next) = (*held.path.first()?, *held.path.last()?);
    let mut record = held.record.clone();
    record.expires_in = held.ends.saturating_sub(now.clock).as_secs();
    Some(Foreign { record, domain, next, hops: held.path.len() as u32, boxes: boxes.to_vec(), local: !only_passes })
}

/// Returns whether the refusal may end later, because other state of the RIB caused it instead of
/// the record itself.
fn may_be_taken_later(refusal: &Refusal) -> bool {
    use RefusalCode::{Limit, ReplayedSerial, Unsupported, WrongSwitch};
    matches!(refusal.code, Limit | ReplayedSerial | Unsupported | WrongSwitch)
}

#[cfg(test)]
#[path = "../../tests/unit/serve/federation.rs"]
mod tests;

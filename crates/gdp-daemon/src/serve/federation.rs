//! What a RIB has to do with other domains: keeps it and [`gdp_rib::tiers`] informed of each other,
//! and finds which peerings its borders are to make. Sans-IO.

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

/// After so long a border that lacks a wanted peering is told again.
const REMINDER: Duration = Duration::from_secs(10);

/// What the RIB here has to do with other domains.
pub struct Federation {
    pub(super) tiers: Tiers,
    /// The switches of the domain that the RIB knows, as they have shown themselves to it.
    hosts: BTreeMap<Name, StatedHost>,
    /// What entities have stated in this domain, by switch.
    stated: BTreeMap<Name, BTreeSet<RecordKey>>,
    /// What is to be told anew, besides what the RIB says has changed.
    due: BTreeSet<RecordKey>,
    /// By entity and the places it was told with.
    boxes: BTreeMap<Name, BTreeMap<RecordKey, Vec<Signed<KeyBox>>>>,
    /// The places abroad of which the RIB did not take what it was told.
    retries: Retries,
    waiting: HashMap<Ticket, oneshot::Sender<TierResponse>>,
    peerings: Peerings,
    /// By domain.
    wanted_for: BTreeMap<Name, Peering>,
    /// What is wanted of each border, and when it is to be told.
    pub(super) wanted: BTreeMap<Name, (WantedPeerings, Option<Duration>)>,
}

/// What a switch of the domain has shown; it has been verified.
struct StatedHost {
    host: Arc<Hosted>,
    is_border: bool,
    /// When it is over, on the clock of the RIB.
    ends: Duration,
}

/// What is known here of what was taken back.
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
    /// Of a RIB in the domain `home`, in this run.
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

    /// When it has something to do by itself.
    pub fn next_tick(&self) -> Option<Duration> {
        let ends = self.hosts.values().map(|host| host.ends);
        let reminders = self.wanted.values().filter_map(|(_, due)| *due);
        ends.chain(reminders).chain(self.tiers.next_tick()).chain(self.retries.next_tick()).min()
    }

    /// A switch shows that it is of the domain: what was stated there may be told with it.
    pub(super) fn show(&mut self, now: Now, trust: &Trust, switch: Name, host: Host) -> Result<(), CertError> {
        // A switch that has begun anew says the same again: what was told with that need not be
        // told anew.
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

    /// Forgets switches that are gone for good, and what is over.
    pub(super) fn forget_hosts(&mut self, now: Now, rib: &Rib) {
        self.retain_hosts(|switch, shown| rib.knows(switch) && now.clock < shown.ends);
    }

    /// The domain has taken something back.
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

    /// Finds out which peerings are to be made. `is_linked`: there is a link to this domain, other
    /// than by this peering.
    pub(super) fn want_peerings(&mut self, now: Now, trust: &Trust, is_linked: impl Fn(Name, &Peering) -> bool) {
        let claims = |locator: &Locator| -> Vec<SwitchStatement> {
            locator.borders.iter().filter_map(|border| border.statement.claims_unverified().ok()).collect()
        };
        let may_peer = |domain: &Name| {
            let certs = trust.papers().peers.iter().filter_map(|cert| cert.claims_unverified().ok());
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
            // While it is idle, as before: who is there is not told any more.
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

    /// As long as a border lacks a link that is wanted of it, it is told again what is: what it was
    /// told may be lost, by a border that has begun anew or that another RIB has told something
    /// else. `is_linked`: a border and its peer.
    pub(super) fn remind_borders(&mut self, now: Duration, is_linked: impl Fn(Name, Name) -> bool) {
        for (border, (wanted, due)) in &mut self.wanted {
            if due.is_none() && wanted.keys().any(|peer| !is_linked(*border, *peer)) {
                *due = Some(now + REMINDER);
            }
        }
    }

    /// Tells the tiers what has changed in the RIB.
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
            // Once the switch has reported.
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

    /// Tells the RIB what it may know of other domains: what has changed, and what it refused
    /// before for what is over by now.
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
                // The RIB lets go of boxes by itself, and of places it is told with which they go.
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

    /// Tells the RIB of one place: of all neighbours that have told of it, what this one says
    /// counts.
    fn give(&mut self, now: Now, rib: &mut Rib, place: RecordKey, foreign: Foreign) {
        let (domain, next) = (foreign.domain, foreign.next);
        let taken = rib.set_foreign(now, foreign);
        let is_refused = taken.is_err();
        // What another said counts until this does.
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

    /// What the tiers send to the RIBs of other domains; who waits for an answer of theirs gets it.
    pub(super) fn messages(&mut self, now: Now) -> Vec<FederationEffect> {
        let mut messages = Vec::new();
        for effect in self.tiers.effects(now) {
            match effect {
                Effect::Answer { ticket, response } => {
                    if let Some(answer) = self.waiting.remove(&ticket) {
                        // Whoever asked may be gone.
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

/// What other domains answered to a query, as an entity is told it.
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

/// As the RIB is told it; none of what this domain says itself.
fn foreign(now: Now, held: Arc<TableRecord>, only_passes: bool, boxes: &[Signed<KeyBox>]) -> Option<Foreign> {
    let (domain, next) = (*held.path.first()?, *held.path.last()?);
    let mut record = held.record.clone();
    record.expires_in = held.ends.saturating_sub(now.clock).as_secs();
    Some(Foreign { record, domain, next, hops: held.path.len() as u32, boxes: boxes.to_vec(), local: !only_passes })
}

/// Whether it was refused for what else the RIB holds, and not for what it is.
fn may_be_taken_later(refusal: &Refusal) -> bool {
    use RefusalCode::{Limit, ReplayedSerial, Unsupported, WrongSwitch};
    matches!(refusal.code, Limit | ReplayedSerial | Unsupported | WrongSwitch)
}

#[cfg(test)]
#[path = "../../tests/unit/serve/federation.rs"]
mod tests;

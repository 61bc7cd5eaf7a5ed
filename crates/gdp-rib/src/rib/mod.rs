//! The routing information base (RIB): which entities are attached where, which of them publish and
//! read which name, and what the FIB of each switch must hold. It performs no I/O: time and
//! requests go in, a response and [`Effect`]s come out. It has no sockets, no clock and no data
//! plane. The daemon in `gdp-daemon` transports the messages.
//!
//! The RIB verifies everything before it stores it: the derivation of names, certificates and their
//! revocations, the entity's own statement and its serial. It derives the FIB of every switch from
//! the stored state and from the paths in [`paths`]. This file holds the inputs and outputs.
//! [`statements`] handles the statements of entities, [`key_boxes`] and [`revoke`] their key boxes
//! and revocations, [`reports`] the reports of switches. [`interdomain`] stores the records of
//! other domains, [`exports`] returns those for them.
//!
//! Nobody has to trust the RIB. An entity verifies the records of its peers again. A reader
//! verifies the signature of the writer on a wrapped key. An entity keeps a revocation that is
//! newer than the RIB's. A lying RIB can only withhold.

mod bits;
mod border_links;
mod entities;
mod exports;
pub mod fib;
mod inboxes;
mod interdomain;
mod journal;
mod key_boxes;
mod model;
mod names;
mod peer_updates;
mod registration;
mod remote_registrations;
mod reports;
mod restore;
mod revocations;
mod revoke;
mod statements;
#[cfg(test)]
#[path = "../../tests/unit/rib/mod.rs"]
mod tests;
mod topic;
mod wrapped_keys;

pub use crate::rib::model::{Limits, Now, UpdateId};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::cert::Revocation;
use gdp_core::name::{NamePrefix, NameProof};
use gdp_core::revocations::{Origin, SignedRevocation};
use gdp_proto::control::{
    EntityRequest, FibPush, NameRole, PeersPush, Record, RecordKey, Refusal, RefusalCode, Response, Route,
};
use gdp_wire::Name;

use crate::rib::model::{NameBytes, RegistrationKey};
use crate::rib::remote_registrations::RemoteRegistrations;
use crate::topology::Paths;
use bits::Bits;
use border_links::BorderLinks;
use entities::Entities;
use fib::{About, Fib, Pushed};
use inboxes::Inboxes;
use journal::Journal;
use names::Names;
use peer_updates::{PeerUpdates, UpdateSource};
use revocations::Revocations;
use wrapped_keys::WrappedKeyStore;

pub use crate::rib::border_links::BorderLink;
pub use crate::rib::remote_registrations::Foreign;
pub use exports::Export;
pub use journal::Item;
pub use restore::{MAX_ITEM, RestoreError, decode_item, encode_item};

/// Time for which the RIB keeps the names of an unreachable switch, as in graceful restart (RFC
/// 4724). A restart or a short partition must not cost the FIBs.
pub const RESTART_TIME: Duration = Duration::from_secs(10);

/// Time after which the RIB asks a reachable switch that has not reported for its report.
const UNREPORTED: Duration = Duration::from_secs(5);

/// Message of the RIB to a switch.
#[derive(Clone, Debug)]
pub enum Effect {
    /// FIB push, to be answered with [`Rib::pushed`].
    Fib(FibPush),
    /// Update to an entity through its switch, to be answered with [`Rib::update_answered`].
    Peers(PeersPush),
    /// The RIB holds no attachment of `entity` at `switch`, so the entity must attach again. If the
    /// entity is the switch itself, the RIB does not know the switch, which must report in full.
    Detach { switch: Name, entity: Name },
}

/// The routing information base of one domain.
#[derive(Debug)]
pub struct Rib {
    root: Name,
    run: RibRun,
    limits: Limits,
    bits: Bits,
    /// Paths from the RIB's own switch, as that switch computed them last.
    paths: Paths,
    switches: BTreeMap<Name, Switch>,
    entities: Entities,
    names: Names,
    inboxes: Inboxes,
    boxes: WrappedKeyStore,
    revocations: Revocations,
    /// Revocations by related domains, by domain.
    domains: BTreeMap<Name, Revocation>,
    peer_updates: PeerUpdates,
    ways: BorderLinks,
    remote: RemoteRegistrations,
    timers: Timers,
    detached: BTreeSet<(Name, Name)>,
    /// Reachable switches that have not reported, each with the time at which they are asked to.
    unreported: BTreeMap<Name, Duration>,
    /// Switches restored from an earlier RIB that have not reported to this one.
    silent: BTreeSet<Name>,
    journal: Journal,
}

/// One run of a RIB.
#[derive(Clone, Copy, Debug)]
pub struct RibRun {
    /// Identifier of the run: different each time, and higher than that of the RIB before, as far
    /// as it is known.
    pub id: u64,
    /// End of the settling time (as [`Now::clock`]). Until then switches also honour the routes of
    /// an earlier RIB, while entities repeat their statements to this one.
    pub settling: Duration,
}

#[derive(Debug, Default)]
struct Switch {
    fib: Fib,
    attached: BTreeSet<Name>,
    /// Time at which the switch is forgotten unless it becomes reachable again.
    forget_at: Option<Duration>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Timer {
    /// A registration of this name may have expired.
    Name(NameBytes),
    Attachment {
        entity: Name,
        lane: u8,
    },
    Switch {
        switch: Name,
    },
    Unreported {
        switch: Name,
    },
    /// The grace period of changed border links may be over.
    BorderLinks,
    Settled,
}

type Timers = BTreeSet<(Duration, Timer)>;

impl Rib {
    /// Creates an empty RIB that runs beside the switch `root`.
    pub fn new(root: Name, run: RibRun, limits: Limits) -> Self {
        Self {
            root,
            run,
            limits,
            bits: Bits::default(),
            paths: Paths::default(),
            switches: BTreeMap::new(),
            entities: Entities::default(),
            names: Names::default(),
            inboxes: Inboxes::default(),
            boxes: WrappedKeyStore::default(),
            revocations: Revocations::default(),
            domains: BTreeMap::new(),
            peer_updates: PeerUpdates::default(),
            ways: BorderLinks::default(),
            remote: RemoteRegistrations::default(),
            timers: Timers::from([(run.settling, Timer::Settled)]),
            detached: BTreeSet::new(),
            unreported: BTreeMap::new(),
            silent: BTreeSet::new(),
            journal: Journal::default(),
        }
    }

    /// Answers a request of `entity`, or of a tool acting for it, that arrives through the switch
    /// `origin`.
    pub fn request(
        &mut self,
        now: Now,
        origin: Name,
        entity: Option<&NameProof>,
        by_tool: bool,
        request: &EntityRequest,
    ) -> Response {
        self.tick(now);
        let answer = match request {
            EntityRequest::Query { prefix, after } => self.query(now, origin, entity, prefix, after.as_ref()),
            EntityRequest::Revoke { proof, revocation } => {
                self.revoke(now, Origin { through: origin, by_tool }, proof, revocation)
            }
            _ => self.entity_request(now, origin, entity, by_tool, request),
        };
        answer.unwrap_or_else(Response::from)
    }

    /// Answers a query. Anybody who knows a full name may query it. To list names by prefix, the
    /// entity must be attached here or be the asking switch itself (for its operators).
    fn query(
        &mut self,
        now: Now,
        origin: Name,
        entity: Option<&NameProof>,
        prefix: &NamePrefix,
        after: Option<&RecordKey>,
    ) -> Result<Response, Refusal> {
        if prefix.full().is_none() {
            self.check_reported(origin)?;
            let entity = entity.and_then(|proof| proof.name().ok());
            let is_here = |entity: Name| entity == origin || self.entities.is_attached_at(&entity, &origin);
            if !entity.is_some_and(is_here) {
                let reason =
                    "names are listed for entities that are attached, and for switches; ask for a name in full";
                return Err(Refusal::new(RefusalCode::NotEntitled, reason));
            }
        }
        Ok(self.names.query(now.clock, prefix, after))
    }

    /// Checks that a switch is known. If not, the RIB asks it to report, and the refusal invites
    /// another attempt.
    fn check_reported(&mut self, switch: Name) -> Result<(), Refusal> {
        if self.switches.contains_key(&switch) {
            return Ok(());
        }
        self.detached.insert((switch, switch));
        let reason = format!("switch {switch} has not reported its links to the RIB yet; try again in a moment");
        Err(Refusal::new(RefusalCode::Unreachable, reason))
    }

    /// Processes a switch's full report of its attached entities and its current egress bit.
    pub fn report(&mut self, now: Now, switch: &NameProof, attached: &[Name], own_bit: Option<u8>) -> Response {
        self.tick(now);
        let taken = self.try_report(now, switch, attached, own_bit);
        taken.map_or_else(Response::from, |()| Response::Reported { run: self.run.id })
    }

    /// Replaces the paths from the RIB's own switch.
    pub fn set_paths(&mut self, now: Now, paths: Paths) {
        self.tick(now);
        self.paths = paths;
        self.settle_bits();
        self.check_reachability(now);
    }

    /// Ends the attachment of an entity to `switch` and all registrations bound to it. Its
    /// attachments elsewhere stay.
    pub fn detach(&mut self, now: Now, switch: &Name, entity: &Name) -> Response {
        self.tick(now);
        self.end_attachments_at(entity, switch);
        Response::Done
    }

    /// Processes all expired timers. Call it when [`Self::next_tick`] says so; requests also call
    /// it.
    pub fn tick(&mut self, now: Now) {
        while let Some((at, timer)) = self.timers.first().copied() {
            if at > now.clock {
                break;
            }
            self.timers.pop_first();
            match timer {
                Timer::Name(name) => self.end_due(now, name),
                Timer::Attachment { entity, lane } => {
                    if let Some(attachment) = self.entities.attachment(&entity, lane) {
                        self.detached.insert((attachment.switch, entity));
                    }
                    self.end_attachment(&entity, lane);
                }
                Timer::Switch { switch } => self.forget_switch(&switch),
                Timer::Unreported { switch } => self.ask_to_report(now, switch),
                Timer::BorderLinks => self.end_earlier_ways(now),
                Timer::Settled => {
                    std::mem::take(&mut self.silent).iter().for_each(|switch| self.forget_switch(switch));
                    // Full transfers make the switches drop routes that nobody stated again.
                    self.switches.values_mut().for_each(|switch| switch.fib.restart());
                    self.peer_updates.settled();
                }
            }
        }
        self.peer_updates.tick(now.clock);
    }

    /// Returns the time at which [`Self::tick`] and [`Self::effects`] next have work, if nothing
    /// else happens before.
    pub fn next_tick(&self) -> Option<Duration> {
        let retries = self.switches.values().filter_map(|s| s.fib.retry_at());
        retries.chain(self.timers.first().map(|(at, _)| *at)).chain(self.peer_updates.retry_at()).min()
    }

    /// Returns the messages to send now. At most one FIB push per switch is in flight, and at most
    /// one update per entity, name and role.
    pub fn effects(&mut self, now: Now) -> Vec<Effect> {
        let mut effects: Vec<_> = std::mem::take(&mut self.detached)
            .into_iter()
            // The entity may have attached there in the meantime.
            .filter(|(switch, entity)| !self.entities.is_attached_at(entity, switch))
            .map(|(switch, entity)| Effect::Detach { switch, entity })
            .collect();
        let (run, settling) = (self.run.id, now.clock < self.run.settling);
        for (name, switch) in &mut self.switches {
            let Some(own_bit) = self.bits.of(name) else { continue };
            let about = About { switch: *name, run, settling, own_bit };
            effects.extend(switch.fib.next(now.clock, about).map(Effect::Fib));
        }
        let (names, boxes, revocations) = (&self.names, &self.boxes, &self.revocations);
        let source = UpdateSource { run, settling, now: now.clock, names, boxes, revocations };
        effects.extend(self.peer_updates.next(source).into_iter().map(Effect::Peers));
        effects
    }

    /// Records the outcome of the FIB push with this generation to the switch.
    pub fn pushed(&mut self, now: Now, switch: &Name, generation: u64, outcome: Pushed) {
        if let Some(switch) = self.switches.get_mut(switch) {
            switch.fib.answered(now.clock, generation, outcome);
        }
    }

    /// Records whether an update arrived at its entity. A lost update is repeated in full through
    /// another of its switches, or later.
    pub fn update_answered(&mut self, now: Now, told: UpdateId, arrived: bool) {
        let other = self.other_switch_of(told.registration_key, &told.switch);
        if let Some(held) = self.peer_updates.answered(now.clock, told, arrived, other) {
            self.names.note_sent(&told.registration_key, &told.switch, held);
        }
    }

    /// Returns whether all switches that need a route for the entity's statement have settled.
    ///
    /// A switch settles when it has acknowledged the route, or failed to, and its egress bit is on
    /// the map. This covers the name and the inboxes of the entity and its counterparts.
    pub fn is_settled(&self, name: &Name, entity: &Name, role: NameRole) -> bool {
        let is_on_the_map = |switch: &Name| {
            let bit = self.bits.of(switch);
            !self.paths.reaches(switch) || bit.is_none_or(|bit| self.paths.bits.get(&bit) == Some(switch))
        };
        let settled = |switch: &Name, name: &Name| {
            let holds = |held: &Switch| held.fib.is_settled(name.as_bytes()) && is_on_the_map(switch);
            self.switches.get(switch).is_none_or(holds)
        };
        let key = name.to_bytes();
        let switches = self.names.bound_at(&key, entity, role);
        let others = |at| self.names.bound(&key, role.counterpart()).map(move |(other, _)| (at, other));
        self.names.routed(&key, self.map()).iter().all(|switch| settled(switch, name))
            && self.inboxes.routed(entity, self.map()).iter().all(|switch| settled(switch, entity))
            && switches.flat_map(others).all(|(at, other)| settled(&at, &other))
    }

    /// Checks that no switch lacks room for the routes of a settled statement at `at`. If one does,
    /// the RIB unregisters the statement there and refuses it.
    pub fn check_room(&mut self, name: &Name, entity: &Name, role: NameRole, at: &Name) -> Result<(), Refusal> {
        let lacking = |switch| self.switches.get(switch)?.fib.lacking();
        // Frames of a service go to the inboxes of its parties.
        let inboxes = self.inboxes.routed(entity, self.map()).into_iter().filter(|_| role.is_of_service());
        let routed: Vec<Name> = self.names.routed(name.as_bytes(), self.map()).into_iter().chain(inboxes).collect();
        let Some(reason) = routed.iter().find_map(lacking) else { return Ok(()) };
        let refusal = Refusal::new(RefusalCode::Limit, reason);
        self.unregister(RegistrationKey { name: name.to_bytes(), entity: *entity, role }, *at);
        Err(refusal)
    }
}

/// State that `gdp-ctl status` and `rib dump` show.
impl Rib {
    /// Returns the identifier of the RIB's [run](RibRun).
    pub fn run(&self) -> u64 {
        self.run.id
    }

    /// Returns the newest known revocation by the owner of a name.
    pub fn revocation(&self, name: &Name) -> Option<&Revocation> {
        self.revocations.claims(name.as_bytes())
    }

    /// Returns the newest known revocation of a name with its owner's signature.
    pub fn signed_revocation(&self, name: &Name) -> Option<&SignedRevocation> {
        self.revocations.get(name.as_bytes()).map(|held| &held.signed)
    }

    /// Returns the egress bit of a switch.
    pub fn bit(&self, switch: &Name) -> Option<u8> {
        self.bits.of(switch)
    }

    /// Returns the switches with their egress bits and attached entities.
    pub fn switches(&self) -> impl Iterator<Item = (Name, u8, Vec<Name>)> {
        self.switches
            .iter()
            .filter_map(|(name, state)| Some((*name, self.bits.of(name)?, state.attached.iter().copied().collect())))
    }

    /// Returns whether a switch has reported and has not been forgotten since.
    pub fn knows(&self, switch: &Name) -> bool {
        self.switches.contains_key(switch)
    }

    /// Returns the number of switches with an egress bit.
    pub fn switch_count(&self) -> usize {
        self.switches.keys().filter(|switch| self.bits.of(switch).is_some()).count()
    }

    /// Returns at most `limit` records after key `after`, and whether more follow.
    pub fn records(&self, now: Now, after: Option<RecordKey>, limit: usize) -> (Vec<Record>, bool) {
        self.names.records(now.clock, after.as_ref(), limit)
    }

    /// Returns the number of names with a writer or a reader.
    pub fn name_count(&self) -> usize {
        self.names.len()
    }

    /// Returns the number of names with readers or callers but without publisher or server, and
    /// those names.
    pub fn without_publisher(&self) -> (usize, impl Iterator<Item = Name>) {
        self.names.without_publisher()
    }

    /// Returns the routes that a switch's FIB should hold.
    pub fn desired(&self, switch: &Name) -> Vec<Route> {
        self.switches.get(switch).map_or_else(Vec::new, |s| s.fib.routes().cloned().collect())
    }
}

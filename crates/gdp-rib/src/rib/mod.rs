//! The routing information base: which entities are attached where, who publishes and reads which
//! name, and what each switch's FIB must therefore hold. Sans-IO: time and requests go in, a
//! response and [`Effect`]s come out. No sockets, no clock, no data plane; the daemon in
//! `gdp-daemon` moves what travels.
//!
//! Nothing is stored before it is verified: the derivation of names, the certificates and what
//! their owner has revoked of them, the entity's own statement and its serial. The FIB of every
//! switch is derived from what is stored, and from the paths in [`paths`]. Here is what goes in and
//! out; [`statements`] takes what entities state, [`key_boxes`] and [`revoke`] what goes with it,
//! [`reports`] what switches say; [`interdomain`] takes what RIBs of other domains tell, and
//! [`exports`] gives what they may be told.
//!
//! Nobody has to believe this: who is told of others verifies their records again, who is given a
//! key verifies who wrapped it, and who holds a newer revocation than the RIB gives keeps to that.
//! What a RIB that lies can do is to withhold.

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

/// How long the names of a switch that nobody reaches stay: a restart or a short partition must not
/// cost the FIBs.
pub const RESTART_TIME: Duration = Duration::from_secs(10);

/// How long after it is reached a switch that has not reported is asked to.
const UNREPORTED: Duration = Duration::from_secs(5);

/// What the RIB has to say to a switch.
#[derive(Clone, Debug)]
pub enum Effect {
    /// To be answered with [`Rib::pushed`].
    Fib(FibPush),
    /// To an entity, through its switch. To be answered with [`Rib::update_answered`].
    Peers(PeersPush),
    /// The RIB holds no attachment of `entity` at `switch`: it must attach again. If the entity is
    /// the switch itself, the RIB does not know the switch: it must report in full.
    Detach { switch: Name, entity: Name },
}

/// The routing information base of one domain.
#[derive(Debug)]
pub struct Rib {
    root: Name,
    run: RibRun,
    limits: Limits,
    bits: Bits,
    /// From the RIB's own switch, as that last said.
    paths: Paths,
    switches: BTreeMap<Name, Switch>,
    entities: Entities,
    names: Names,
    inboxes: Inboxes,
    boxes: WrappedKeyStore,
    revocations: Revocations,
    /// What domains have taken back, by domain: of those that this one has to do with.
    domains: BTreeMap<Name, Revocation>,
    peer_updates: PeerUpdates,
    ways: BorderLinks,
    remote: RemoteRegistrations,
    timers: Timers,
    detached: BTreeSet<(Name, Name)>,
    /// Switches that are reached and have not reported, and when they are asked to.
    unreported: BTreeMap<Name, Duration>,
    /// Switches that an earlier RIB knew and that have not reported to this one.
    silent: BTreeSet<Name>,
    journal: Journal,
}

/// One life of a RIB.
#[derive(Clone, Copy, Debug)]
pub struct RibRun {
    /// Higher than that of the RIB before, as far as that can be known; and another number each
    /// time.
    pub id: u64,
    /// Until this time (as [`Now::clock`]) what an earlier RIB had the switches hold counts
    /// besides: entities are still to state again what they had stated to that one.
    pub settling: Duration,
}

#[derive(Debug, Default)]
struct Switch {
    fib: Fib,
    attached: BTreeSet<Name>,
    /// When the switch is forgotten, unless it is reached again.
    forget_at: Option<Duration>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Timer {
    /// Some part in this name may be over.
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
    /// Frames come no more by ways that are gone.
    BorderLinks,
    Settled,
}

type Timers = BTreeSet<(Duration, Timer)>;

impl Rib {
    /// An empty RIB that runs beside the switch `root`.
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

    /// Answers what `entity`, or a tool that speaks for it, asks through the switch `origin`.
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

    /// What is known of a name anybody may hear who knows the name; to have names listed, one has
    /// to be attached here, or be the switch that asks (for those who run it).
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

    /// Whether a switch is known. If not, it is told to report, and what it asks is worth another
    /// attempt.
    fn check_reported(&mut self, switch: Name) -> Result<(), Refusal> {
        if self.switches.contains_key(&switch) {
            return Ok(());
        }
        self.detached.insert((switch, switch));
        let reason = format!("switch {switch} has not reported its links to the RIB yet; try again in a moment");
        Err(Refusal::new(RefusalCode::Unreachable, reason))
    }

    /// Takes a switch's report of all entities attached to it, with the egress bit it has had so
    /// far.
    pub fn report(&mut self, now: Now, switch: &NameProof, attached: &[Name], own_bit: Option<u8>) -> Response {
        self.tick(now);
        let taken = self.try_report(now, switch, attached, own_bit);
        taken.map_or_else(Response::from, |()| Response::Reported { run: self.run.id })
    }

    /// The paths from the RIB's own switch are now these.
    pub fn set_paths(&mut self, now: Now, paths: Paths) {
        self.tick(now);
        self.paths = paths;
        self.settle_bits();
        self.check_reachability(now);
    }

    /// An entity's link to `switch` is gone, and with it all that was bound to it. What it has
    /// elsewhere stays.
    pub fn detach(&mut self, now: Now, switch: &Name, entity: &Name) -> Response {
        self.tick(now);
        self.end_attachments_at(entity, switch);
        Response::Done
    }

    /// Lets end what ends by itself. Call when [`Self::next_tick`] says; requests do it too.
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
                    // So that they let go of what nobody has stated again.
                    self.switches.values_mut().for_each(|switch| switch.fib.restart());
                    self.peer_updates.settled();
                }
            }
        }
        self.peer_updates.tick(now.clock);
    }

    /// When [`Self::tick`] and [`Self::effects`] have something to do, if nothing else happens
    /// before.
    pub fn next_tick(&self) -> Option<Duration> {
        let retries = self.switches.values().filter_map(|s| s.fib.retry_at());
        retries.chain(self.timers.first().map(|(at, _)| *at)).chain(self.peer_updates.retry_at()).min()
    }

    /// Takes out what is to be sent now. To each switch one FIB push is out at a time, to each
    /// entity one about a name and role.
    pub fn effects(&mut self, now: Now) -> Vec<Effect> {
        let mut effects: Vec<_> = std::mem::take(&mut self.detached)
            .into_iter()
            // It may have attached there in the meantime.
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

    /// What became of the FIB push of this generation to the switch.
    pub fn pushed(&mut self, now: Now, switch: &Name, generation: u64, outcome: Pushed) {
        if let Some(switch) = self.switches.get_mut(switch) {
            switch.fib.answered(now.clock, generation, outcome);
        }
    }

    /// Whether what an entity was to be told arrived; if not, it is told the whole through another
    /// of its switches, or a while later.
    pub fn update_answered(&mut self, now: Now, told: UpdateId, arrived: bool) {
        let other = self.other_switch_of(told.registration_key, &told.switch);
        if let Some(held) = self.peer_updates.answered(now.clock, told, arrived, other) {
            self.names.note_sent(&told.registration_key, &told.switch, held);
        }
    }

    /// Whether all switches that need a route for what an entity stated have answered that they
    /// hold it (or have failed to answer), and are on the map with their egress bit: for the name,
    /// and for what it and its counterparts send each other.
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

    /// To be asked once a statement at `at` is settled: takes it back there if a switch has no room
    /// for the route it needs.
    pub fn check_room(&mut self, name: &Name, entity: &Name, role: NameRole, at: &Name) -> Result<(), Refusal> {
        let lacking = |switch| self.switches.get(switch)?.fib.lacking();
        // Frames of a service go to the names of its parties.
        let inboxes = self.inboxes.routed(entity, self.map()).into_iter().filter(|_| role.is_of_service());
        let routed: Vec<Name> = self.names.routed(name.as_bytes(), self.map()).into_iter().chain(inboxes).collect();
        let Some(reason) = routed.iter().find_map(lacking) else { return Ok(()) };
        let refusal = Refusal::new(RefusalCode::Limit, reason);
        self.unregister(RegistrationKey { name: name.to_bytes(), entity: *entity, role }, *at);
        Err(refusal)
    }
}

/// What `gdp-ctl status` and `rib dump` show.
impl Rib {
    /// The number of its [run](RibRun).
    pub fn run(&self) -> u64 {
        self.run.id
    }

    /// The newest that is known of what the owner of a name has taken back.
    pub fn revocation(&self, name: &Name) -> Option<&Revocation> {
        self.revocations.claims(name.as_bytes())
    }

    /// The same, as its owner signed it.
    pub fn signed_revocation(&self, name: &Name) -> Option<&SignedRevocation> {
        self.revocations.get(name.as_bytes()).map(|held| &held.signed)
    }

    /// Egress bit of a switch.
    pub fn bit(&self, switch: &Name) -> Option<u8> {
        self.bits.of(switch)
    }

    /// Switches with their egress bits and attached entities.
    pub fn switches(&self) -> impl Iterator<Item = (Name, u8, Vec<Name>)> {
        self.switches
            .iter()
            .filter_map(|(name, state)| Some((*name, self.bits.of(name)?, state.attached.iter().copied().collect())))
    }

    /// Whether a switch has reported, and is not forgotten since.
    pub fn knows(&self, switch: &Name) -> bool {
        self.switches.contains_key(switch)
    }

    /// How many there are.
    pub fn switch_count(&self) -> usize {
        self.switches.keys().filter(|switch| self.bits.of(switch).is_some()).count()
    }

    /// At most `limit` records behind `after`, and whether there are more.
    pub fn records(&self, now: Now, after: Option<RecordKey>, limit: usize) -> (Vec<Record>, bool) {
        self.names.records(now.clock, after.as_ref(), limit)
    }

    /// Names with a writer or a reader.
    pub fn name_count(&self) -> usize {
        self.names.len()
    }

    /// How many names there are that somebody reads or calls, and nobody publishes or serves; and
    /// those.
    pub fn without_publisher(&self) -> (usize, impl Iterator<Item = Name>) {
        self.names.without_publisher()
    }

    /// What a switch's FIB should hold.
    pub fn desired(&self, switch: &Name) -> Vec<Route> {
        self.switches.get(switch).map_or_else(Vec::new, |s| s.fib.routes().cloned().collect())
    }
}

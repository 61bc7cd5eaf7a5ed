//! The routing information base: which entities are attached where, who publishes and reads which name, and what each
//! switch's FIB must therefore hold. Sans-IO: time and requests go in, a response and [`Effect`]s come out. No sockets,
//! no clock, no data plane; the daemon in [`crate::serve`] moves what travels.
//!
//! Nothing is stored before it is verified: the derivation of names, the owner's certificate, the entity's own
//! statement and its serial. The FIB of every switch is derived from what is stored, and from the paths in [`paths`].

mod entities;
pub mod fib;
mod names;
pub mod paths;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp::cert::{AdvertOp, CertError, Speaker, authorise_advertise, authorise_subscribe, authorise_withdraw};
use gdp::control::{
    Credential, EntityRequest, FibPush, Record, RecordPlace, Refusal, RefusalCode, Response, WritersPush,
};
use gdp::name::NameProof;
use gdp_wire::Name;

use entities::{Attachment, Entities};
use fib::{About, Fib, Pushed};
use names::{Key, Names, Registration};
use paths::Topology;

/// How long the names of a switch that nobody reaches stay: a restart or a short partition must not cost the FIBs.
pub const HOLD: Duration = Duration::from_secs(10);

/// Readers that are told of writers at once.
const TELLING: usize = 256;

/// A moment, on both clocks that matter.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// Unix seconds: certificates are judged by it.
    pub unix: u64,
    /// Since any fixed moment; never goes back. Everything that lasts is counted on it.
    pub clock: Duration,
}

/// What a RIB holds at most.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub entities: usize,
    pub names: usize,
    pub names_per_entity: usize,
    pub attached_per_switch: usize,
    /// Subscribers of one name at one switch.
    pub readers_per_switch: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            entities: 65_536,
            names: 1 << 20,
            names_per_entity: 16_384,
            attached_per_switch: gdp_wire::table::MAX_LINKS as usize,
            readers_per_switch: gdp_wire::table::MAX_LINKS as usize,
        }
    }
}

/// What the RIB has to say to a switch.
#[derive(Clone, Debug)]
pub enum Effect {
    /// To be answered with [`Rib::pushed`].
    Fib(FibPush),
    /// To be answered with [`Rib::told`].
    Writers(WritersPush),
    /// The RIB holds no attachment of `entity` at `switch`: it must attach again. If the entity is the switch itself,
    /// the RIB does not know the switch: it must report in full.
    Detach { switch: Name, entity: Name },
}

/// The routing information base of one domain.
#[derive(Debug)]
pub struct Rib {
    root: Name,
    run: Run,
    limits: Limits,
    topology: Topology,
    switches: BTreeMap<Name, Switch>,
    entities: Entities,
    names: Names,
    timers: Timers,
    /// Readers of names whose writers changed.
    untold: BTreeSet<(Key, Name)>,
    /// Those that are being told; one message at a time each, so that an older one never arrives last.
    telling: BTreeSet<(Key, Name)>,
    detached: BTreeSet<(Name, Name)>,
}

/// One life of a RIB.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    /// Another number each time.
    pub id: u64,
    /// Until this time (as [`Now::clock`]) what an earlier RIB had the switches hold counts besides: entities are still to
    /// state again what they had stated to that one.
    pub settling: Duration,
}

#[derive(Debug, Default)]
struct Switch {
    fib: Fib,
    attached: BTreeSet<Name>,
    /// When the switch is forgotten, unless it is reached again.
    hold: Option<Duration>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Timer {
    Registration { name: Key, entity: Name, reads: bool },
    Attachment { entity: Name },
    Entity { entity: Name },
    Switch { switch: Name },
    Settled,
}

type Timers = BTreeSet<(Duration, Timer)>;

impl Rib {
    /// An empty RIB that runs beside the switch `root`.
    pub fn new(root: Name, run: Run, limits: Limits) -> Self {
        Self {
            root,
            run,
            limits,
            topology: Topology::default(),
            switches: BTreeMap::new(),
            entities: Entities::default(),
            names: Names::default(),
            timers: Timers::from([(run.settling, Timer::Settled)]),
            untold: BTreeSet::new(),
            telling: BTreeSet::new(),
            detached: BTreeSet::new(),
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
        if let EntityRequest::Query { prefix, after } = request {
            return self.names.query(now.clock, prefix, after.as_ref());
        }
        self.entity_request(now, origin, entity, by_tool, request).unwrap_or_else(Response::from)
    }

    /// Takes a switch's report of its neighbours with their costs, and after a (re)connect of all attached entities; with the
    /// egress bit it has had so far.
    pub fn report(
        &mut self,
        now: Now,
        switch: &NameProof,
        neighbours: &[(Name, u32)],
        attached: Option<&[Name]>,
        own_bit: Option<u8>,
    ) -> Response {
        self.tick(now);
        self.try_report(now, switch, neighbours, attached, own_bit).map_or_else(Response::from, |()| Response::Done)
    }

    /// An entity's link to `switch` is gone, and with it all that was bound to it. Nothing happens if the entity is
    /// attached elsewhere by now.
    pub fn detach(&mut self, now: Now, switch: &Name, entity: &Name) -> Response {
        self.tick(now);
        if self.entities.attachment(entity).is_some_and(|a| a.switch == *switch) {
            self.end_attachment(entity);
        }
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
                Timer::Registration { name, entity, reads } => self.unregister(name, entity, reads),
                Timer::Attachment { entity } => {
                    if let Some(attachment) = self.entities.attachment(&entity) {
                        self.detached.insert((attachment.switch, entity));
                    }
                    self.end_attachment(&entity);
                }
                Timer::Entity { entity } => self.entities.forget(&entity),
                Timer::Switch { switch } => self.forget_switch(now, &switch),
                // So that they let go of what nobody has stated again.
                Timer::Settled => self.switches.values_mut().for_each(|switch| switch.fib.restart()),
            }
        }
    }

    /// When [`Self::tick`] and [`Self::effects`] have something to do, if nothing else happens before.
    pub fn next_tick(&self) -> Option<Duration> {
        let retries = self.switches.values().filter_map(|s| s.fib.retry_at());
        retries.chain(self.timers.first().map(|(at, _)| *at)).min()
    }

    /// Takes out what is to be sent now. To each switch one FIB push is out at a time, to each reader one about a name, and
    /// [`TELLING`] to readers at all.
    pub fn effects(&mut self, now: Now) -> Vec<Effect> {
        let mut effects: Vec<_> = std::mem::take(&mut self.detached)
            .into_iter()
            // It may have attached there in the meantime.
            .filter(|(switch, entity)| self.entities.attachment(entity).is_none_or(|a| a.switch != *switch))
            .map(|(switch, entity)| Effect::Detach { switch, entity })
            .collect();
        let (run, settling) = (self.run.id, now.clock < self.run.settling);
        for (name, switch) in &mut self.switches {
            let Some(own_bit) = self.topology.bit(name) else { continue };
            let about = About { switch: *name, run, settling, own_bit, reach: self.topology.reach(name) };
            effects.extend(switch.fib.next(now.clock, about).map(Effect::Fib));
        }
        let room = TELLING.saturating_sub(self.telling.len());
        let next: Vec<_> = self.untold.difference(&self.telling).take(room).copied().collect();
        for (key, reader) in next {
            self.untold.remove(&(key, reader));
            if let Some(push) = self.names.writers_push(now.clock, &key, &reader) {
                self.telling.insert((key, reader));
                effects.push(Effect::Writers(push));
            }
        }
        effects
    }

    /// What became of the FIB push of this generation to the switch.
    pub fn pushed(&mut self, now: Now, switch: &Name, generation: u64, outcome: Pushed) {
        if let Some(switch) = self.switches.get_mut(switch) {
            switch.fib.answered(now.clock, generation, outcome);
        }
    }

    /// A reader of a name was told of its writers, or could not be: then it asks when it hears one it does not know.
    pub fn told(&mut self, name: &Name, reader: &Name) {
        self.telling.remove(&(name.to_bytes(), *reader));
    }

    /// Whether all switches that need a route for the name have answered that they hold it (or have failed to answer).
    pub fn is_settled(&self, name: &Name) -> bool {
        let settled = |switch| self.switches.get(switch).is_none_or(|s| s.fib.is_settled(name.as_bytes()));
        self.names.routed(name.as_bytes()).all(settled)
    }

    /// To be asked once a statement is settled: takes it back if a switch has no room for the route it needs.
    pub fn check_room(&mut self, name: &Name, entity: &Name, reads: bool) -> Result<(), Refusal> {
        let lacking = |switch| self.switches.get(switch)?.fib.lacking();
        let Some(reason) = self.names.routed(name.as_bytes()).find_map(lacking) else { return Ok(()) };
        let refusal = Refusal::new(RefusalCode::Limit, reason);
        self.unregister(name.to_bytes(), *entity, reads);
        Err(refusal)
    }

    fn entity_request(
        &mut self,
        now: Now,
        origin: Name,
        entity: Option<&NameProof>,
        by_tool: bool,
        request: &EntityRequest,
    ) -> Result<Response, Refusal> {
        if !self.switches.contains_key(&origin) {
            self.detached.insert((origin, origin));
            let reason = format!("switch {origin} has not reported its links to the RIB yet; try again in a moment");
            return Err(Refusal::new(RefusalCode::Unreachable, reason));
        }
        let proof = entity.ok_or_else(|| {
            Refusal::new(RefusalCode::Malformed, "only a query may be anonymous: show the key of the entity")
        })?;
        let speaker = self.speaker(now, origin, proof)?;
        let here = self.entities.attachment(&speaker.entity).is_some_and(|a| a.switch == origin);
        if !here && !by_tool && !matches!(request, EntityRequest::Attach { .. }) {
            let reason = format!("{} is not attached to switch {origin}; attach first", speaker.entity);
            return Err(Refusal::new(RefusalCode::NotAttached, reason));
        }
        match request {
            EntityRequest::Attach { rt_cert, resumes } => {
                let cert = rt_cert.verify(&speaker.entity_key, now.unix).map_err(refusal)?;
                if cert.entity != speaker.entity {
                    return Err(refusal(CertError::WrongEntity { expected: speaker.entity, got: cert.entity }));
                }
                if cert.switch != origin {
                    return Err(refusal(CertError::WrongSwitch { expected: origin, got: cert.switch }));
                }
                if !by_tool {
                    let ends = now.clock.saturating_add(Duration::from_secs(cert.not_after - now.unix));
                    self.attach(&speaker, ends, *resumes)?;
                }
                Ok(Response::Attached { serial: speaker.floor })
            }
            EntityRequest::Advertise { proof: name, ad_cert, advert } => {
                let (cert, statement) = authorise_advertise(&speaker, name, ad_cert, advert, None).map_err(refusal)?;
                check_supported(statement.op)?;
                self.raise_floor(now, &speaker, statement.serial, cert.not_after)?;
                let ends = lifetime(now, statement.lifetime, cert.not_after)?;
                let credential = Credential::Writer(ad_cert.clone());
                let advert = advert.clone();
                let registration =
                    Registration { entity: *proof, switch: origin, credential, advert, ends, bound: !by_tool };
                self.register(statement.name, *name, speaker.entity, registration)?;
                Ok(Response::Done)
            }
            EntityRequest::Subscribe { proof: name, grant, advert } => {
                let (cert, statement) = authorise_subscribe(&speaker, name, grant, advert, None).map_err(refusal)?;
                check_supported(statement.op)?;
                self.raise_floor(now, &speaker, statement.serial, cert.not_after)?;
                let ends = lifetime(now, statement.lifetime, cert.not_after)?;
                let credential = Credential::Reader(grant.clone());
                let advert = advert.clone();
                let registration =
                    Registration { entity: *proof, switch: origin, credential, advert, ends, bound: !by_tool };
                self.register(statement.name, *name, speaker.entity, registration)?;
                Ok(self.names.writers(now.clock, &statement.name.to_bytes()))
            }
            EntityRequest::Withdraw { advert } => {
                let statement = authorise_withdraw(&speaker, advert).map_err(refusal)?;
                self.entities.raise_floor(&speaker.entity, statement.serial);
                let key = statement.name.to_bytes();
                if !self.names.has(&key, &speaker.entity) {
                    let reason = format!("{} neither publishes nor reads {}", speaker.entity, statement.name);
                    return Err(Refusal::new(RefusalCode::NotFound, reason));
                }
                self.unregister(key, speaker.entity, false);
                self.unregister(key, speaker.entity, true);
                Ok(Response::Done)
            }
            EntityRequest::Revoke { .. } => {
                Err(Refusal::new(RefusalCode::Unsupported, "this RIB does not know revocations"))
            }
            EntityRequest::Query { prefix, after } => Ok(self.names.query(now.clock, prefix, after.as_ref())),
        }
    }

    fn speaker(&self, now: Now, switch: Name, proof: &NameProof) -> Result<Speaker, Refusal> {
        let not_a_key = |error| refusal(CertError::Crypto(error));
        let entity = proof.name().map_err(not_a_key)?;
        let entity_key = proof.verify_key().map_err(not_a_key)?;
        Ok(Speaker { entity, entity_key, switch, floor: self.entities.floor(&entity), now: now.unix })
    }

    /// Attaching again at the same switch only renews, if it resumes what was: a link that does not come back is told of by a
    /// detach. Attaching elsewhere ends what was; the old switch is told, in case its link is still up: the entity must not
    /// believe that it is attached there.
    fn attach(&mut self, speaker: &Speaker, ends: Duration, resumes: bool) -> Result<(), Refusal> {
        let limit = self.limits.attached_per_switch;
        let full = |s: &Switch| s.attached.len() >= limit && !s.attached.contains(&speaker.entity);
        if self.switches.get(&speaker.switch).is_some_and(full) {
            return Err(limit_reached(format!("switch {} has {limit} attached entities", speaker.switch)));
        }
        match self.entities.attachment(&speaker.entity) {
            Some(old) if old.switch == speaker.switch && resumes => {
                self.timers.remove(&(old.ends, Timer::Attachment { entity: speaker.entity }));
            }
            Some(old) => {
                self.end_attachment(&speaker.entity);
                if old.switch != speaker.switch {
                    self.detached.insert((old.switch, speaker.entity));
                }
            }
            None => {}
        }
        let Some(switch) = self.switches.get_mut(&speaker.switch) else { return Ok(()) };
        let entity = self.entities.get_or_insert(speaker.entity, self.limits.entities, &mut self.timers)?;
        entity.attachment = Some(Attachment { switch: speaker.switch, ends });
        switch.attached.insert(speaker.entity);
        self.timers.insert((ends, Timer::Attachment { entity: speaker.entity }));
        Ok(())
    }

    fn end_attachment(&mut self, entity: &Name) {
        let Some(attachment) = self.entities.take_attachment(entity) else { return };
        self.timers.remove(&(attachment.ends, Timer::Attachment { entity: *entity }));
        if let Some(switch) = self.switches.get_mut(&attachment.switch) {
            switch.attached.remove(entity);
        }
        for (name, reads) in self.names.bound_of(entity, self.entities.names(entity)) {
            self.unregister(name, *entity, reads);
        }
        self.entities.retire(entity, &mut self.timers);
    }

    /// A verified statement is spent, whatever becomes of it: nobody may present it again.
    fn raise_floor(&mut self, now: Now, speaker: &Speaker, serial: u64, not_after: u64) -> Result<(), Refusal> {
        let entity = self.entities.get_or_insert(speaker.entity, self.limits.entities, &mut self.timers)?;
        entity.floor = serial;
        // Once the certificate has ended the statement is refused for that, and the floor need not be known.
        let end = now.clock.saturating_add(Duration::from_secs(not_after.saturating_sub(now.unix).saturating_add(1)));
        entity.remember_until = entity.remember_until.max(end);
        Ok(())
    }

    fn register(
        &mut self,
        name: Name,
        proof: NameProof,
        entity: Name,
        registration: Registration,
    ) -> Result<(), Refusal> {
        let (key, reads, switch) = (name.to_bytes(), registration.reads(), registration.switch);
        let allowed = self.names.check_room(&name, &entity, &registration, &self.limits).and_then(|()| {
            let names = self.entities.names(&entity);
            if names.len() >= self.limits.names_per_entity && !names.contains(&key) {
                return Err(limit_reached(format!("{entity} already has {} names", names.len())));
            }
            Ok(())
        });
        if let Err(refusal) = allowed {
            self.entities.retire(&entity, &mut self.timers);
            return Err(refusal);
        }
        self.timers.insert((registration.ends, Timer::Registration { name: key, entity, reads }));
        self.entities.add_name(&entity, key);
        let change = self.names.insert(name, proof, entity, registration);
        if let Some(old) = change.replaced {
            if old.ends != change.ends {
                self.timers.remove(&(old.ends, Timer::Registration { name: key, entity, reads }));
            }
            if old.switch != switch {
                self.follow_up(key, old.switch, false);
            }
        }
        self.follow_up(key, switch, change.writers_changed);
        Ok(())
    }

    fn unregister(&mut self, name: Key, entity: Name, reads: bool) {
        let Some(old) = self.names.remove(&name, &entity, reads) else { return };
        self.timers.remove(&(old.ends, Timer::Registration { name, entity, reads }));
        if !self.names.has(&name, &entity) {
            self.entities.remove_name(&entity, &name);
            self.entities.retire(&entity, &mut self.timers);
        }
        self.follow_up(name, old.switch, !reads);
    }

    /// Brings the desired FIBs in line with what is registered for one name, after a change `at` a switch.
    fn follow_up(&mut self, name: Key, at: Name, writers_changed: bool) {
        if writers_changed {
            self.untold.extend(self.names.readers(&name).map(|reader| (name, *reader)));
        }
        let topology = &self.topology;
        for (switch, route) in self.names.reroute(&name, &at, |switch| topology.bit(switch)) {
            if let Some(state) = self.switches.get_mut(&switch) {
                state.fib.set(&Name::from_bytes(name), route);
            }
        }
        self.names.sweep(&name);
    }

    fn try_report(
        &mut self,
        now: Now,
        proof: &NameProof,
        neighbours: &[(Name, u32)],
        attached: Option<&[Name]>,
        own_bit: Option<u8>,
    ) -> Result<(), Refusal> {
        let switch = proof.name().map_err(|error| refusal(CertError::Crypto(error)))?;
        let most = gdp_wire::table::MAX_LINKS as usize;
        if neighbours.len() > most || attached.is_some_and(|list| list.len() > most) {
            return Err(limit_reached(format!("a switch has at most {most} links")));
        }
        self.topology
            .report(switch, neighbours.iter().copied(), own_bit)
            .map_err(|full| Refusal::new(RefusalCode::Limit, full.to_string()))?;
        let known = self.switches.contains_key(&switch);
        self.switches.entry(switch).or_default();
        match attached {
            Some(attached) => self.reconcile(&switch, attached),
            None if !known => drop(self.detached.insert((switch, switch))),
            None => {}
        }
        self.recompute(now);
        Ok(())
    }

    /// Compares the entities that are attached to a switch with those the RIB knows of, and sends it the whole FIB.
    fn reconcile(&mut self, switch: &Name, attached: &[Name]) {
        let attached: BTreeSet<Name> = attached.iter().copied().collect();
        let Some(state) = self.switches.get_mut(switch) else { return };
        state.fib.restart();
        let gone: Vec<Name> = state.attached.difference(&attached).copied().collect();
        let unknown = attached.difference(&state.attached).map(|entity| (*switch, *entity));
        self.detached.extend(unknown);
        for entity in gone {
            self.end_attachment(&entity);
        }
        self.untold.extend(self.names.read_at(switch));
    }

    fn recompute(&mut self, now: Now) {
        for switch in self.topology.recompute() {
            if let Some(state) = self.switches.get_mut(&switch) {
                state.fib.touch_masks();
            }
        }
        for (name, state) in &mut self.switches {
            let reached = *name == self.root || self.topology.connected(&self.root, name);
            match (reached, state.hold) {
                (true, Some(at)) => {
                    self.timers.remove(&(at, Timer::Switch { switch: *name }));
                    state.hold = None;
                }
                (false, None) => {
                    let at = now.clock + HOLD;
                    self.timers.insert((at, Timer::Switch { switch: *name }));
                    state.hold = Some(at);
                }
                _ => {}
            }
        }
    }

    fn forget_switch(&mut self, now: Now, switch: &Name) {
        let Some(state) = self.switches.get(switch) else { return };
        for entity in state.attached.clone() {
            self.end_attachment(&entity);
        }
        for (name, entity, reads) in self.names.registered_at(switch) {
            self.unregister(name, entity, reads);
        }
        self.switches.remove(switch);
        self.topology.forget(switch);
        self.recompute(now);
    }
}

/// What `gdp-ctl status` and `rib dump` show.
impl Rib {
    /// Egress bit of a switch.
    pub fn bit(&self, switch: &Name) -> Option<u8> {
        self.topology.bit(switch)
    }

    /// Switches with their egress bits, neighbours with costs, and attached entities.
    pub fn switches(&self) -> impl Iterator<Item = (Name, u8, Vec<(Name, u32)>, Vec<Name>)> {
        self.switches.iter().filter_map(|(name, state)| {
            let neighbours = self.topology.neighbours(name).map(|(n, cost)| (*n, cost)).collect();
            Some((*name, self.topology.bit(name)?, neighbours, state.attached.iter().copied().collect()))
        })
    }

    /// At most `limit` records behind `after`, and whether there are more.
    pub fn records(&self, now: Now, after: Option<RecordPlace>, limit: usize) -> (Vec<Record>, bool) {
        self.names.records(now.clock, after.as_ref(), limit)
    }

    /// Names with a writer or a reader.
    pub fn name_count(&self) -> usize {
        self.names.len()
    }

    /// What a switch's FIB should hold.
    pub fn desired(&self, switch: &Name) -> Vec<gdp::control::Route> {
        self.switches.get(switch).map_or_else(Vec::new, |s| s.fib.routes().cloned().collect())
    }
}

fn lifetime(now: Now, stated: u32, not_after: u64) -> Result<Duration, Refusal> {
    if stated == 0 {
        return Err(Refusal::new(RefusalCode::Malformed, "a statement with a lifetime of 0 s states nothing"));
    }
    let seconds = u64::from(stated).min((not_after - now.unix).max(1));
    Ok(now.clock.saturating_add(Duration::from_secs(seconds)))
}

fn check_supported(op: AdvertOp) -> Result<(), Refusal> {
    match op {
        AdvertOp::Serve | AdvertOp::Call => {
            Err(Refusal::new(RefusalCode::Unsupported, "this RIB does not know services"))
        }
        AdvertOp::Publish | AdvertOp::Subscribe | AdvertOp::Withdraw => Ok(()),
    }
}

fn limit_reached(what: String) -> Refusal {
    Refusal::new(RefusalCode::Limit, format!("{what}, and that is the limit of this RIB"))
}

/// The refusal that tells a requester of a certificate error.
fn refusal(error: CertError) -> Refusal {
    let code = match &error {
        CertError::BadSignature { .. } | CertError::WrongKey { .. } => RefusalCode::BadSignature,
        CertError::NotYetValid { .. } => RefusalCode::NotYetValid,
        CertError::Expired { .. } => RefusalCode::Expired,
        CertError::WrongName { .. } => RefusalCode::WrongName,
        CertError::WrongEntity { .. } => RefusalCode::WrongEntity,
        CertError::WrongSwitch { .. } => RefusalCode::WrongSwitch,
        CertError::ReplayedSerial { .. } | CertError::RolledBack { .. } => RefusalCode::ReplayedSerial,
        CertError::Revoked { .. } => RefusalCode::Revoked,
        CertError::NotDelegated { .. }
        | CertError::BeforeDelegation { .. }
        | CertError::NotAMember { .. }
        | CertError::WrongRole { .. }
        | CertError::WrongDomain { .. } => RefusalCode::NotEntitled,
        CertError::Malformed(_) | CertError::WrongOperation { .. } | CertError::Crypto(_) => RefusalCode::Malformed,
    };
    Refusal::new(code, error.to_string())
}

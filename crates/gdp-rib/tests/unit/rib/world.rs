//! A RIB with switches and entities around it, that report, ask, and take what they are pushed as
//! real ones do.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::card::NameCard;
use gdp_core::cert::{
    AdCert, Advert, AdvertOp, CertError, Grantee, LinkState, ReadGrant, Revocation, RtCert, Signed, issue,
};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::KeyBox;
use gdp_core::name::{Name, NamePrefix, NameProof};
use gdp_proto::control;
use gdp_proto::control::{
    EntityRequest, Extent, FibPush, NameRole, Peers, PeersPush, Record, RefusalCode, Request, Response, Route,
};
use gdp_proto::peers::{Counterparts, PeerEvent};

use crate::rib::fib::Pushed;
use crate::rib::model::RegistrationKey;
use crate::rib::{Effect, Item, Limits, Now, Rib, RibRun, UpdateId};
use crate::topology::Paths;

pub const UNIX: u64 = 1_800_000_000;
const HOUR: u32 = 3600;

pub struct World {
    pub rib: Rib,
    pub now: Now,
    pub owner: SigningKey,
    pub card: NameCard,
    /// Of the certificates that are issued from now on.
    pub serial: u64,
    /// Likewise, of those of writers.
    pub scope: Vec<Name>,
    pub switches: Vec<Identity>,
    pub links: Vec<(usize, usize)>,
    /// What each switch holds after the pushes it got.
    pub held: BTreeMap<Name, StoredRevocation>,
    /// The switch that each lane of each entity attached to last.
    pub entities: BTreeMap<(Name, u8), Name>,
    /// What entities hold of their counterparts: by entity, name and role.
    pub nodes: BTreeMap<(Name, Name, NameRole), Counterparts>,
    /// Of so many messages to entities one is lost, and of as many the answer; 0: none.
    pub loss: usize,
    random: Random,
    /// Key boxes that readers were given: name, writer, reader, epoch.
    pub given: BTreeSet<(Name, Name, Name, u32)>,
    /// What a store has of the RIB.
    pub stored: BTreeMap<Item, Vec<u8>>,
}

#[derive(Default)]
pub struct StoredRevocation {
    pub own_bit: u8,
    pub routes: BTreeMap<Name, Route>,
}

impl World {
    pub fn chain(length: usize) -> Self {
        Self::with(length, Limits::default())
    }

    pub fn with(length: usize, limits: Limits) -> Self {
        Self::started(length, limits, RibRun { id: 1, settling: Duration::ZERO })
    }

    pub fn started(length: usize, limits: Limits, run: RibRun) -> Self {
        let switches: Vec<_> = (0..length).map(|_| Identity::generate("switch").unwrap()).collect();
        let owner = SigningKey::generate().unwrap();
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None).unwrap();
        let mut world = Self {
            rib: Rib::new(switches[0].name(), run, limits),
            now: Now { unix: UNIX, clock: Duration::from_secs(1000) },
            owner,
            card,
            serial: UNIX * 1_000_000_000,
            scope: vec![],
            switches,
            links: (1..length).map(|i| (i - 1, i)).collect(),
            held: BTreeMap::new(),
            entities: BTreeMap::new(),
            nodes: BTreeMap::new(),
            loss: 0,
            random: Random(3),
            given: BTreeSet::new(),
            stored: BTreeMap::new(),
        };
        world.rib.open_journal();
        (0..length).for_each(|i| world.report(i, &[]));
        world
    }

    pub fn switch(&self, index: usize) -> Name {
        self.switches[index].name()
    }

    pub fn report(&mut self, index: usize, attached: &[Name]) {
        let response = self.rib.report(self.now, &self.switches[index].proof(), attached, None);
        assert!(matches!(response, Response::Reported { .. }), "{response:?}");
        self.rewire();
    }

    /// The links are now others, or the bits of switches.
    pub fn rewire(&mut self) {
        self.rib.set_paths(self.now, self.paths(0));
    }

    fn connected(&self, from: &Name, to: &Name) -> bool {
        let index = self.switches.iter().position(|switch| switch.name() == *from).unwrap();
        self.paths(index).reaches(to)
    }

    /// The paths from a switch, once all know all.
    pub fn paths(&self, from: usize) -> Paths {
        let near = |index: usize| {
            let of = self.links.iter().filter_map(move |(a, b)| match index {
                i if i == *a => Some((self.switch(*b), 1)),
                i if i == *b => Some((self.switch(*a), 1)),
                _ => None,
            });
            of.collect::<BTreeMap<_, _>>().into_iter().collect()
        };
        let states = (0..self.switches.len()).map(|i| LinkState {
            switch: self.switch(i),
            run: 1,
            number: 1,
            bit: self.rib.bit(&self.switch(i)),
            neighbours: near(i),
            silent: 0,
            rib: i == 0,
            borders: vec![],
            lifetime: 60,
        });
        Paths::compute(self.switch(from), states.collect::<Vec<_>>().iter())
    }

    pub fn ask(&mut self, entity: &Identity, at: usize, request: EntityRequest) -> Response {
        let response = self.rib.request(self.now, self.switch(at), Some(&entity.proof()), false, &request);
        match &request {
            EntityRequest::Attach { lane, .. } if matches!(response, Response::Attached { .. }) => {
                self.entities.insert((entity.name(), *lane), self.switch(at));
            }
            EntityRequest::Advertise { proof, advert, .. } | EntityRequest::Subscribe { proof, advert, .. } => {
                if let Response::Peers(peers) = &response {
                    let (name, op) = (proof.name().unwrap(), advert.claims_unverified().unwrap().op);
                    let role = NameRole::of(op).unwrap();
                    let node = || Counterparts::new(*proof, role).unwrap();
                    self.nodes.entry((entity.name(), name, role)).or_insert_with(node);
                    assert!(self.take(entity.name(), name, role, peers), "the answer does not follow");
                }
            }
            _ => {}
        }
        response
    }

    pub fn attach(&mut self, entity: &Identity, at: usize) -> Response {
        self.attach_lane(entity, 0, at)
    }

    pub fn attach_lane(&mut self, entity: &Identity, lane: u8, at: usize) -> Response {
        let claims = RtCert { entity: entity.name(), switch: self.switch(at), not_after: UNIX + 1_000_000 };
        let rt_cert = issue(entity.key(), &claims).unwrap();
        self.ask(entity, at, EntityRequest::Attach { rt_cert, resumes: true, lane })
    }

    pub fn attached(&mut self, _what: &str, at: usize) -> Identity {
        let entity = Identity::generate("proxy").unwrap();
        let response = self.attach(&entity, at);
        assert!(matches!(response, Response::Attached { serial: 0 }), "{response:?}");
        entity
    }

    /// Has the owner of the present name take back what has these serials, or one below the floor.
    pub fn revoke(&mut self, number: u64, floor: u64, revoked: &[u64]) -> Response {
        let claims = Revocation { name: self.card.name(), number, floor, revoked: revoked.to_vec(), signer: None };
        let request =
            EntityRequest::Revoke { proof: self.card.proof(), revocation: issue(&self.owner, &claims).unwrap() };
        self.rib.request(self.now, self.switch(0), None, true, &request)
    }

    /// Wraps no key, but says so, for these readers of what `writer` sends to `name`.
    pub fn key_boxes(&self, writer: &Identity, name: Name, epoch: u32, readers: &[Name]) -> EntityRequest {
        let signed = |reader: &Name| {
            let claims = KeyBox { name, writer: writer.name(), reader: *reader, epoch, sealed: vec![0; 113] };
            issue(writer.key(), &claims).unwrap()
        };
        EntityRequest::KeyBoxes { boxes: readers.iter().map(signed).collect() }
    }

    pub fn boxes(&mut self, writer: &Identity, at: usize, name: Name, epoch: u32, readers: &[Name]) -> Response {
        let request = self.key_boxes(writer, name, epoch, readers);
        self.ask(writer, at, request)
    }

    pub fn detach(&mut self, entity: &Identity, at: usize) {
        self.rib.detach(self.now, &self.switch(at), &entity.name());
    }

    pub fn publish(&mut self, entity: &Identity, at: usize, serial: u64) -> Response {
        self.state(entity, at, serial, NameRole::Publisher)
    }

    pub fn subscribe(&mut self, entity: &Identity, at: usize, serial: u64) -> Response {
        self.state(entity, at, serial, NameRole::Subscriber)
    }

    pub fn state(&mut self, entity: &Identity, at: usize, serial: u64, role: NameRole) -> Response {
        let request = self.statement(entity, at, serial, role);
        self.ask(entity, at, request)
    }

    /// As [`Self::state`], besides what is stated at other switches.
    pub fn state_everywhere(&mut self, entity: &Identity, at: usize, serial: u64, role: NameRole) -> Response {
        let mut request = self.statement(entity, at, serial, role);
        if let EntityRequest::Advertise { everywhere, .. } | EntityRequest::Subscribe { everywhere, .. } = &mut request
        {
            *everywhere = true;
        }
        self.ask(entity, at, request)
    }

    pub fn subscription(&self, entity: &Identity, at: usize, serial: u64) -> EntityRequest {
        self.statement(entity, at, serial, NameRole::Subscriber)
    }

    fn statement(&self, entity: &Identity, at: usize, serial: u64, role: NameRole) -> EntityRequest {
        if role.is_writer() {
            let mut parts = Parts::publish(self, entity, at);
            (parts.advert.op, parts.advert.serial) = (role.op(), serial);
            return parts.advertise();
        }
        let parts = Parts::publish(self, entity, at);
        let (name, to, serial_of_grant) = (parts.cert.name, Grantee::Entity(entity.name()), parts.cert.serial);
        let (not_before, not_after) = (UNIX, UNIX + 1_000_000);
        let grant = ReadGrant { name, to, serial: serial_of_grant, not_before, not_after };
        let advert = Advert { op: role.op(), serial, ..parts.advert };
        let (grant, advert) = (issue(&self.owner, &grant).unwrap().into(), issue(entity.key(), &advert).unwrap());
        EntityRequest::Subscribe { proof: parts.proof, grant, advert, everywhere: false }
    }

    pub fn query(&mut self, prefix: &str) -> Response {
        // A person types at least one digit; the empty prefix asks for what begins with any.
        let prefixes = if prefix.is_empty() {
            "0123456789abcdef".chars().map(String::from).collect()
        } else {
            vec![prefix.to_owned()]
        };
        let mut last = Response::Done;
        for prefix in prefixes {
            let prefix: NamePrefix = prefix.parse().unwrap();
            let (switch, query) = (self.switches[0].proof(), EntityRequest::Query { prefix, after: None });
            last = self.rib.request(self.now, self.switch(0), Some(&switch), true, &query);
            if matches!(&last, Response::Records { records, .. } if !records.is_empty()) {
                break;
            }
        }
        last
    }

    pub fn another_name(&mut self) -> NameCard {
        self.card = NameCard::create(self.owner.verify_key(), "topic", "/chatter", "T", None).unwrap();
        self.card.clone()
    }

    /// Brings the store up to date.
    pub fn store(&mut self) {
        for item in self.rib.take_changed() {
            match self.rib.stored(self.now, &item) {
                Some(bytes) => drop(self.stored.insert(item, bytes)),
                None => drop(self.stored.remove(&item)),
            }
        }
    }

    /// Another RIB takes the place of this one, with what is stored. Returns what it left out.
    pub fn take_over(&mut self, run: RibRun) -> Vec<(Item, String)> {
        self.rib = Rib::new(self.switch(0), run, self.rib.limits);
        self.rib.open_journal();
        let mut omitted = Vec::new();
        for (item, bytes) in &self.stored {
            if let Err(error) = self.rib.restore(self.now, item, bytes) {
                omitted.push((*item, error.to_string()));
            }
        }
        self.rib.restored();
        self.rewire();
        omitted
    }

    pub fn pass(&mut self, time: Duration) {
        self.now.clock += time;
        self.now.unix += time.as_secs();
        self.rib.tick(self.now);
    }

    /// All routes of names that should be: switch index, bits, local readers.
    pub fn routes(&self) -> Vec<(usize, u64, Vec<Name>)> {
        let (records, _) = self.rib.records(self.now, None, usize::MAX);
        let names: BTreeSet<Name> = records.iter().map(|record| record.name).collect();
        self.routes_of(|name| names.contains(name)).into_iter().map(|(i, r)| (i, r.egress_bits, r.locals)).collect()
    }

    /// The routes to an entity's inbox: switch index, bits, local readers, local writers.
    pub fn inbox_routes(&self, entity: &Identity) -> Vec<(usize, u64, Vec<Name>, Vec<Name>)> {
        let routes = self.routes_of(|name| *name == entity.name()).into_iter();
        routes.map(|(i, r)| (i, r.egress_bits, r.locals, r.writers)).collect()
    }

    fn routes_of(&self, wanted: impl Fn(&Name) -> bool) -> Vec<(usize, Route)> {
        let switches = self.switches.iter().enumerate();
        let all = switches.flat_map(|(i, s)| self.rib.desired(&s.name()).into_iter().map(move |route| (i, route)));
        all.filter(|(_, route)| wanted(&route.name)).collect()
    }

    pub fn detaches(&mut self) -> Vec<(Name, Name)> {
        let effects = self.rib.effects(self.now).into_iter();
        effects
            .filter_map(|e| if let Effect::Detach { switch, entity } = e { Some((switch, entity)) } else { None })
            .collect()
    }

    /// Has everybody told once: those with this role that were, and how many counterparts each of
    /// them knows now.
    pub fn told(&mut self, role: NameRole) -> Vec<(Name, Name, usize)> {
        let pushes = self.tell().into_iter().filter(|push| push.role == role);
        let known = |p: &PeersPush| self.nodes[&(p.entity, p.name, p.role)].known().count();
        pushes.map(|push| (push.switch, push.entity, known(&push))).collect()
    }

    /// Has everybody told until there is nothing left to tell. How many messages it took.
    pub fn tell_all(&mut self) -> usize {
        std::iter::from_fn(|| Some(self.tell().len()).filter(|count| *count > 0)).sum()
    }

    /// Carries out what is to be sent now, as entities and switches do. Returns what entities were
    /// told.
    pub fn tell(&mut self) -> Vec<PeersPush> {
        let (mut told, mut pushes) = (Vec::new(), Vec::new());
        for effect in self.rib.effects(self.now) {
            match effect {
                Effect::Peers(push) => told.push(push),
                Effect::Fib(push) => pushes.push(push),
                Effect::Detach { .. } => {}
            }
        }
        self.carry_out(pushes);
        told.iter().for_each(|push| self.arrive(push));
        told
    }

    fn arrive(&mut self, push: &PeersPush) {
        control::encode(&Request::Peers(push.clone())).expect("fits a message");
        let lanes = self.entities.range((push.entity, 0)..=(push.entity, u8::MAX));
        assert!(lanes.map(|(_, at)| at).any(|at| *at == push.switch), "told where it is attached");
        let mut is_lost = || self.loss > 0 && self.random.below(self.loss) == 0;
        let (lost, answer_lost) = (is_lost(), is_lost());
        let arrived = !lost && self.take(push.entity, push.name, push.role, &push.peers);
        self.rib.update_answered(self.now, UpdateId::from(push), arrived && !answer_lost);
    }

    /// What the SDK of an entity does with what it is told. Whether it follows.
    pub fn take(&mut self, entity: Name, name: Name, role: NameRole, peers: &Peers) -> bool {
        if entity == name {
            self.keep_boxes(entity, name, peers.boxes.iter());
            return true;
        }
        let Some(node) = self.nodes.get_mut(&(entity, name, role)) else { return false };
        let Ok(events) = node.take(self.now.unix, peers) else { return false };
        let (proof, mut behind) = (*node.proof(), Vec::new());
        let boxes = events.iter().filter_map(|event| match event {
            PeerEvent::KeyBox(signed) => Some(signed),
            // It has started anew, and was given an older revocation first.
            PeerEvent::Refused(CertError::RolledBack { .. } | CertError::Revoked { .. }) => None,
            PeerEvent::Refused(error) => panic!("the RIB told what does not verify: {error}"),
            PeerEvent::RibIsBehind(revocation) => {
                behind.push(revocation.clone());
                None
            }
            PeerEvent::Revoked(_) | PeerEvent::Joined(_) | PeerEvent::Left(_) | PeerEvent::Expelled(_) => None,
        });
        self.keep_boxes(entity, name, boxes);
        for revocation in behind {
            let request = EntityRequest::Revoke { proof, revocation };
            self.rib.request(self.now, self.switch(0), None, false, &request);
        }
        true
    }

    fn keep_boxes<'a>(&mut self, entity: Name, name: Name, boxes: impl Iterator<Item = &'a Signed<KeyBox>>) {
        for claims in boxes.map(|signed| signed.claims_unverified().unwrap()) {
            assert_eq!((claims.reader, claims.name), (entity, name), "somebody else's box");
            self.given.insert((claims.name, claims.writer, claims.reader, claims.epoch));
        }
    }

    /// How many counterparts an entity knows.
    pub fn counterparts(&self, entity: &Identity, role: NameRole) -> usize {
        self.nodes[&(entity.name(), self.card.name(), role)].known().count()
    }

    /// The counterpart an entity knows is there, as the SDK believes it.
    pub fn knows(&self, entity: &Identity, role: NameRole, other: &Identity) -> bool {
        self.nodes[&(entity.name(), self.card.name(), role)].get(&other.name()).is_some()
    }

    pub fn is_settled(&self, entity: &Identity, role: NameRole) -> bool {
        self.rib.is_settled(&self.card.name(), &entity.name(), role)
    }

    pub fn pushes(&mut self) -> Vec<FibPush> {
        let mut pushes = Vec::new();
        for effect in self.rib.effects(self.now) {
            match effect {
                Effect::Fib(push) => pushes.push(push),
                Effect::Peers(push) => self.arrive(&push),
                Effect::Detach { .. } => {}
            }
        }
        pushes
    }

    /// Carries pushes out until there are none; the FIBs of the switches are then what the RIB
    /// wants.
    pub fn settle(&mut self) {
        loop {
            let pushes = self.pushes();
            if pushes.is_empty() {
                break;
            }
            self.carry_out(pushes);
        }
        for switch in &self.switches {
            let name = switch.name();
            let held: Vec<_> = self.held[&name].routes.values().cloned().collect();
            let mut desired = self.rib.desired(&name);
            desired.sort_by_key(|r| r.name);
            assert_eq!(held, desired);
        }
    }

    /// As a switch does it.
    pub fn carry_out(&mut self, pushes: Vec<FibPush>) {
        for push in pushes {
            let held = self.held.entry(push.switch).or_default();
            if matches!(push.extent, Extent::Full { part: 0, .. }) {
                held.routes.clear();
            }
            held.own_bit = push.own_bit;
            held.routes.extend(push.set.iter().map(|r| (r.name, r.clone())));
            held.routes.retain(|name, _| !push.remove.contains(name));
            self.rib.pushed(self.now, &push.switch, push.generation, Pushed::Done);
        }
    }

    /// The FIBs computed anew from who is registered, by the definition of a route.
    pub fn check_model(&self) {
        let (records, _) = self.rib.records(self.now, None, usize::MAX);
        let bits = |at: &Name| 1u64 << self.rib.bit(at).unwrap();
        // Where those are reached that have a counterpart.
        let mut homes: BTreeMap<Name, u64> = BTreeMap::new();
        for record in &records {
            let is_other = |other: &&Record| {
                other.name == record.name && other.role().unwrap() == record.role().unwrap().counterpart()
            };
            if records.iter().filter(is_other).any(|other| self.are_a_pair(record, other)) {
                *homes.entry(record.entity.name().unwrap()).or_default() |= bits(&record.switch);
            }
        }
        for switch in self.switches.iter().map(Identity::name) {
            let mut model: BTreeMap<Name, Route> = BTreeMap::new();
            for record in &records {
                let of_name = || records.iter().filter(|other| other.name == record.name);
                let (entity, role) = (record.entity.name().unwrap(), record.role().unwrap());
                let others = || of_name().filter(|other| other.role().unwrap() == role.counterpart());
                if others().next().is_none() {
                    continue;
                }
                let empty = |name| Route { name, ..Route::default() };
                // Of a service there are routes between the parties alone.
                if record.switch == switch && !role.is_of_service() {
                    let route = model.entry(record.name).or_insert_with(|| empty(record.name));
                    if role == NameRole::Publisher {
                        route.egress_bits = others().fold(0, |all, other| all | bits(&other.switch));
                        route.writers.push(entity);
                    } else {
                        route.locals.push(entity);
                        let held = self.rib.names.get_at(record.name.as_bytes(), &entity, role, &switch).unwrap();
                        route.everywhere.extend(held.everywhere.then_some(entity));
                    }
                }
                for other in others().filter(|other| self.are_a_pair(record, other)) {
                    let sender = other.entity.name().unwrap();
                    if record.switch != switch && other.switch != switch {
                        continue;
                    }
                    let route = model.entry(entity).or_insert_with(|| empty(entity));
                    if other.switch == switch {
                        route.egress_bits = homes[&entity];
                        route.writers.push(sender);
                    }
                    if record.switch == switch {
                        (route.locals, route.everywhere) = (vec![entity], vec![entity]);
                    }
                }
            }
            for route in model.values_mut() {
                route.writers.sort();
                route.writers.dedup();
            }
            assert_eq!(self.held[&switch].routes, model);
        }
        let has = |writes: bool| {
            let of = records.iter().filter(move |record| record.is_writer() == writes);
            of.map(|record| record.name).collect::<BTreeSet<_>>()
        };
        let (count, without_publisher) = self.rib.without_publisher();
        let without_publisher: Vec<Name> = without_publisher.collect();
        assert_eq!(
            (count, &without_publisher),
            (without_publisher.len(), &has(false).difference(&has(true)).copied().collect())
        );
    }

    /// Sends a frame of everybody that may send through the switches' FIBs, as `gdp_wire::forward`
    /// would: each of those that take the name gets one copy, if there is a path to its switch, and
    /// nobody else any; so does each counterpart in its inbox.
    pub fn check_delivery(&self) {
        let (records, _) = self.rib.records(self.now, None, usize::MAX);
        let name = |record: &Record| record.entity.name().unwrap();
        for sender in &records {
            let role = sender.role().unwrap();
            let others = records.iter().filter(|r| r.name == sender.name && r.role().unwrap() == role.counterpart());
            let reached = others.filter(|r| self.connected(&sender.switch, &r.switch));
            let reached: Vec<_> = reached.collect();
            let expected: BTreeSet<_> = reached.iter().map(|r| (r.switch, name(r))).collect();
            if role == NameRole::Publisher {
                let copies = self.deliver(sender.switch, sender.name);
                assert_eq!(copies.len(), expected.len(), "a copy too many or too few");
                assert_eq!(BTreeSet::from_iter(copies), expected);
                let route = self.held[&sender.switch].routes.get(&sender.name);
                assert!(route.is_none_or(|route| route.writers.contains(&name(sender))));
            }
            for other in reached.into_iter().filter(|other| self.are_a_pair(sender, other)) {
                let (at, other) = (other.switch, name(other));
                let copies = self.deliver(sender.switch, other);
                let places: BTreeSet<_> = copies.iter().collect();
                assert!(places.len() == copies.len() && copies.contains(&(at, other)), "{copies:?}");
                assert!(copies.iter().all(|(_, to)| *to == other));
                assert!(self.held[&sender.switch].routes[&other].writers.contains(&name(sender)));
            }
        }
    }

    /// Whether two counterparts send to each other's inbox: both are attached, and they are two.
    fn are_a_pair(&self, one: &Record, other: &Record) -> bool {
        let is_bound = |record: &Record| {
            let (entity, role) = (record.entity.name().unwrap(), record.role().unwrap());
            self.rib.names.get_at(record.name.as_bytes(), &entity, role, &record.switch).unwrap().bound
        };
        one.entity != other.entity && is_bound(one) && is_bound(other)
    }

    /// What every entity believes of its counterparts is what the RIB holds, and it has every box
    /// that is kept for it.
    pub fn check_record_limit(&self) {
        let (records, _) = self.rib.records(self.now, None, usize::MAX);
        for record in &records {
            let (entity, role) = (record.entity.name().unwrap(), record.role().unwrap());
            let others = records.iter().filter(|r| r.name == record.name && r.role().unwrap() == role.counterpart());
            let expected: BTreeSet<Name> = others.map(|other| other.entity.name().unwrap()).collect();
            let node = &self.nodes[&(entity, record.name, role)];
            let known: BTreeSet<Name> = node.known().map(|c| c.entity).collect();
            // Until the RIB has settled, nobody is gone because it does not know him.
            let is_settling = self.now.clock < self.rib.run.settling;
            assert!(known == expected || is_settling && known.is_superset(&expected), "{known:?}, {expected:?}");
            assert_eq!(node.revocation(), self.rib.revocations.claims(record.name.as_bytes()));
            let own = RegistrationKey { name: record.name.to_bytes(), entity, role };
            for (registration_key, other) in
                expected.iter().flat_map(|other| [(own, other), (RegistrationKey::inbox(entity), other)])
            {
                for kept in
                    self.rib.boxes.between(&registration_key, other).map(|signed| signed.claims_unverified().unwrap())
                {
                    assert!(
                        self.given.contains(&(kept.name, kept.writer, kept.reader, kept.epoch)),
                        "a box is missing"
                    );
                }
            }
        }
    }

    /// Who gets a copy of what is sent to the name from a switch, and at which switch.
    fn deliver(&self, from: Name, name: Name) -> Vec<(Name, Name)> {
        let bits = self.held[&from].routes.get(&name).map_or(0, |route| route.egress_bits);
        let (mut copies, mut delivered) = (vec![(from, bits)], Vec::new());
        for _ in 0..=self.switches.len() {
            for (at, bits) in std::mem::take(&mut copies) {
                let held = &self.held[&at];
                if bits & 1 << held.own_bit != 0 {
                    delivered.extend(held.routes[&name].locals.iter().map(|reader| (at, *reader)));
                }
                let index = self.switches.iter().position(|switch| switch.name() == at).unwrap();
                let reach = self.paths(index).reach.into_iter();
                let onward = reach.map(|(next, reach)| (next, bits & reach & !(1 << held.own_bit)));
                copies.extend(onward.filter(|(_, bits)| *bits != 0));
            }
        }
        assert!(copies.is_empty(), "a loop");
        delivered
    }
}

/// The parts of a request, to be spoilt one at a time.
#[derive(Clone)]
pub struct Parts {
    pub owner: SigningKey,
    pub signer: SigningKey,
    pub proof: NameProof,
    pub cert: AdCert,
    pub advert: Advert,
    pub flip_cert: bool,
    pub flip_advert: bool,
}

impl Parts {
    pub fn publish(w: &World, entity: &Identity, at: usize) -> Self {
        let name = w.card.name();
        Self {
            owner: w.owner.clone(),
            signer: entity.key().clone(),
            proof: w.card.proof(),
            cert: AdCert {
                name,
                entity: entity.name(),
                scope: w.scope.clone(),
                serial: w.serial,
                not_before: UNIX - 1,
                not_after: UNIX + 1_000_000,
            },
            advert: Advert {
                op: AdvertOp::Publish,
                name,
                entity: entity.name(),
                switch: w.switch(at),
                serial: 1,
                lifetime: 24 * HOUR,
                box_key: entity.box_public(),
            },
            flip_cert: false,
            flip_advert: false,
        }
    }

    pub fn advertise(&self) -> EntityRequest {
        let (mut ad_cert, mut advert) =
            (issue(&self.owner, &self.cert).unwrap(), issue(&self.signer, &self.advert).unwrap());
        if self.flip_cert {
            ad_cert = flipped(&ad_cert);
        }
        if self.flip_advert {
            advert = flipped(&advert);
        }
        EntityRequest::Advertise { proof: self.proof, ad_cert: ad_cert.into(), advert, everywhere: false }
    }

    pub fn withdraw(w: &World, entity: &Identity, at: usize, serial: u64) -> EntityRequest {
        let advert = Advert { op: AdvertOp::Withdraw, serial, ..Self::publish(w, entity, at).advert };
        EntityRequest::Withdraw { advert: issue(entity.key(), &advert).unwrap() }
    }
}

/// The last byte belongs to the signature.
fn flipped<T>(signed: &gdp_core::cert::Signed<T>) -> gdp_core::cert::Signed<T> {
    let mut bytes = signed.as_bytes().to_vec();
    *bytes.last_mut().unwrap() ^= 1;
    gdp_core::cert::Signed::from_bytes(bytes).unwrap()
}

pub fn expect_refused(response: &Response, what: &str, code: RefusalCode, needle: &str) {
    let Response::Refused(refusal) = response else { panic!("{what}: not refused but {response:?}") };
    assert_eq!(refusal.code, code, "{what}: {refusal}");
    assert!(refusal.reason.contains(needle), "{what}: {refusal}");
}

pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) as usize % bound
    }
}

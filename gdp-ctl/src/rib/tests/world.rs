//! A RIB with switches and entities around it, that report, ask and take pushes as real ones do.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp::NameCard;
use gdp::cert::{AdCert, Advert, AdvertOp, Grantee, Mode, ReadGrant, RtCert, issue};
use gdp::control::{EntityRequest, Extent, FibPush, Record, RefusalCode, Response, Route};
use gdp::identity::{Identity, SigningKey};
use gdp::name::{Name, NamePrefix, NameProof};

use crate::rib::fib::Pushed;
use crate::rib::{Effect, Limits, Now, Rib, Run};

pub const UNIX: u64 = 1_800_000_000;
const HOUR: u32 = 3600;

pub struct World {
    pub rib: Rib,
    pub now: Now,
    pub owner: SigningKey,
    pub card: NameCard,
    pub switches: Vec<Identity>,
    pub links: Vec<(usize, usize)>,
    /// What each switch holds after the pushes it got.
    pub held: BTreeMap<Name, Held>,
}

#[derive(Default)]
pub struct Held {
    pub own_bit: u8,
    pub reach: Vec<(Name, u64)>,
    pub routes: BTreeMap<Name, Route>,
}

impl World {
    pub fn chain(length: usize) -> Self {
        Self::with(length, Limits::default())
    }

    pub fn with(length: usize, limits: Limits) -> Self {
        Self::started(length, limits, Run { id: 1, settling: Duration::ZERO })
    }

    pub fn started(length: usize, limits: Limits, run: Run) -> Self {
        let switches: Vec<_> = (0..length).map(|_| Identity::generate("switch").unwrap()).collect();
        let owner = SigningKey::generate().unwrap();
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None).unwrap();
        let mut world = Self {
            rib: Rib::new(switches[0].name(), run, limits),
            now: Now { unix: UNIX, clock: Duration::from_secs(1000) },
            owner,
            card,
            switches,
            links: (1..length).map(|i| (i - 1, i)).collect(),
            held: BTreeMap::new(),
        };
        (0..length).for_each(|i| world.report(i, Some(&[])));
        world
    }

    pub fn switch(&self, index: usize) -> Name {
        self.switches[index].name()
    }

    pub fn report(&mut self, index: usize, attached: Option<&[Name]>) {
        let near = self.links.iter().filter_map(|(a, b)| match index {
            i if i == *a => Some((self.switch(*b), 1)),
            i if i == *b => Some((self.switch(*a), 1)),
            _ => None,
        });
        let near: Vec<_> = near.collect();
        let response = self.rib.report(self.now, &self.switches[index].proof(), &near, attached, None);
        assert!(matches!(response, Response::Done), "{response:?}");
    }

    pub fn ask(&mut self, entity: &Identity, at: usize, request: EntityRequest) -> Response {
        self.rib.request(self.now, self.switch(at), Some(&entity.proof()), false, &request)
    }

    pub fn attach(&mut self, entity: &Identity, at: usize) -> Response {
        let claims = RtCert { entity: entity.name(), switch: self.switch(at), not_after: UNIX + 1_000_000 };
        self.ask(entity, at, EntityRequest::Attach { rt_cert: issue(entity.key(), &claims).unwrap(), resumes: true })
    }

    pub fn attached(&mut self, _what: &str, at: usize) -> Identity {
        let entity = Identity::generate("proxy").unwrap();
        let response = self.attach(&entity, at);
        assert!(matches!(response, Response::Attached { serial: 0 }), "{response:?}");
        entity
    }

    pub fn detach(&mut self, entity: &Identity, at: usize) {
        self.rib.detach(self.now, &self.switch(at), &entity.name());
    }

    pub fn publish(&mut self, entity: &Identity, at: usize, serial: u64) -> Response {
        let mut parts = Parts::publish(self, entity, at);
        parts.advert.serial = serial;
        self.ask(entity, at, parts.advertise())
    }

    pub fn subscribe(&mut self, entity: &Identity, at: usize, serial: u64) -> Response {
        let request = self.subscription(entity, at, serial);
        self.ask(entity, at, request)
    }

    pub fn subscription(&self, entity: &Identity, at: usize, serial: u64) -> EntityRequest {
        let parts = Parts::publish(self, entity, at);
        let (name, to, serial_of_grant) = (parts.cert.name, Grantee::Entity(entity.name()), parts.cert.serial);
        let (not_before, not_after) = (UNIX, UNIX + 1_000_000);
        let grant = ReadGrant { name, to, serial: serial_of_grant, not_before, not_after };
        let advert = Advert { op: AdvertOp::Subscribe, serial, ..parts.advert };
        let (grant, advert) = (issue(&self.owner, &grant).unwrap().into(), issue(entity.key(), &advert).unwrap());
        EntityRequest::Subscribe { proof: parts.proof, grant, advert }
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
            last =
                self.rib.request(self.now, self.switch(0), None, false, &EntityRequest::Query { prefix, after: None });
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

    pub fn pass(&mut self, time: Duration) {
        self.now.clock += time;
        self.now.unix += time.as_secs();
        self.rib.tick(self.now);
    }

    /// All routes that should be: switch index, bits, local readers.
    pub fn routes(&self) -> Vec<(usize, u64, Vec<Name>)> {
        let of = |(i, s): (usize, &Identity)| {
            self.rib.desired(&s.name()).into_iter().map(move |r| (i, r.egress_bits, r.locals)).collect::<Vec<_>>()
        };
        self.switches.iter().enumerate().flat_map(of).collect()
    }

    pub fn detaches(&mut self) -> Vec<(Name, Name)> {
        let effects = self.rib.effects(self.now).into_iter();
        effects
            .filter_map(|e| if let Effect::Detach { switch, entity } = e { Some((switch, entity)) } else { None })
            .collect()
    }

    pub fn writers_told(&mut self) -> Vec<(Name, Name, usize)> {
        let (mut told, mut pushes) = (Vec::new(), Vec::new());
        for effect in self.rib.effects(self.now) {
            match effect {
                Effect::Writers(push) => told.push(push),
                Effect::Fib(push) => pushes.push(push),
                Effect::Detach { .. } => {}
            }
        }
        self.carry_out(pushes);
        told.iter().for_each(|push| self.rib.told(&push.name, &push.entity));
        told.into_iter().map(|push| (push.switch, push.entity, push.records.len())).collect()
    }

    pub fn pushes(&mut self) -> Vec<FibPush> {
        let effects = self.rib.effects(self.now).into_iter();
        effects.filter_map(|e| if let Effect::Fib(push) = e { Some(push) } else { None }).collect()
    }

    /// Carries pushes out until there are none; the FIBs of the switches are then what the RIB wants.
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
            (held.own_bit, held.reach) = (push.own_bit, push.reach);
            held.routes.extend(push.set.iter().map(|r| (r.name, r.clone())));
            held.routes.retain(|name, _| !push.remove.contains(name));
            self.rib.pushed(self.now, &push.switch, push.generation, Pushed::Done);
        }
    }

    /// The FIBs computed anew from who is registered, by the definition of a route.
    pub fn check_model(&self) {
        let (records, _) = self.rib.records(self.now, None, usize::MAX);
        for switch in self.switches.iter().map(Identity::name) {
            let mut model: BTreeMap<Name, Route> = BTreeMap::new();
            for record in &records {
                let of_name = || records.iter().filter(|other| other.name == record.name);
                if record.switch != switch || of_name().all(Record::is_writer) || !of_name().any(Record::is_writer) {
                    continue;
                }
                let empty = Route { name: record.name, egress_bits: 0, locals: vec![], writers: vec![] };
                let route = model.entry(record.name).or_insert(empty);
                let entity = record.entity.name().unwrap();
                if record.is_writer() {
                    let readers = of_name().filter(|other| !other.is_writer());
                    let bits = readers.map(|reader| 1 << self.rib.bit(&reader.switch).unwrap());
                    route.egress_bits = bits.fold(0, |all, bit: u64| all | bit);
                    route.writers.push(entity);
                } else {
                    route.locals.push(entity);
                }
            }
            assert_eq!(self.held[&switch].routes, model);
        }
    }

    /// Sends a frame of every registered writer through the switches' FIBs, as `gdp_wire::forward` would: each reader of the
    /// name gets one copy, if there is a path to its switch, and nobody else any.
    pub fn check_delivery(&self) {
        let (records, _) = self.rib.records(self.now, None, usize::MAX);
        for writer in records.iter().filter(|r| r.is_writer()) {
            let readers = records.iter().filter(|r| r.name == writer.name && !r.is_writer());
            let reached = readers.filter(|r| self.rib.topology.connected(&writer.switch, &r.switch));
            let expected: BTreeSet<_> = reached.map(|r| (r.switch, r.entity.name().unwrap())).collect();
            let copies = self.deliver(writer.switch, writer.name);
            assert_eq!(copies.len(), expected.len(), "a copy too many or too few");
            assert_eq!(BTreeSet::from_iter(copies), expected);
            assert!(
                self.held[&writer.switch]
                    .routes
                    .get(&writer.name)
                    .is_none_or(|route| { route.writers.contains(&writer.entity.name().unwrap()) })
            );
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
                let onward = held.reach.iter().map(|(next, reach)| (*next, bits & reach & !(1 << held.own_bit)));
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
                mode: Mode::Unicast,
                scope: vec![],
                serial: UNIX * 1_000_000_000,
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
        EntityRequest::Advertise { proof: self.proof, ad_cert: ad_cert.into(), advert }
    }

    pub fn withdraw(w: &World, entity: &Identity, at: usize, serial: u64) -> EntityRequest {
        let advert = Advert { op: AdvertOp::Withdraw, serial, ..Self::publish(w, entity, at).advert };
        EntityRequest::Withdraw { advert: issue(entity.key(), &advert).unwrap() }
    }
}

/// The last byte belongs to the signature.
fn flipped<T>(signed: &gdp::cert::Signed<T>) -> gdp::cert::Signed<T> {
    let mut bytes = signed.as_bytes().to_vec();
    *bytes.last_mut().unwrap() ^= 1;
    gdp::cert::Signed::from_bytes(bytes).unwrap()
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

//! Domains with real keys and certificates, their tiers, and links between them in simulated time:
//! every message is encoded and decoded, takes its time, and is lost when its link is down.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::domain::roles;
use gdp_core::cert::{
    AdCert, Advert, Grantee, Host, Locator, MemberCert, Membership, ReadGrant, Revocation, Signed, SwitchStatement,
    issue,
};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::KeyBox;
use gdp_core::name::{Name, NameProof};
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control;
use gdp_proto::control::{Credential, NameRole, Record, RecordKey, TierEntry, TierKey, TierRequest, TierResponse};

use gdp_rib::rib::Now;
use gdp_rib::tiers::{
    DomainRelation, Effect, Hosted, Item, Reply, Revoked, Sent, SessionState, Ticket, TierChange, TierLimits, Tiers,
};

pub const UNIX: u64 = 1_800_000_000;
pub const DAY: u64 = 86_400;

/// How long a message that is lost is waited for.
const TIMEOUT: Duration = Duration::from_secs(3);

/// Nothing is revoked, or this.
#[derive(Default)]
pub struct Revocations(pub BTreeMap<Name, Revocation>);

impl Revoked for Revocations {
    fn newest(&self, name: &Name) -> Option<&Revocation> {
        self.0.get(name)
    }

    fn signed(&self, _: &Name) -> Option<&SignedRevocation> {
        None
    }
}

/// What all know, and besides what the RIB of one domain has heard of owners.
struct Announced<'a> {
    all: &'a Revocations,
    own: &'a BTreeMap<Name, (SignedRevocation, Revocation)>,
}

impl Revoked for Announced<'_> {
    fn newest(&self, name: &Name) -> Option<&Revocation> {
        self.all.newest(name).or_else(|| Some(&self.own.get(name)?.1))
    }

    fn signed(&self, name: &Name) -> Option<&SignedRevocation> {
        self.own.get(name).map(|(kept, _)| kept)
    }
}

pub struct Domain {
    pub identity: Identity,
    pub switch: Identity,
    pub host: Host,
    pub locator: Locator,
    pub parents: Vec<usize>,
    pub tiers: Tiers,
    pub parts: BTreeMap<RecordKey, Part>,
    pub boxes: BTreeMap<Name, Vec<Signed<KeyBox>>>,
    /// What the own RIB was told, with whether it only passes.
    pub known: BTreeMap<TierKey, Item>,
    /// What its RIB keeps of what owners have taken back.
    pub owners: BTreeMap<Name, (SignedRevocation, Revocation)>,
}

/// What an entity has stated.
#[derive(Clone)]
pub struct Part {
    pub record: Record,
    pub scope: Vec<Name>,
    pub at: usize,
}

enum Travelling {
    Request { from: usize, to: usize, sent: Sent, bytes: Vec<u8> },
    Response { from: usize, to: usize, sent: Sent, bytes: Option<Vec<u8>> },
}

pub struct World {
    pub now: Now,
    pub domains: Vec<Domain>,
    /// Pairs, the smaller index first.
    pub links: BTreeSet<(usize, usize)>,
    pub down: BTreeSet<(usize, usize)>,
    travelling: BTreeMap<(Duration, u64), Travelling>,
    number: u64,
    pub random: Random,
    /// Queries of other domains that are answered later: whose, by ticket.
    waiting: BTreeMap<(usize, Ticket), (usize, Sent)>,
    pub answers: Vec<(usize, Vec<RecordKey>)>,
    pub pushes: u64,
    pub messages: u64,
    /// What own RIBs were told to forget.
    pub removed: u64,
    pub revocations: Revocations,
    runs: u64,
}

thread_local! {
    /// Keys cost more than all else here: entities and domains of one index have the same in all
    /// worlds.
    static IDENTITIES: RefCell<BTreeMap<(&'static str, usize), Identity>> = const { RefCell::new(BTreeMap::new()) };
}

pub fn identity(kind: &'static str, index: usize) -> Identity {
    IDENTITIES
        .with_borrow_mut(|all| all.entry((kind, index)).or_insert_with(|| Identity::generate(kind).unwrap()).clone())
}

pub fn owner(topic: usize) -> (SigningKey, NameProof) {
    let owner = identity("owner", topic);
    let proof = NameProof { owner_key: owner.key().public(), digest: [topic as u8; 32] };
    (owner.key().clone(), proof)
}

impl World {
    /// Each domain has these parents, in order; parents and children have a link.
    pub fn new(seed: u64, parents: &[&[usize]]) -> Self {
        let now = Now { unix: UNIX, clock: Duration::from_secs(1000) };
        let domains = parents.iter().enumerate().map(|(index, parents)| domain(index, parents)).collect();
        let mut world = Self {
            now,
            domains,
            links: BTreeSet::new(),
            down: BTreeSet::new(),
            travelling: BTreeMap::new(),
            number: 0,
            random: Random(seed),
            waiting: BTreeMap::new(),
            answers: Vec::new(),
            pushes: 0,
            messages: 0,
            removed: 0,
            revocations: Revocations::default(),
            runs: 0,
        };
        for (child, parents) in parents.iter().enumerate() {
            world.links.extend(parents.iter().map(|parent| pair(child, *parent)));
        }
        (0..world.domains.len()).for_each(|index| world.restart(index));
        world
    }

    /// The RIB of a domain begins anew; its entities state again what they had stated.
    pub fn restart(&mut self, index: usize) {
        self.runs += 1_000_000;
        let names: Vec<Name> = self.domains.iter().map(|domain| domain.identity.name()).collect();
        let adjacent = self.adjacent(index);
        let (now, domain) = (self.now, &mut self.domains[index]);
        domain.tiers = Tiers::new(names[index], self.runs, TierLimits::default());
        domain.known.clear();
        domain.tiers.set_parents(now, domain.parents.iter().map(|parent| names[*parent]).collect());
        domain.tiers.set_adjacent(now, adjacent);
        domain.tiers.set_own_locator(domain.locator.clone());
        for part in domain.parts.values() {
            domain.tiers.set_own(now, part.record.clone(), hosted(names[index], &domain.host)).unwrap();
        }
        for (writer, boxes) in &domain.boxes {
            domain.tiers.set_own_boxes(*writer, boxes.clone()).unwrap();
        }
        // Messages to the one before are lost.
        self.waiting.retain(|(at, _), _| *at != index);
    }

    /// The membership of a domain's switch is renewed, and with it what the switch states.
    pub fn renew(&mut self, at: usize, not_after: u64) {
        let domain = &mut self.domains[at];
        domain.host = host(&domain.identity, &domain.switch, roles::SWITCH, not_after);
        let host = hosted(domain.identity.name(), &domain.host);
        for part in domain.parts.values() {
            domain.tiers.set_own(self.now, part.record.clone(), host.clone()).unwrap();
        }
    }

    pub fn adjacent(&self, index: usize) -> BTreeSet<Name> {
        let up = self.links.difference(&self.down);
        let others = up.filter_map(|(a, b)| if *a == index { Some(*b) } else { (*b == index).then_some(*a) });
        others.map(|other| self.domains[other].identity.name()).collect()
    }

    pub fn set_link(&mut self, link: (usize, usize), up: bool) {
        if up {
            self.down.remove(&link)
        } else {
            self.down.insert(link)
        };
        for index in [link.0, link.1] {
            let adjacent = self.adjacent(index);
            self.domains[index].tiers.set_adjacent(self.now, adjacent);
        }
    }

    /// An entity states a part in a topic. Its scope: these domains.
    pub fn state(&mut self, at: usize, topic: usize, entity: usize, role: NameRole, scope: &[usize]) -> RecordKey {
        let scope: Vec<Name> = scope.iter().map(|index| self.domains[*index].identity.name()).collect();
        let record = self.record(at, topic, entity, role, &scope);
        let place = record.key().unwrap();
        let (now, domain) = (self.now, &mut self.domains[at]);
        domain.tiers.set_own(now, record.clone(), hosted(domain.identity.name(), &domain.host)).unwrap();
        domain.parts.insert(place, Part { record, scope, at });
        place
    }

    pub fn record(&mut self, at: usize, topic: usize, entity: usize, role: NameRole, scope: &[Name]) -> Record {
        self.number += 1;
        let ((owner, proof), entity) = (owner(topic), identity("proxy", entity));
        let (name, switch) = (proof.name().unwrap(), self.domains[at].switch.name());
        let (serial, not_before, not_after) = (self.number, UNIX - DAY, UNIX + DAY);
        let credential = if role.is_writer() {
            let (entity, scope) = (entity.name(), scope.to_vec());
            let cert = AdCert { name, entity, scope, serial, not_before, not_after };
            Credential::Writer(issue(&owner, &cert).unwrap().into())
        } else {
            let to = Grantee::Entity(entity.name());
            Credential::Reader(issue(&owner, &ReadGrant { name, to, serial, not_before, not_after }).unwrap().into())
        };
        let (op, lifetime, box_key) = (role.op(), 3600, entity.box_public());
        let advert = Advert { op, name, entity: entity.name(), switch, serial, lifetime, box_key };
        let advert = issue(entity.key(), &advert).unwrap();
        Record { name, proof, entity: entity.proof(), switch, credential, advert, expires_in: 3600 }
    }

    /// A writer wraps its key for a reader.
    pub fn wrap(&mut self, at: usize, topic: usize, writer: usize, reader: usize) {
        let (name, writer) = (owner(topic).1.name().unwrap(), identity("proxy", writer));
        let reader = identity("proxy", reader).name();
        let claims = KeyBox { name, writer: writer.name(), reader, epoch: 1, sealed: vec![0; 113] };
        let domain = &mut self.domains[at];
        let boxes = domain.boxes.entry(writer.name()).or_default();
        boxes.push(issue(writer.key(), &claims).unwrap());
        domain.tiers.set_own_boxes(writer.name(), boxes.clone()).unwrap();
    }

    pub fn withdraw(&mut self, place: RecordKey) {
        for domain in &mut self.domains {
            if domain.parts.remove(&place).is_some() {
                domain.tiers.remove_own(place);
            }
        }
    }

    pub fn query(&mut self, at: usize, topic: usize) {
        let name = owner(topic).1.name().unwrap();
        let now = self.now;
        match self.domains[at].tiers.query(now, name) {
            Reply::Now(TierResponse::Answer { entries, .. }) => self.answers.push((at, places(&entries))),
            Reply::Now(other) => panic!("{other:?}"),
            Reply::Later(_) => {}
        }
    }

    /// Lets time pass.
    pub fn run(&mut self, time: Duration) {
        let end = self.now.clock + time;
        let mut steps = 0;
        loop {
            (0..self.domains.len()).for_each(|index| self.collect(index));
            let message = self.travelling.keys().next().map(|(at, _)| *at);
            let ticks = self.domains.iter().filter_map(|domain| domain.tiers.next_tick());
            let Some(next) = ticks.chain(message).min().filter(|next| *next <= end) else { break };
            let next = next.max(self.now.clock);
            steps += 1;
            assert!(
                steps < 200_000,
                "it does not come to rest: at {:?} of {end:?}, {} messages, {} of them pushes",
                self.now.clock,
                self.messages,
                self.pushes
            );
            self.pass(next);
            while let Some(entry) = self.travelling.first_entry().filter(|entry| entry.key().0 <= next) {
                let message = entry.remove();
                self.deliver(message);
            }
        }
        self.pass(end);
    }

    fn pass(&mut self, to: Duration) {
        self.now = Now { unix: UNIX + to.as_secs() - 1000, clock: to };
    }

    fn index(&self, name: Name) -> usize {
        self.domains.iter().position(|domain| domain.identity.name() == name).unwrap()
    }

    fn collect(&mut self, index: usize) {
        for effect in self.domains[index].tiers.effects(self.now) {
            match effect {
                Effect::Ask { to, sent, request } => {
                    let bytes = control::encode(&request).expect("it fits a message")[4..].to_vec();
                    self.messages += 1;
                    self.pushes += u64::from(matches!(sent, Sent::Push { .. }));
                    let to = self.index(to);
                    self.send(index, to, Travelling::Request { from: index, to, sent, bytes });
                }
                Effect::Answer { ticket, response } => match self.waiting.remove(&(index, ticket)) {
                    Some((asker, sent)) => self.respond(index, asker, sent, response),
                    None => {
                        let TierResponse::Answer { entries, .. } = response else { panic!("{response:?}") };
                        self.answers.push((index, places(&entries)));
                    }
                },
            }
        }
        let changes = self.domains[index].tiers.take_changes(self.now);
        let home = self.domains[index].identity.name();
        for change in changes {
            match change {
                TierChange::Set(item) => {
                    if let Item::Part { record: held, only_passes: false } = &item {
                        let own = self.domains[index].parts.values();
                        let fits = own.filter(|own| own.record.name == held.key.name).any(|own| {
                            let (scope, other) = if held.key.role.is_writer() {
                                (&held.scope, home)
                            } else {
                                (&own.scope, held.path[0])
                            };
                            own.record.role().unwrap() == held.key.role.counterpart() && scope.contains(&other)
                        });
                        assert!(fits, "{index} is told of a part that is none of its business");
                    }
                    let key = match &item {
                        Item::Part { record: held, .. } => TierKey::Part(held.key),
                        Item::Box(signed) => box_key(signed),
                        Item::Locator { domain, .. } => TierKey::Locator(*domain),
                        Item::Revocation(_) => panic!("it has it of the requests"),
                    };
                    self.domains[index].known.insert(key, item);
                }
                TierChange::Remove(key) => {
                    self.removed += 1;
                    assert!(self.domains[index].known.remove(&key).is_some());
                }
            }
        }
    }

    fn send(&mut self, from: usize, to: usize, message: Travelling) {
        self.number += 1;
        let is_up = self.links.contains(&pair(from, to)) && !self.down.contains(&pair(from, to));
        let takes = Duration::from_millis(1 + self.random.below(50) as u64);
        let (at, message) = match message {
            message if is_up => (self.now.clock + takes, message),
            Travelling::Request { from, to, sent, .. } => {
                (self.now.clock + TIMEOUT, Travelling::Response { from: to, to: from, sent, bytes: None })
            }
            Travelling::Response { from, to, sent, .. } => {
                (self.now.clock + TIMEOUT, Travelling::Response { from, to, sent, bytes: None })
            }
        };
        self.travelling.insert((at, self.number), message);
    }

    fn respond(&mut self, from: usize, to: usize, sent: Sent, response: TierResponse) {
        let bytes = Some(control::encode(&response).expect("it fits a message")[4..].to_vec());
        self.send(from, to, Travelling::Response { from, to, sent, bytes });
    }

    fn deliver(&mut self, message: Travelling) {
        match message {
            Travelling::Request { from, to, sent, bytes } => {
                let request: TierRequest = control::decode(&bytes).unwrap();
                let asker = self.domains[from].identity.name();
                let Domain { tiers, owners, .. } = &mut self.domains[to];
                let heard = Announced { all: &self.revocations, own: owners };
                let reply = tiers.request(self.now, asker, request, &heard);
                tiers.take_revoked().into_iter().for_each(|kept| self.take_revoked(to, kept, Some(asker)));
                match reply {
                    Reply::Now(response) => self.respond(to, from, sent, response),
                    Reply::Later(ticket) => drop(self.waiting.insert((to, ticket), (from, sent))),
                }
            }
            Travelling::Response { from, to, sent, bytes } => {
                let response = bytes.map(|bytes| control::decode(&bytes).unwrap());
                let name = self.domains[from].identity.name();
                let Domain { tiers, owners, .. } = &mut self.domains[to];
                let heard = Announced { all: &self.revocations, own: owners };
                tiers.answered(self.now, name, sent, response, &heard);
            }
        }
    }

    /// The RIB of a domain is given what the owner of a topic has taken back: all with these
    /// serials.
    pub fn revoke(&mut self, at: usize, topic: usize, number: u64, revoked: Vec<u64>) {
        let kept = revocation(topic, number, revoked);
        self.take_revoked(at, kept, None);
    }

    /// As a RIB does: what it holds of its own domain goes, too.
    fn take_revoked(&mut self, at: usize, kept: SignedRevocation, said_by: Option<Name>) {
        let claims = kept.verify().unwrap();
        let (now, name) = (self.now, claims.name);
        let Domain { tiers, owners, parts, .. } = &mut self.domains[at];
        assert!(owners.get(&name).is_none_or(|(_, held)| held.number < claims.number), "it is no news");
        let holds = |part: &Part| {
            let serials = part.record.credential.serials().unwrap();
            serials.into_iter().all(|(what, serial)| claims.check(what, serial).is_ok())
        };
        let gone = parts.extract_if(.., |place, part| place.name == name && !holds(part));
        gone.for_each(|(place, _)| tiers.remove_own(place));
        owners.insert(name, (kept, claims));
        tiers.reconsider(now, name, said_by, &Announced { all: &self.revocations, own: owners });
    }

    /// The parents of each domain that it has accepted, over links that are up.
    pub fn accepted(&self) -> Vec<BTreeSet<usize>> {
        let parents = |index: usize| {
            let up = self.domains[index].tiers.neighbours().filter(|neighbour| {
                matches!(neighbour.kind, DomainRelation::Parent(_)) && neighbour.session == SessionState::Up
            });
            up.map(|neighbour| self.index(neighbour.domain)).collect()
        };
        (0..self.domains.len()).map(parents).collect()
    }

    /// Compares what each domain knows with what it should, by all that has been stated.
    pub fn check(&self, what: &str) {
        let above: Vec<BTreeSet<usize>> = {
            let accepted = self.accepted();
            let climb = |index: usize| {
                let (mut found, mut next) = (BTreeSet::from([index]), vec![index]);
                while let Some(at) = next.pop() {
                    next.extend(accepted[at].iter().filter(|parent| found.insert(**parent)));
                }
                found
            };
            (0..self.domains.len()).map(climb).collect()
        };
        let all: Vec<&Part> = self.domains.iter().flat_map(|domain| domain.parts.values()).collect();
        let domain_of = |part: &Part| self.domains[part.at].identity.name();
        for (index, domain) in self.domains.iter().enumerate() {
            let meets = |own: &Part, other: &Part| {
                let (own_role, role) = (own.record.role().unwrap(), other.record.role().unwrap());
                let (writer, reader) = if role.is_writer() { (other, own) } else { (own, other) };
                own.record.name == other.record.name
                    && role == own_role.counterpart()
                    && writer.scope.contains(&domain_of(reader))
            };
            let hears = |other: &&&Part| {
                other.at != index
                    && !above[index].is_disjoint(&above[other.at])
                    && domain.parts.values().any(|own| meets(own, other))
            };
            let expected: BTreeSet<RecordKey> =
                all.iter().filter(hears).map(|part| part.record.key().unwrap()).collect();
            let known: BTreeSet<RecordKey> = domain
                .known
                .values()
                .filter_map(|item| match item {
                    Item::Part { record: held, only_passes: false } => Some(held.key),
                    _ => None,
                })
                .collect();
            assert_eq!(known, expected, "{what}: what domain {index} knows");

            // Keys come for those who are to have them, and none for anybody who is not here.
            let other_parts = all.iter().filter(|part| known.contains(&part.record.key().unwrap()));
            let pairs: BTreeSet<(Name, Name)> = other_parts
                .flat_map(|other| domain.parts.values().filter(|own| meets(own, other)).map(move |own| (other, own)))
                .map(|(other, own)| (other.record.entity.name().unwrap(), own.record.entity.name().unwrap()))
                .collect();
            let here: BTreeSet<Name> = domain.parts.keys().map(|place| place.entity).collect();
            let of_others = self.domains.iter().filter(|other| !std::ptr::eq(*other, domain));
            for key in of_others.flat_map(|other| other.boxes.values().flatten().map(box_key)) {
                let TierKey::Box { writer, reader, .. } = key else { continue };
                let (is_due, is_held) = (pairs.contains(&(writer, reader)), domain.known.contains_key(&key));
                assert!(!is_due || is_held, "{what}: domain {index} lacks a key");
                assert!(!is_held || here.contains(&reader), "{what}: domain {index} has a key for nobody here");
            }
            for item in domain.known.values() {
                let Item::Part { record: held, .. } = item else { continue };
                assert!(domain.known.contains_key(&TierKey::Locator(held.path[0])), "{what}: no locator");
            }
        }
    }
}

fn domain(index: usize, parents: &[usize]) -> Domain {
    let (identity, switch) = (identity("domain", index), self::identity("switch", index));
    let border = self::identity("border", index);
    Domain {
        host: host(&identity, &switch, roles::SWITCH, UNIX + DAY),
        locator: Locator { borders: vec![host(&identity, &border, roles::BORDER, UNIX + DAY)] },
        tiers: Tiers::new(identity.name(), 0, TierLimits::default()),
        identity,
        switch,
        parents: parents.to_vec(),
        parts: BTreeMap::new(),
        boxes: BTreeMap::new(),
        known: BTreeMap::new(),
        owners: BTreeMap::new(),
    }
}

/// As a RIB has it that has verified it.
pub fn hosted(domain: Name, host: &Host) -> Arc<Hosted> {
    let not_after = host.statement.claims_unverified().unwrap().not_after;
    Arc::new(Hosted { host: host.clone(), domain, not_after })
}

/// What `domain` and `switch` say of the switch, until `not_after`.
pub fn host(domain: &Identity, switch: &Identity, role: &str, not_after: u64) -> Host {
    let addresses = if role == roles::BORDER { vec!["192.0.2.1:31415".parse().unwrap()] } else { vec![] };
    let (domain_name, entity, serial) = (domain.name(), switch.name(), 7);
    let member =
        MemberCert { domain: domain_name, entity, role: role.into(), serial, not_before: UNIX - DAY, not_after };
    let claims = SwitchStatement { switch: entity, domain: domain_name, addresses, serial: 1, not_after };
    Host {
        proof: switch.proof(),
        statement: issue(switch.key(), &claims).unwrap(),
        membership: Membership::issue(domain, &member).unwrap(),
    }
}

/// That the owner of a topic has taken back all with these serials.
pub fn revocation(topic: usize, number: u64, revoked: Vec<u64>) -> SignedRevocation {
    let (owner, proof) = owner(topic);
    let claims = Revocation { name: proof.name().unwrap(), number, floor: 0, revoked, signer: None };
    SignedRevocation { proof, revocation: issue(&owner, &claims).unwrap(), origin: None }
}

pub fn pair(a: usize, b: usize) -> (usize, usize) {
    (a.min(b), a.max(b))
}

fn box_key(signed: &Signed<KeyBox>) -> TierKey {
    let KeyBox { name, writer, reader, epoch, .. } = signed.claims_unverified().unwrap();
    TierKey::Box { writer, reader, name, epoch }
}

fn places(entries: &[TierEntry]) -> Vec<RecordKey> {
    let places = entries.iter().filter_map(|entry| match entry {
        TierEntry::Part(abroad) => Some(abroad.record.key().unwrap()),
        _ => None,
    });
    places.collect()
}

pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) as usize % bound
    }
}

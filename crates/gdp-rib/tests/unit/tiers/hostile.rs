//! What a neighbour may try: each attempt is refused, with a reason that is counted, and leaves
//! nothing behind.

use std::time::Duration;

use gdp_core::cert::domain::roles;
use gdp_core::cert::{Host, Locator, MemberCert, Membership, Revocation, Signed, SwitchStatement, issue};
use gdp_core::keys::KeyBox;
use gdp_core::name::Name;
use gdp_proto::control::{
    Extent, MAX_PATH, NameRole, RefusalCode, RemoteRecord, TierEntry, TierKey, TierPush, TierRequest, TierResponse,
};

use super::world::{DAY, UNIX, World, identity, owner};
use crate::rib::Now;
use crate::tiers::{Item, Reply, TierLimits, Tiers};

use NameRole::{Publisher, Subscriber};

/// A domain with a parent, 1, and a child, 2, which is hostile; 3 is another domain.
pub struct Victim {
    pub w: World,
    generation: u64,
}

#[test]
fn a_part_is_refused_unless_all_of_it_fits() {
    let mut v = Victim::new();
    let stranger = Name::from_bytes([9; 32]);
    let [home, child, third] = [0, 2, 3].map(|index| v.w.domains[index].identity.name());
    let right = v.part(2, &[0, 3]);
    let with = |change: &dyn Fn(&mut RemoteRecord)| {
        let mut abroad = right.clone();
        change(&mut abroad);
        abroad
    };
    let of_third = v.part(3, &[0]);
    let unscoped = v.part(2, &[]);
    let own_scope = v.part(2, &[2]);
    for (what, abroad, counted) in [
        ("no path", with(&|a| a.path.clear()), "path_length"),
        ("a long path", with(&|a| a.path = vec![stranger; MAX_PATH + 1]), "path_length"),
        ("another's word", RemoteRecord { path: vec![third], ..of_third.clone() }, "not_its_own"),
        ("through us", with(&|a| a.path = vec![child, home, child]), "cycle"),
        ("through one twice", with(&|a| a.path = vec![child, third, child]), "cycle"),
        ("of another domain", with(&|a| a.path = vec![third, child]), "wrong_domain"),
        ("a switch of another domain", RemoteRecord { path: vec![child], ..of_third.clone() }, "wrong_domain"),
        ("another's switch", with(&|a| a.host = of_third.host.clone()), "wrong_domain"),
        ("another switch", with(&|a| a.record.switch = stranger), "certificate"),
        ("another name", with(&|a| a.record.name = stranger), "certificate"),
        ("a spoilt statement", with(&|a| a.record.advert = flipped(&a.record.advert)), "signature"),
        ("a spoilt membership", with(&|a| a.host.membership.cert = flipped(&a.host.membership.cert)), "signature"),
        ("a spoilt word of the switch", with(&|a| a.host.statement = flipped(&a.host.statement)), "signature"),
        ("no scope", unscoped, "scope"),
        ("its own scope", own_scope, "scope"),
        ("over", with(&|a| a.record.expires_in = 0), "ended"),
    ] {
        let response = v.push(vec![TierEntry::Part(Box::new(abroad))]);
        assert!(matches!(response, TierResponse::Partly { refused: 1, .. }), "{what}: {response:?}");
        assert_eq!(v.counted(counted), 1, "{what}: {response:?}");
        assert_eq!(v.entries(), 0, "{what}");
        v.forget_counts();
    }
    let response = v.push(vec![TierEntry::Part(Box::new(right.clone()))]);
    assert!(matches!(response, TierResponse::Done), "{response:?}");
    let spoilt = with(&|a| a.record.advert = flipped(&a.record.advert));
    v.push(vec![TierEntry::Part(Box::new(spoilt))]);
    assert_eq!(v.entries(), 0, "what it said before it says no more");
}

#[test]
fn clocks_that_differ_are_told_apart_from_forgery() {
    let mut v = Victim::new();
    let right = v.part(2, &[0]);
    for (unix, counted) in [(UNIX - 2 * DAY, "not_yet_valid"), (UNIX + 2 * DAY, "expired")] {
        v.w.now = Now { unix, ..v.w.now };
        v.push(vec![TierEntry::Part(Box::new(right.clone()))]);
        assert_eq!((v.counted(counted), v.entries()), (1, 0));
    }
    v.w.now = Now { unix: UNIX + DAY - 10, ..v.w.now };
    v.push(vec![TierEntry::Part(Box::new(right))]);
    assert_eq!(v.entries(), 1);
    let ends = v.w.now.clock + Duration::from_secs(11);
    let now = Now { unix: UNIX + DAY + 1, clock: ends };
    v.w.domains[0].tiers.tick(now);
    assert_eq!(v.entries(), 0, "it ends with its certificates, whatever it says itself");
}

#[test]
fn boxes_and_locators_are_verified_and_go_forward_only() {
    let mut v = Victim::new();
    let right = v.part(2, &[0]);
    let (writer, reader) = (identity("proxy", 100), identity("proxy", 1).name());
    let name = owner(0).1.name().unwrap();
    let claims = KeyBox { name, writer: writer.name(), reader, epoch: 1, sealed: vec![0; 113] };
    let signed = issue(writer.key(), &claims).unwrap();
    v.push(vec![TierEntry::Box(signed.clone())]);
    assert_eq!(v.counted("no_writer"), 1);
    v.push(vec![TierEntry::Part(Box::new(right))]);
    v.push(vec![TierEntry::Box(issue(identity("proxy", 1).key(), &claims).unwrap())]);
    assert_eq!((v.counted("signature"), v.entries()), (1, 1));
    v.push(vec![TierEntry::Box(signed)]);
    assert_eq!(v.entries(), 2);

    let [home, child, third] = [0, 2, 3].map(|index| v.w.domains[index].identity.name());
    let right = v.w.domains[2].locator.clone();
    let locator = |domain, locator: &Locator| TierEntry::Locator { domain, locator: locator.clone() };
    v.push(vec![locator(home, &right)]);
    assert_eq!(v.counted("cycle"), 1, "a domain says itself where it is");
    v.push(vec![locator(third, &right)]);
    assert_eq!(v.counted("wrong_domain"), 1);
    let states = |serial| {
        let (border, mut locator) = (identity("border", 2), right.clone());
        let (switch, domain, addresses, not_after) = (border.name(), child, vec![], UNIX + 100);
        let claims = SwitchStatement { switch, domain, addresses, serial, not_after };
        locator.borders[0].statement = issue(border.key(), &claims).unwrap();
        locator
    };
    v.push(vec![locator(child, &states(5))]);
    assert_eq!(v.entries(), 3);
    v.push(vec![locator(child, &states(4))]);
    assert_eq!(v.counted("replayed"), 1);
}

#[test]
fn a_locator_goes_on_with_the_borders_that_are_left() {
    let mut v = Victim::new();
    let child = v.w.domains[2].identity.name();
    let names = [30, 31, 32].map(|index| identity("border", index).name());
    let borders = [(30, 50), (31, 20), (32, 90)].map(|(index, lasts)| v.border(index, 7, UNIX + lasts));
    v.push(vec![TierEntry::Locator { domain: child, locator: Locator { borders: borders.to_vec() } }]);
    assert_eq!(v.borders(), names);
    for (at, left) in [(20, &[0, 1, 2][..]), (21, &[0, 2]), (50, &[0, 2]), (51, &[2]), (90, &[2]), (91, &[])] {
        let now = Now { unix: UNIX + at, clock: Duration::from_secs(1001 + at) };
        v.w.domains[0].tiers.tick(now);
        let left: Vec<Name> = left.iter().map(|index| names[*index]).collect();
        assert_eq!(v.borders(), left, "after {at} s");
        // The child goes on to be there.
        v.w.now = now;
        v.ask(2, TierRequest::Hello { run: 77, holds: None });
    }
}

#[test]
fn a_border_that_does_not_verify_hides_no_other() {
    let mut v = Victim::new();
    let child = v.w.domains[2].identity.name();
    let push = |v: &mut Victim, borders: &[&Host]| {
        let borders = borders.iter().map(|border| (**border).clone()).collect();
        let response = v.push(vec![TierEntry::Locator { domain: child, locator: Locator { borders } }]);
        (v.borders(), response)
    };
    let [name, other_name] = [30, 31].map(|index| identity("border", index).name());
    let (good, other, over) = (v.border(30, 7, UNIX + 100), v.border(31, 9, UNIX + 100), v.border(32, 7, UNIX - 1));
    let mut spoilt = v.border(33, 7, UNIX + 100);
    spoilt.statement = flipped(&spoilt.statement);

    let (names, response) = push(&mut v, &[&over, &good, &spoilt, &other]);
    assert_eq!(names, [name, other_name]);
    assert!(matches!(response, TierResponse::Partly { refused: 2, .. }), "{response:?}");
    assert_eq!((v.counted("expired"), v.counted("signature")), (1, 1));
    // What one says goes forward only, whatever the others say.
    let older = v.border(30, 6, UNIX + 100);
    let (names, _) = push(&mut v, &[&older, &other]);
    assert_eq!((names, v.counted("replayed")), (vec![other_name], 1));
    assert_eq!(push(&mut v, &[&good, &other]).0, [name, other_name]);

    let revocation = Revocation { name: child, number: 1, floor: 8, revoked: vec![], signer: None };
    v.w.revocations.0.insert(child, revocation);
    let now = v.w.now;
    v.w.domains[0].tiers.reconsider(now, child, None, &v.w.revocations);
    assert_eq!((v.borders(), v.counted("revoked")), (vec![other_name], 1));
    let (names, response) = push(&mut v, &[&over, &good]);
    assert!(names.is_empty() && v.entries() == 0, "none is left: {response:?}");
    assert!(push(&mut v, &[&other; 9]).0.is_empty(), "more than are allowed");
}

#[test]
fn pushes_are_taken_in_their_order_only() {
    let mut v = Victim::new();
    let part = v.part(2, &[0]);
    let entry = || vec![TierEntry::Part(Box::new(part.clone()))];
    assert!(matches!(v.push(entry()), TierResponse::Done));
    let replayed = |v: &Victim| (v.generation, Extent::Full { part: 0, last: true });
    let skipped = |v: &Victim| (v.generation + 2, Extent::Delta);
    let no_first = |v: &Victim| (v.generation + 1, Extent::Full { part: 1, last: true });
    for of in [replayed, skipped, no_first] {
        let (generation, extent) = of(&v);
        let push = TierPush { run: 77, generation, extent, set: vec![], remove: vec![] };
        let response = v.ask(2, TierRequest::Push(Box::new(push)));
        let TierResponse::Refused(refusal) = response else { panic!("{response:?}") };
        assert_eq!(refusal.code, RefusalCode::ReplayedSerial);
        assert_eq!(v.entries(), 1, "nothing is swept by it");
    }
    assert_eq!(v.counted("generation"), 3);
    let push =
        TierPush { run: 78, generation: 1, extent: Extent::Full { part: 0, last: true }, set: vec![], remove: vec![] };
    v.ask(2, TierRequest::Push(Box::new(push)));
    assert_eq!(v.entries(), 0, "it has begun anew, and says nothing");
}

#[test]
fn who_is_no_neighbour_is_told_so_and_limits_hold() {
    let mut v = Victim::new();
    let part = v.part(3, &[0]);
    let push = |set| {
        TierRequest::Push(Box::new(TierPush {
            run: 1,
            generation: 1,
            extent: Extent::Full { part: 0, last: true },
            set,
            remove: vec![],
        }))
    };
    let name = owner(0).1.name().unwrap();
    let third = v.w.domains[3].identity.name();
    for request in [push(vec![TierEntry::Part(Box::new(part))]), TierRequest::Query { name, path: vec![third] }] {
        let response = v.ask(3, request);
        assert!(matches!(&response, TierResponse::Refused(refusal) if refusal.code == RefusalCode::NotAttached));
    }
    assert_eq!(v.w.domains[0].tiers.unknown_domains(), 2);
    let parent = v.w.domains[1].identity.name();
    let response = v.ask(1, TierRequest::Query { name, path: vec![parent] });
    assert!(matches!(response, TierResponse::Refused(_)), "a parent does not ask its child");
    let response = v.ask(1, TierRequest::Hello { run: 1, holds: None });
    let TierResponse::Refused(refusal) = response else { panic!("{response:?}") };
    assert!(refusal.reason.contains("each have the other"), "{refusal}");

    let home = v.w.domains[0].identity.name();
    let limits = TierLimits { children: 1, entries: 1, ..TierLimits::default() };
    let tiers = &mut v.w.domains[0].tiers;
    *tiers = Tiers::new(home, 9, limits);
    v.generation = 0;
    v.ask(2, TierRequest::Hello { run: 77, holds: None });
    let response = v.ask(3, TierRequest::Hello { run: 1, holds: None });
    assert!(matches!(&response, TierResponse::Refused(refusal) if refusal.code == RefusalCode::Limit));
    let (one, other) = (v.part(2, &[0]), v.part_in(2, 1, 101, &[0]));
    v.push([one, other].map(|part| TierEntry::Part(Box::new(part))).to_vec());
    assert_eq!((v.entries(), v.counted("limit")), (1, 1));
}

#[test]
fn what_grows_counts_as_what_is_new() {
    let mut v = Victim::new();
    let [home, child] = [0, 2].map(|index| v.w.domains[index].identity.name());
    let entry = |addresses: usize, serial| {
        let border = identity("border", 2);
        let addresses = vec!["192.0.2.1:31415".parse().unwrap(); addresses];
        let claims = SwitchStatement { switch: border.name(), domain: child, addresses, serial, not_after: UNIX + 100 };
        let mut locator = v.w.domains[2].locator.clone();
        locator.borders[0].statement = issue(border.key(), &claims).unwrap();
        locator
    };
    let (small, large, smaller) = (entry(4, 2), entry(8, 3), entry(3, 4));
    let bytes = Item::Locator { domain: child, locator: small.clone().into() }.size();
    v.w.domains[0].tiers = Tiers::new(home, 9, TierLimits { bytes, ..TierLimits::default() });
    v.ask(2, TierRequest::Hello { run: 77, holds: None });
    let mut push = |locator| {
        v.push(vec![TierEntry::Locator { domain: child, locator }]);
        (v.entries(), v.counted("limit"))
    };
    assert_eq!(push(small.clone()), (1, 0));
    assert_eq!(push(large), (0, 1), "nor does it say any more what it said before");
    assert_eq!(push(small), (1, 1));
    assert_eq!(push(smaller), (1, 1));
    assert_eq!(push(Locator::default()), (0, 1));
    assert_eq!(v.counted("nowhere"), 1, "it would stay for ever");
}

#[test]
fn queries_cannot_circle_and_what_is_remembered_of_them_is_bounded() {
    let mut v = Victim::new();
    let [home, child, third] = [0, 2, 3].map(|index| v.w.domains[index].identity.name());
    let name = owner(0).1.name().unwrap();
    for (path, counted) in [
        (vec![], "path_length"),
        (vec![third; MAX_PATH + 1], "path_length"),
        (vec![third], "not_its_own"),
        (vec![third, home, child], "cycle"),
    ] {
        let before = v.counted(counted);
        let response = v.ask(2, TierRequest::Query { name, path });
        assert!(matches!(response, TierResponse::Refused(_)));
        assert_eq!(v.counted(counted), before + 1);
    }
    let number = |i: u64| {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&i.to_be_bytes());
        Name::from_bytes(bytes)
    };
    let mut refused = 0;
    for i in 0..6000 {
        let (now, tiers) = (v.w.now, &mut v.w.domains[0].tiers);
        match tiers.request(now, child, TierRequest::Query { name: number(i), path: vec![child] }, &v.w.revocations) {
            Reply::Now(TierResponse::Refused(refusal)) if refusal.code == RefusalCode::Limit => refused += 1,
            Reply::Now(other) => panic!("{other:?}"),
            Reply::Later(_) => {}
        }
        if i % 100 == 99 {
            // Nobody above answers: all of them miss.
            v.w.now.clock += Duration::from_secs(2);
            drop(v.w.domains[0].tiers.effects(v.w.now));
            v.w.now.clock += Duration::from_millis(2);
            drop(v.w.domains[0].tiers.effects(v.w.now));
            v.ask(2, TierRequest::Hello { run: 77, holds: None });
        }
    }
    assert!(refused > 0, "of one neighbour only so many climb at a time");
    assert!(v.w.domains[0].tiers.queries.missed() <= 4096);
}

impl Victim {
    pub fn new() -> Self {
        let mut w = World::new(1, &[&[1], &[], &[0], &[]]);
        w.state(0, 0, 1, Subscriber, &[]);
        w.run(Duration::from_secs(1));
        let mut victim = Self { w, generation: 0 };
        victim.ask(2, TierRequest::Hello { run: 77, holds: None });
        victim
    }

    /// A right part of entity 100 in topic 0, stated in domain `at`, as that says it itself.
    pub fn part(&mut self, at: usize, scope: &[usize]) -> RemoteRecord {
        self.part_in(at, 0, 100, scope)
    }

    pub fn part_in(&mut self, at: usize, topic: usize, entity: usize, scope: &[usize]) -> RemoteRecord {
        let scope: Vec<Name> = scope.iter().map(|index| self.w.domains[*index].identity.name()).collect();
        let record = self.w.record(at, topic, entity, Publisher, &scope);
        let domain = &self.w.domains[at];
        RemoteRecord { record, host: domain.host.clone(), path: vec![domain.identity.name()] }
    }

    /// Of the child: the first is the whole, the following change it.
    pub fn push(&mut self, set: Vec<TierEntry>) -> TierResponse {
        self.change(set, vec![])
    }

    pub fn remove(&mut self, remove: Vec<TierKey>) -> TierResponse {
        self.change(vec![], remove)
    }

    fn change(&mut self, set: Vec<TierEntry>, remove: Vec<TierKey>) -> TierResponse {
        self.generation += 1;
        let extent = if self.generation == 1 { Extent::Full { part: 0, last: true } } else { Extent::Delta };
        let push = TierPush { run: 77, generation: self.generation, extent, set, remove };
        self.ask(2, TierRequest::Push(Box::new(push)))
    }

    /// A border of the child, whose membership has this serial and lasts until then.
    fn border(&self, index: usize, serial: u64, until: u64) -> Host {
        let (border, domain) = (identity("border", index), &self.w.domains[2].identity);
        let (role, not_before, not_after) = (roles::BORDER.into(), UNIX - 100, until);
        let cert = MemberCert { domain: domain.name(), entity: border.name(), role, serial, not_before, not_after };
        let (switch, not_after) = (border.name(), UNIX + 200);
        let claims = SwitchStatement { switch, domain: domain.name(), addresses: vec![], serial, not_after };
        let (proof, statement) = (border.proof(), issue(border.key(), &claims).unwrap());
        Host { proof, statement, membership: Membership::issue(domain, &cert).unwrap() }
    }

    /// Where the child is said to be reached.
    fn borders(&self) -> Vec<Name> {
        let child = self.w.domains[2].identity.name();
        match self.w.domains[0].tiers.sides[&child].table.get(&TierKey::Locator(child)) {
            Some(Item::Locator { locator, .. }) => locator.borders.iter().map(|it| it.proof.name().unwrap()).collect(),
            _ => vec![],
        }
    }

    pub fn ask(&mut self, from: usize, request: TierRequest) -> TierResponse {
        let from = self.w.domains[from].identity.name();
        let (now, tiers) = (self.w.now, &mut self.w.domains[0].tiers);
        match tiers.request(now, from, request, &self.w.revocations) {
            Reply::Now(response) => response,
            Reply::Later(ticket) => panic!("{ticket:?}"),
        }
    }

    pub fn entries(&self) -> usize {
        self.child().entries_in
    }

    pub fn counted(&self, what: &str) -> u64 {
        self.child().refused.get(what).copied().unwrap_or_default()
    }

    fn child(&self) -> crate::tiers::Neighbour {
        let child = self.w.domains[2].identity.name();
        self.w.domains[0].tiers.neighbours().find(|neighbour| neighbour.domain == child).unwrap()
    }

    pub fn forget_counts(&mut self) {
        self.w.domains[0].tiers.sides.values_mut().for_each(|side| side.refused.clear());
    }
}

/// The last byte belongs to the signature.
pub fn flipped<T>(signed: &Signed<T>) -> Signed<T> {
    let mut bytes = signed.as_bytes().to_vec();
    *bytes.last_mut().unwrap() ^= 1;
    Signed::from_bytes(bytes).unwrap()
}

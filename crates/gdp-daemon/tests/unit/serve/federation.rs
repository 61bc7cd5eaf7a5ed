//! Unit tests of `serve::federation`: the records of other domains that the RIB gets, and the
//! retries of those that it refuses.

#[path = "../../../../gdp-rib/tests/unit/tiers/world.rs"]
#[allow(dead_code, reason = "these tests need a part of the test domains")]
mod world;

use std::time::Duration;

use gdp_core::cert::domain::roles;
use gdp_core::cert::issue;
use gdp_core::domain::Credentials;
use gdp_core::identity::Identity;
use gdp_proto::control::{Extent, NameRole, Record, RemoteRecord, TierEntry, TierPush, TierRequest, TierResponse};

use super::*;
use gdp_rib::rib::{Limits, RibRun};
use world::{Revocations, UNIX, World, host, hosted, identity};

use NameRole::{Publisher, Subscriber};

/// A domain with a child domain that publishes to a subscriber here.
struct Home {
    world: World,
    rib: Rib,
    federation: Federation,
    generation: u64,
}

#[test]
fn what_there_is_no_room_for_is_taken_once_there_is() {
    let mut h = Home::new(Limits { records_per_neighbour: 1, ..Limits::default() });
    let [one, other] = [100, 101].map(|writer| h.world.record(1, 0, writer, Publisher, &[h.home()]));
    h.push(vec![one.clone()], vec![]);
    h.push(vec![other.clone()], vec![]);
    assert_eq!(h.known(), [place(&one)]);
    for _ in 0..5 {
        h.pass();
        assert_eq!(h.known(), [place(&one)]);
    }
    h.push(vec![], vec![&one]);
    assert_eq!(h.known(), []);
    h.pass();
    assert_eq!(h.known(), [place(&other)]);
    assert_eq!(h.federation.retries.next_tick(), None);

    h.push(vec![one.clone()], vec![]);
    h.push(vec![], vec![&one]);
    assert_eq!(h.federation.retries.next_tick(), None, "nobody tells of it any more");
    h.push(vec![], vec![&other]);
    assert_eq!(h.known(), []);
}

#[test]
fn a_switch_that_was_of_this_domain_may_be_of_another() {
    let mut h = Home::new(Limits::default());
    let (now, switch) = (h.world.now, h.world.domains[1].switch.clone());
    assert!(matches!(h.rib.report(now, &switch.proof(), &[], None), Response::Reported { .. }));
    let record = h.world.record(1, 0, 100, Publisher, &[h.home()]);
    h.push(vec![record.clone()], vec![]);
    assert_eq!(h.known(), []);
    // No switch reaches it, so the RIB drops it in time.
    while h.known().is_empty() {
        assert!(h.world.now.clock < now.clock + Duration::from_secs(60));
        h.pass();
    }
    assert_eq!(h.known(), [place(&record)]);
}

#[test]
fn a_domain_says_only_where_it_can_be_reached_now() {
    let mut h = Home::new(Limits::default());
    let [one, other] = ["one", "other"].map(|name| identity("border", name.len()));
    let report = |h: &mut Home, border: &Identity| {
        let response = h.rib.report(h.world.now, &border.proof(), &[], None);
        assert!(matches!(response, Response::Reported { .. }), "{response:?}");
    };
    let located = |h: &Home| -> BTreeSet<Name> {
        let borders = h.federation.locator().borders;
        borders.iter().map(|border| border.proof.name().unwrap()).collect()
    };
    for border in [&one, &other] {
        report(&mut h, border);
        h.show(border, border, roles::BORDER, UNIX + 1000).unwrap();
    }
    let wrong = h.show(&one, &other, roles::BORDER, UNIX + 2000).unwrap_err();
    assert!(matches!(wrong, CertError::WrongKey { .. } | CertError::BadSignature { .. }), "{wrong}");
    assert!(h.show(&one, &one, roles::BORDER, UNIX - 1).is_err(), "over");
    assert_eq!(located(&h), [one.name(), other.name()].into(), "what it has shown before counts");
    h.show(&other, &other, roles::SWITCH, UNIX + 1000).unwrap();
    assert_eq!(located(&h), [one.name()].into(), "no border any more");

    // No other switch reaches them, so the RIB drops both. One comes back.
    while h.rib.knows(&one.name()) || h.rib.knows(&other.name()) {
        h.world.now.clock = h.rib.next_tick().unwrap();
        h.rib.tick(h.world.now);
    }
    h.federation.forget_hosts(h.world.now, &h.rib);
    assert_eq!(located(&h), [].into());
    report(&mut h, &one);
    h.show(&one, &one, roles::BORDER, UNIX + 1000).unwrap();
    assert_eq!(located(&h), [one.name()].into());

    // Its membership expires, or is revoked.
    let ends = h.federation.hosts[&one.name()].ends;
    assert_eq!(ends, h.world.now.clock + Duration::from_secs(1001));
    h.federation.forget_hosts(Now { clock: ends, ..h.world.now }, &h.rib);
    assert_eq!(located(&h), [].into());
    h.show(&one, &one, roles::BORDER, UNIX + 1000).unwrap();
    h.federation.recheck_hosts(Some(&Revocation {
        name: h.home(),
        number: 1,
        floor: 7,
        revoked: vec![],
        signer: None,
    }));
    assert_eq!(located(&h), [one.name()].into());
    h.federation.recheck_hosts(Some(&Revocation {
        name: h.home(),
        number: 2,
        floor: 8,
        revoked: vec![],
        signer: None,
    }));
    assert_eq!(located(&h), [].into());
}

#[test]
fn a_border_is_told_again_while_a_wanted_link_is_missing() {
    let mut h = Home::new(Limits::default());
    let [border, peer] = [30, 31].map(|index| identity("border", index).name());
    let wanted = WantedPeerings::from([(peer, vec!["192.0.2.1:31415".parse().unwrap()])]);
    h.federation.wanted.insert(border, (wanted, None));
    let now = h.world.now.clock;
    h.federation.remind_borders(now, |at, to| (at, to) == (border, peer));
    assert_eq!(h.federation.wanted[&border].1, None);
    h.federation.remind_borders(now, |_, _| false);
    h.federation.remind_borders(now + REMINDER / 2, |_, _| false);
    assert_eq!(h.federation.wanted[&border].1, Some(now + REMINDER));
    assert!(h.federation.next_tick() <= Some(now + REMINDER), "somebody looks then");
}

impl Home {
    fn new(limits: Limits) -> Self {
        let mut world = World::new(1, &[&[], &[0]]);
        let (home, switch) = (world.domains[0].identity.name(), world.domains[0].switch.name());
        let mut federation = Federation::new(home, 9);
        let rib = Rib::new(switch, RibRun { id: 1, settling: Duration::ZERO }, limits);
        let (now, domain) = (world.now, &world.domains[0]);
        let host = hosted(domain.identity.name(), &domain.host);
        federation.tiers.set_own(now, world.record(0, 0, 1, Subscriber, &[]), host).unwrap();
        let mut home = Self { world, rib, federation, generation: 0 };
        home.ask(TierRequest::Hello { run: 77, holds: None });
        home
    }

    fn home(&self) -> Name {
        self.world.domains[0].identity.name()
    }

    /// Registers a switch with a membership and a statement signed by `signer`, both until `until`.
    fn show(&mut self, switch: &Identity, signer: &Identity, role: &str, until: u64) -> Result<(), CertError> {
        let mut shown = host(&self.world.domains[0].identity, switch, role, until);
        shown.statement = issue(signer.key(), &shown.statement.claims_unverified()?)?;
        let papers = Credentials { membership: self.world.domains[0].host.membership.clone(), peers: vec![] };
        let own = self.world.domains[0].switch.name();
        let trust = Trust::new(own, Arc::new(papers), false).expect("papers of this switch");
        self.federation.show(self.world.now, &trust, switch.name(), shown)
    }

    /// Sends a push of the child. The first push is a full one, the following are deltas.
    fn push(&mut self, set: Vec<Record>, remove: Vec<&Record>) {
        self.generation += 1;
        let extent = if self.generation == 1 { Extent::Full { part: 0, last: true } } else { Extent::Delta };
        let child = &self.world.domains[1];
        let (host, path) = (child.host.clone(), vec![child.identity.name()]);
        let part = |record| TierEntry::Part(Box::new(RemoteRecord { record, host: host.clone(), path: path.clone() }));
        let set = set.into_iter().map(part).collect();
        let remove = remove.into_iter().map(|record| TierKey::Part(place(record))).collect();
        let push = TierPush { run: 77, generation: self.generation, extent, set, remove };
        self.ask(TierRequest::Push(Box::new(push)));
        self.federation.inform(self.world.now, &mut self.rib);
    }

    fn ask(&mut self, request: TierRequest) {
        let child = self.world.domains[1].identity.name();
        let reply = self.federation.tiers.request(self.world.now, child, request, &Revocations::default());
        let Reply::Now(TierResponse::Done | TierResponse::Hello { .. }) = reply else { panic!("{reply:?}") };
    }

    /// Advances the clock to the next timer of RIB or retries, and runs it.
    fn pass(&mut self) {
        let next = self.federation.retries.next_tick().into_iter().chain(self.rib.next_tick()).min();
        self.world.now.clock = next.expect("something is to be done");
        self.rib.tick(self.world.now);
        // The child keeps its session alive.
        self.ask(TierRequest::Hello { run: 77, holds: None });
        self.federation.inform(self.world.now, &mut self.rib);
    }

    /// Returns the records that the RIB knows.
    fn known(&self) -> Vec<RecordKey> {
        let (records, _) = self.rib.records(self.world.now, None, 10);
        records.iter().map(place).collect()
    }
}

fn place(record: &Record) -> RecordKey {
    record.key().unwrap()
}

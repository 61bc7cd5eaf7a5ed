//! Who enters the directory, who leaves it, and whom it lets read what.

use super::*;
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Invite, MemberCert, TopicsOf};
use gdp_core::domain::{Enrolling, Token};
use gdp_core::identity::Identity;

use crate::directory::CatalogName;
use crate::messages::Approval;
use crate::{directory_card, join_card};

const NOW: u64 = 1_800_000_000;
const NANOS: u64 = NOW * 1_000_000_000;

struct Domain {
    identity: Identity,
    service: JoinService,
    key: SigningKey,
    serial: u64,
}

/// A machine with what it shows the join service.
struct Machine {
    entity: Name,
    request: Join,
    owner: SigningKey,
}

impl Domain {
    fn new() -> Self {
        let identity = Identity::generate("domain").unwrap();
        let key = SigningKey::generate().unwrap();
        let service = JoinService::new(key.clone(), identity.name());
        Self { identity, service, key, serial: NANOS }
    }

    fn invite(&mut self, label: &str, import: Vec<TopicsOf>, read: Vec<TopicsOf>) -> Token {
        self.serial += 1;
        let (domain, serial, invited) = (self.identity.name(), self.serial, SigningKey::generate().unwrap());
        let (not_before, not_after, member_until) = (NOW - 60, NOW + 600, NOW + 1_000_000);
        let (key, role) = (invited.verify_key(), "robot".to_owned());
        let invite = Invite { domain, key, role, serial, not_before, not_after, member_until };
        let enrollment = Enrollment {
            domain,
            member: serial,
            label: label.into(),
            expose: vec!["/camera/**".into()],
            import,
            read,
            join_service: self.key.verify_key(),
            serial,
            not_before,
            not_after: member_until,
        };
        let name = join_card(self.key.verify_key()).unwrap().name();
        let call = Delegation { name, delegate: key, publish: false, read: true, serial, not_before, not_after };
        let signer = self.identity.key();
        let enrolling =
            Enrolling { enrollment: issue(signer, &enrollment).unwrap(), call: issue(&self.key, &call).unwrap() };
        let at = "udp://192.0.2.1:31415".parse().unwrap();
        let token = Token::new(self.identity.proof(), issue(signer, &invite).unwrap(), invited, at, None).unwrap();
        let line = token.enroll(enrolling).unwrap().to_line();
        Token::from_line(&line).unwrap()
    }

    fn machine(&self, token: &Token) -> Machine {
        let (entity, owner) = (Identity::generate("proxy").unwrap().name(), SigningKey::generate().unwrap());
        let card = NameCard::create(owner.verify_key(), "catalog", "/x", "", None).unwrap();
        let delegation = Delegation {
            name: card.name(),
            delegate: self.key.verify_key(),
            publish: false,
            read: true,
            serial: NANOS,
            not_before: NOW - 60,
            not_after: NOW + 1_000_000,
        };
        let (name, scope, not_before, not_after) = (card.name(), vec![], NOW - 60, NOW + 1_000_000);
        let right = AdCert { name, entity, scope, serial: NANOS, not_before, not_after };
        let catalog = OfferedCatalog {
            name: CatalogName::from(&card),
            right: issue(&owner, &right).unwrap(),
            delegation: issue(&owner, &delegation).unwrap(),
        };
        let request = Join {
            membership: token.admit(entity, NOW - 60, NANOS + 1000).unwrap(),
            enrollment: token.enrolling().unwrap().enrollment.clone(),
            catalog: Some(catalog),
        };
        Machine { entity, request, owner }
    }

    fn join(&mut self, machine: &Machine) -> JoinReply {
        self.service.answer(machine.entity, JoinRequest::Join(machine.request.clone().into()), NANOS)
    }

    fn members(&mut self, reader: Name) -> Vec<Member> {
        let bytes = self.service.directory(NANOS).to_bytes().unwrap();
        Directory::from_bytes(&bytes).unwrap().members(self.identity.name(), reader, NOW)
    }
}

fn all() -> Vec<TopicsOf> {
    vec![TopicsOf { member: "*".into(), topics: vec!["/**".into()] }]
}

fn from_server() -> Vec<TopicsOf> {
    vec![TopicsOf { member: "server".into(), topics: vec!["/cmd_vel".into()] }]
}

#[track_caller]
fn refused(reply: JoinReply, why: &str) {
    match reply {
        JoinReply::Refused(reason) => assert!(reason.contains(why), "{reason}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn members_read_what_the_domain_enrolled_them_for() {
    let mut home = Domain::new();
    let (server, robot) = (home.invite("server", vec![], all()), home.invite("robot7", from_server(), vec![]));
    let (server, robot) = (home.machine(&server), home.machine(&robot));
    for machine in [&server, &robot] {
        let JoinReply::Joined { directory, call } = home.join(machine) else { panic!("refused") };
        let owner = home.key.verify_key();
        for (grant, card) in [(directory, directory_card(owner)), (call, join_card(owner))] {
            let grant = grant.verify(&card.unwrap().proof(), None, NOW).unwrap();
            assert_eq!(grant.to, entity(machine.entity));
        }
    }
    let members = home.members(server.entity);
    let labels: Vec<_> = members.iter().map(|member| member.enrollment.label.as_str()).collect();
    assert_eq!(labels, ["robot7", "server"]);
    let [at_robot, at_server] = &members[..] else { panic!() };
    assert!(at_robot.grant.is_some() && at_server.grant.is_none(), "for the server's eyes");
    assert_eq!(at_robot.readable_by(&at_server.enrollment), ["/**"]);
    assert_eq!(at_server.readable_by(&at_robot.enrollment), ["/robot7/cmd_vel"]);
    let imported: Vec<_> = at_server.imported_by(&at_robot.enrollment).collect();
    assert_eq!(imported, [("/robot7/cmd_vel".to_owned(), "/cmd_vel")]);
    let members = home.members(robot.entity);
    assert!(members[0].grant.is_none() && members[1].grant.is_some(), "for the robot's eyes");
}

#[test]
fn an_invitation_enrolls_one_and_only_its_holder() {
    let mut home = Domain::new();
    let token = home.invite("robot7", vec![], vec![]);
    let (first, second) = (home.machine(&token), home.machine(&token));
    assert!(matches!(home.join(&first), JoinReply::Joined { .. }));
    assert!(matches!(home.join(&first), JoinReply::Joined { .. }), "again, after an attempt that broke off");
    refused(home.join(&second), "it enrolls one");

    let thief = Machine { entity: second.entity, request: first.request.clone(), owner: second.owner };
    refused(home.join(&thief), "shows it");
    let other = home.invite("robot8", vec![], all());
    let mut swapped = home.machine(&other);
    swapped.request.enrollment = first.request.enrollment.clone();
    refused(home.join(&swapped), "another member");
    let mut foreign = Domain::new();
    let stranger = foreign.invite("robot9", vec![], all());
    let stranger = foreign.machine(&stranger);
    refused(home.join(&stranger), "domain");
}

#[test]
fn who_is_revoked_or_leaves_is_not_listed() {
    let mut home = Domain::new();
    let tokens = ["one", "two", "three"].map(|label| home.invite(label, vec![], vec![]));
    let machines = tokens.map(|token| home.machine(&token));
    for machine in &machines {
        assert!(matches!(home.join(machine), JoinReply::Joined { .. }));
    }
    let revoked = machines[0].request.membership.serial_unverified().unwrap();
    let revocation =
        Revocation { name: home.identity.name(), number: 1, floor: 0, revoked: vec![revoked], signer: None };
    assert!(home.service.revoke(revocation.clone()));
    assert!(!home.service.revoke(revocation));
    refused(home.join(&machines[0]), "revo");
    assert_eq!(home.service.answer(machines[1].entity, JoinRequest::Leave, NANOS), JoinReply::Left);
    let labels: Vec<_> = home.service.rows(NOW).into_iter().map(|row| row.enrollment.label).collect();
    assert_eq!(labels, ["three"]);
    refused(home.join(&machines[1]), "has left");
    assert!(home.service.rows(NOW + 2_000_000).is_empty(), "all have expired");
}

#[test]
fn a_catalog_that_is_not_delegated_is_refused() {
    let mut home = Domain::new();
    let token = home.invite("robot7", vec![], vec![]);
    let mut machine = home.machine(&token);
    let other = home.machine(&token);
    machine.request.catalog.as_mut().unwrap().delegation = other.request.catalog.unwrap().delegation;
    refused(home.join(&machine), "");

    // One that ends soon would leave the directory without its grants.
    let mut machine = home.machine(&token);
    let catalog = machine.request.catalog.as_mut().unwrap();
    let short = Delegation { not_after: NOW + 1, ..catalog.delegation.claims_unverified().unwrap() };
    catalog.delegation = issue(&machine.owner, &short).unwrap();
    refused(home.join(&machine), "for as long as it should");

    // The catalog of another member, as the directory shows it.
    let (victim, thief) = (home.invite("victim", vec![], vec![]), home.invite("thief", vec![], vec![]));
    let (victim, mut thief) = (home.machine(&victim), home.machine(&thief));
    assert!(matches!(home.join(&victim), JoinReply::Joined { .. }));
    thief.request.catalog = victim.request.catalog.clone();
    refused(home.join(&thief), "of another member");
}

#[test]
fn a_member_changes_its_entry_now_and_then_only() {
    let mut home = Domain::new();
    let token = home.invite("robot7", vec![], vec![]);
    let mut machine = home.machine(&token);
    assert!(matches!(home.join(&machine), JoinReply::Joined { .. }));
    machine.request.catalog = None;
    refused(home.join(&machine), "some seconds");
    let later = home.service.answer(machine.entity, JoinRequest::Join(machine.request.into()), NANOS + CHANGE_INTERVAL);
    assert!(matches!(later, JoinReply::Joined { .. }));
}

#[test]
fn members_and_grants_outlive_a_restart() {
    let mut home = Domain::new();
    let (server, robot) = (home.invite("server", vec![], all()), home.invite("robot7", from_server(), vec![]));
    for token in [server, robot] {
        let machine = home.machine(&token);
        home.join(&machine);
    }
    let published = home.service.directory(NANOS);
    assert_eq!(home.service.directory(NANOS + 1), published, "nothing is issued again at once");
    let later = home.service.directory(NANOS + (GRANT_LIFETIME / 2) * 1_000_000_000);
    assert_ne!(later, published, "grants are issued again after half of their validity");
    let mut again = JoinService::new(home.key.clone(), home.identity.name());
    again.restore(&home.service.to_bytes().unwrap()).unwrap();
    assert_eq!(again.rows(NOW), home.service.rows(NOW));
    assert!(again.restore(b"nonsense").is_err());
}

#[test]
fn an_application_waits_until_a_person_decides() {
    let mut home = Domain::new();
    let token = home.invite("robot7", vec![], vec![]);
    let machine = home.machine(&token);
    let key = SigningKey::generate().unwrap().verify_key();
    let label = "robot7".to_owned();
    let application = Application { key, label, expose: vec!["/a".into()], import: vec![], read: vec![] };
    let mut ask = |caller, application: &Application| {
        home.service.answer(caller, JoinRequest::Apply(application.clone().into()), NANOS)
    };
    assert_eq!(ask(machine.entity, &application), JoinReply::Pending);
    for bad in [
        Application { label: "../x".into(), ..application.clone() },
        Application { expose: vec!["/\u{1b}[2J".into()], ..application.clone() },
        Application { expose: vec!["/a".into(); 65], ..application.clone() },
    ] {
        assert!(matches!(ask(machine.entity, &bad), JoinReply::Refused(_)), "{bad:?}");
    }
    let flood: Vec<_> =
        (0..MAX_APPLICATIONS).map(|_| ask(Identity::generate("proxy").unwrap().name(), &application)).collect();
    refused(flood.last().unwrap().clone(), "wait already");
    assert_eq!(ask(machine.entity, &application), JoinReply::Pending, "who waits may ask again");

    let stored = home.service.applications().clone();
    let (invite, enrolling) = (token.invite_signed().clone(), token.enrolling().unwrap().clone());
    let approval = Approval { invite, enrollment: enrolling.enrollment, call: enrolling.call };
    let approved = Decision::Approved(Box::new(approval.clone()));
    assert!(home.service.decide([(machine.entity, approved)].into()));
    let reply = home.service.answer(machine.entity, JoinRequest::Apply(application.clone().into()), NANOS);
    assert_eq!(reply, JoinReply::Approved(Box::new(approval)));
    assert!(!home.service.applications().contains_key(&machine.entity));
    assert!(!home.service.decide([(machine.entity, Decision::Denied)].into()), "it waits no more");
    refused(home.service.answer(machine.entity, JoinRequest::Apply(application.into()), NANOS), "denied");
    home.service.restore_applications(stored);
    assert!(home.service.applications().contains_key(&machine.entity));
}

#[test]
fn the_domain_may_enroll_a_member_for_other_topics() {
    let mut home = Domain::new();
    let (joined, later) = (home.invite("robot7", vec![], vec![]), home.invite("robot8", vec![], vec![]));
    let (joined, later) = (home.machine(&joined), home.machine(&later));
    assert!(matches!(home.join(&joined), JoinReply::Joined { .. }));
    for machine in [&joined, &later] {
        let claims = machine.request.enrollment.claims_unverified().unwrap();
        let claims = Enrollment { serial: claims.serial + 100, expose: vec!["/odom".into()], ..claims };
        let is_member = home.service.enroll(issue(home.identity.key(), &claims).unwrap());
        assert_eq!(is_member, machine.entity == joined.entity);
    }
    assert!(matches!(home.join(&later), JoinReply::Joined { .. }), "with the invitation as it was");
    assert!(home.service.rows(NOW).iter().all(|row| row.enrollment.expose == ["/odom"]));
    assert!(!home.service.enroll(joined.request.enrollment.clone()), "an older one");
    assert!(home.service.rows(NOW).iter().all(|row| row.enrollment.expose == ["/odom"]));
}

#[test]
fn a_member_is_renewed_when_half_of_its_time_has_passed() {
    let mut home = Domain::new();
    let token = home.invite("robot7", vec![], all());
    let robot = home.machine(&token);
    home.join(&robot);
    let (domain, nanos) = (home.identity.name(), |at: u64| at * 1_000_000_000);
    let base = robot.request.membership.clone();
    assert!(!home.service.renew_due(nanos(NOW + 900_000)), "the domain delegates no renewal");

    let delegation = RenewalDelegation {
        domain,
        member: base.serial_unverified().unwrap(),
        key: home.key.verify_key(),
        lifetime: 1_000_000,
        serial: NANOS,
        not_before: NOW - 60,
        not_after: NOW + 3_000_000,
    };
    home.service.delegate(issue(home.identity.key(), &delegation).unwrap());
    assert!(!home.service.renew_due(nanos(NOW + 400_000)), "more than half is left");
    assert!(home.service.renew_due(nanos(NOW + 900_000)));
    assert!(!home.service.renew_due(nanos(NOW + 900_001)));
    let renewed = |home: &mut Domain| home.service.directory(nanos(NOW + 900_000)).entries[0].membership.clone();
    let membership = renewed(&mut home);
    assert_eq!(membership.verify(domain, None, NOW + 1_800_000).unwrap().entity, robot.entity);

    // A machine that joins again with its first membership keeps the renewed one.
    home.service.answer(robot.entity, JoinRequest::Join(robot.request.clone().into()), NANOS + 3_000_000_000);
    assert_eq!(renewed(&mut home), membership);
    let stored = home.service.to_bytes().unwrap();
    home.service.restore(&stored).unwrap();
    assert_eq!(renewed(&mut home), membership);

    let revoked = vec![base.serial_unverified().unwrap()];
    home.service.revoke(Revocation { name: domain, number: 1, floor: 0, revoked, signer: None });
    assert!(!home.service.renew_due(nanos(NOW + 1_700_000)));
}

#[test]
fn a_member_with_a_new_membership_outlives_the_retirement_of_the_first_key() {
    let mut home = Domain::new();
    let (token, other) = (home.invite("robot7", vec![], all()), home.invite("robot8", vec![], vec![]));
    let (robot, late) = (home.machine(&token), home.machine(&other));
    home.join(&robot);
    home.join(&late);
    let domain = home.identity.name();
    let row = home.service.rows(NOW).into_iter().find(|row| row.entity == robot.entity).unwrap();
    assert_eq!((row.role.as_str(), row.signer), ("robot", Some(home.identity.key().verify_key())));

    let serial = NANOS + 100;
    let (not_before, not_after) = (NOW - 60, NOW + 1_000_000);
    let claims = MemberCert { domain, entity: robot.entity, role: row.role, serial, not_before, not_after };
    let membership = Membership::issue(&home.identity, &claims).unwrap();
    assert!(!home.service.readmit(membership.clone()), "its enrollment comes first");
    let enrollment = Enrollment { member: serial, serial, ..row.enrollment };
    home.service.enroll(issue(home.identity.key(), &enrollment).unwrap());
    assert!(home.service.readmit(membership.clone()) && !home.service.readmit(membership.clone()));
    let stranger = MemberCert { entity: domain, ..claims };
    assert!(!home.service.readmit(Membership::issue(&home.identity, &stranger).unwrap()));
    let directory = home.service.directory(NANOS);
    assert_eq!(directory.membership_of(robot.entity, domain, NOW), Some(&membership));
    assert_eq!(directory.membership_of(domain, domain, NOW), None);

    // As if the domain's first key had signed the others only.
    let revoked = vec![other.invite().unwrap().serial];
    assert!(home.service.revoke(Revocation { name: domain, number: 1, floor: 0, revoked, signer: None }));
    assert_eq!(home.service.rows(NOW).len(), 1);
}

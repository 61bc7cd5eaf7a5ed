//! Who gets a link with whom, and what those who do not are told.

use super::*;
use crate::cert::{CLOCKS_DIFFER, Claims, Invite, issue};
use crate::identity::{Identity, SigningKey};
use crate::link_target::LinkTarget;

const NOW: u64 = 1_800_000_000;
const ISSUED: u64 = NOW * 1_000_000_000;

#[test]
fn members_of_a_domain_take_links_with_each_other() {
    let home = Domain::new(1);
    let (switch, other, robot) = (home.member(11, "switch"), home.member(12, "rib"), home.member(13, "arm"));
    let trust = switch.trust(true);
    let met = trust.admit(Role::Switch, &other.as_switch(), other.shows(), NOW).unwrap();
    assert_eq!(met, Admission { relationship: Relationship::Member { role: "rib".into() }, until: NOW + 60 });
    let met = trust.admit(Role::Switch, &robot.as_endpoint(), robot.shows(), NOW).unwrap();
    assert_eq!(met.relationship, Relationship::Member { role: "arm".into() });
    let met = robot.trust(false).admit(Role::Endpoint, &switch.as_switch(), switch.shows(), NOW).unwrap();
    assert_eq!(met.relationship, Relationship::Member { role: "switch".into() });

    let refused = trust.admit(Role::Switch, &robot.as_switch(), robot.shows(), NOW).unwrap_err();
    assert!(refused.to_string().contains("is arm in domain"), "{refused}");
    // The membership of another, which a stranger got hold of.
    let thief = home.member(14, "switch");
    let refused = trust.admit(Role::Switch, &thief.as_switch(), other.shows(), NOW).unwrap_err();
    assert!(refused.to_string().contains("wrong entity"), "{refused}");
}

#[test]
fn strangers_are_taken_as_endpoints_unless_the_domain_is_for_members() {
    let home = Domain::new(1);
    let (switch, stranger) = (home.member(11, "switch"), Domain::new(9).member(12, "switch"));
    let met = switch.trust(false).admit(Role::Switch, &stranger.as_endpoint(), None, NOW);
    assert_eq!(met, Ok(Admission::STRANGER));
    for (trust, own, peer) in [
        (switch.trust(true), Role::Switch, stranger.as_endpoint()),
        (switch.trust(false), Role::Switch, stranger.as_switch()),
        (home.member(13, "arm").trust(false), Role::Endpoint, stranger.as_switch()),
    ] {
        let refused = trust.admit(own, &peer, None, NOW).unwrap_err();
        assert!(refused.to_string().contains("shows no membership"), "{refused}");
    }
}

#[test]
fn what_has_ended_or_was_taken_back_is_refused_by_serial_and_remedy() {
    let home = Domain::new(1);
    let (switch, other) = (home.member(11, "switch"), home.member(12, "switch"));
    let mut trust = switch.trust(true);
    let meet = |trust: &Trust, now| trust.admit(Role::Switch, &other.as_switch(), other.shows(), now);
    assert!(meet(&trust, NOW + 60).is_ok());
    for (now, why) in [(NOW + 61, "expired "), (NOW - 61 - CLOCKS_DIFFER, "not yet valid")] {
        let refused = meet(&trust, now).unwrap_err().to_string();
        assert!(refused.contains(why) && refused.contains(&format!("serial {}", ISSUED + 11)), "{refused}");
    }
    // Its own, first of all.
    assert!(meet(&trust, NOW + 61).unwrap_err().to_string().contains(&format!("{:#}", switch.identity.name())));

    assert_eq!(trust.take_revocation(&home.proof(), &home.revoke(1, 0, vec![ISSUED + 12])), Ok(true));
    assert_eq!(trust.take_revocation(&home.proof(), &home.revoke(1, 0, vec![ISSUED + 12])), Ok(false), "no news");
    let refused = meet(&trust, NOW).unwrap_err().to_string();
    let serial = ISSUED + 12;
    assert!(refused.contains(&format!("the MemberCert with serial {serial}")), "{refused}");
    assert!(refused.contains("revocation 1") && refused.contains("floor 0"), "{refused}");
    assert!(refused.contains("have a new one issued"), "{refused}");
    let older = trust.take_revocation(&home.proof(), &home.revoke(0, 0, vec![])).unwrap_err();
    assert!(matches!(older, CertError::RolledBack { got: 0, known: 1 }), "{older}");
    assert_eq!(trust.take_revocation(&home.proof(), &home.revoke(2, ISSUED + 100, vec![])), Ok(true));
    assert!(meet(&trust, NOW).unwrap_err().to_string().contains(&format!("floor {}", ISSUED + 100)));
    // Only the domain itself says so, and only of itself.
    let foreign = Domain::new(2);
    assert!(trust.take_revocation(&home.proof(), &foreign.revoke(3, 0, vec![])).is_err());
    assert_eq!(trust.take_revocation(&foreign.proof(), &foreign.revoke(1, 0, vec![])), Ok(false), "not known here");
    assert_eq!(trust.revocations().count(), 1);
}

#[test]
fn domains_peer_when_each_has_said_so() {
    let (home, away) = (Domain::new(1), Domain::new(2));
    let both = |ours: &str, theirs: &str| {
        let mut here = home.member(11, "border");
        let mut there = away.member(12, "border");
        here.papers.peers.extend((!ours.is_empty()).then(|| home.peer(&away, ours, 5)));
        there.papers.peers.extend((!theirs.is_empty()).then(|| away.peer(&home, theirs, 6)));
        (here, there)
    };
    let meet = |(here, there): &(Member, Member)| {
        let at_home = here.trust(true).admit(Role::Switch, &there.as_switch(), there.shows(), NOW);
        let abroad = there.trust(true).admit(Role::Switch, &here.as_switch(), here.shows(), NOW);
        (at_home, abroad)
    };
    let (at_home, abroad) = meet(&both("peering,transit", "peering"));
    let standing = |domain: &Domain, ours: &str, theirs: &str| Relationship::Border {
        domain: domain.identity.name(),
        ours: ours.parse().unwrap(),
        theirs: theirs.parse().unwrap(),
    };
    assert_eq!(at_home.unwrap().relationship, standing(&away, "peering,transit", "peering"));
    assert_eq!(abroad.unwrap().relationship, standing(&home, "peering", "peering,transit"));

    for (ours, theirs, at_home, abroad) in [
        ("", "", "does not know", "does not know"),
        ("peering", "", "has not issued a PeerCert", "does not know"),
        ("", "peering", "does not know", "has not issued a PeerCert"),
        ("visit", "peering", "and peering is needed", "and peering is needed"),
        ("peering", "transit", "and peering is needed", "and peering is needed"),
    ] {
        let refused = meet(&both(ours, theirs));
        let (home_says, away_says) = (refused.0.unwrap_err().to_string(), refused.1.unwrap_err().to_string());
        assert!(home_says.contains(at_home), "{ours:?} {theirs:?}: {home_says}");
        assert!(away_says.contains(abroad), "{ours:?} {theirs:?}: {away_says}");
    }
    // Of several certificates the newest that holds counts.
    let (mut here, there) = both("visit", "peering");
    here.papers.peers.push(home.peer(&away, "peering", 8));
    here.papers.peers.push(home.peer(&away, "transit", 7));
    let refused = meet(&(here, there));
    assert!(refused.0.is_ok() && refused.1.is_ok());
    // Only borders.
    let (here, mut there) = both("peering", "peering");
    there.papers.membership = away.member(12, "switch").papers.membership;
    let refused = meet(&(here, there));
    for refused in [refused.0.unwrap_err(), refused.1.unwrap_err()] {
        assert!(refused.to_string().contains("for border switches"), "{refused}");
    }
    // What a domain has taken back of this is back with its domain.
    let (here, there) = both("peering", "peering");
    let mut trust = here.trust(true);
    trust.take_revocation(&away.proof(), &away.revoke(1, 0, vec![ISSUED + 6])).unwrap();
    let refused = trust.admit(Role::Switch, &there.as_switch(), there.shows(), NOW).unwrap_err().to_string();
    assert!(refused.contains(&format!("the PeerCert with serial {}", ISSUED + 6)), "{refused}");
}

#[test]
fn a_robot_pays_visits_where_both_domains_let_it() {
    let (home, away) = (Domain::new(1), Domain::new(2));
    let (mut robot, mut host) = (home.member(11, "arm"), away.member(12, "switch"));
    let at_host =
        |robot: &Member, host: &Member| host.trust(true).admit(Role::Switch, &robot.as_endpoint(), robot.shows(), NOW);
    let at_robot =
        |robot: &Member, host: &Member| robot.trust(true).admit(Role::Endpoint, &host.as_switch(), host.shows(), NOW);
    assert!(at_host(&robot, &host).unwrap_err().to_string().contains("does not know"));
    assert!(at_robot(&robot, &host).unwrap_err().to_string().contains("does not know"));
    host.papers.peers = vec![away.peer(&home, "peering", 5)];
    assert!(at_host(&robot, &host).unwrap_err().to_string().contains("and visit is needed"));
    host.papers.peers = vec![away.peer(&home, "visit", 5)];
    robot.papers.peers = vec![home.peer(&away, "visit", 6)];
    assert_eq!(at_host(&robot, &host).unwrap().relationship, Relationship::Visitor { domain: home.identity.name() });
    assert_eq!(at_robot(&robot, &host).unwrap().relationship, Relationship::Host { domain: away.identity.name() });
}

#[test]
fn an_invitation_admits_in_its_role_and_time_only() {
    let home = Domain::new(1);
    let newcomer = Identity::new(key(21), "switch");
    let token = home.invite("switch", 7);
    let line = token.to_line();
    assert!(line.starts_with("gdp1") && !line.contains(char::is_whitespace));
    let read = Token::from_line(&format!(" {}\n", *line)).unwrap();
    let (name, at) = (newcomer.name(), "udp://edge.example:31415");
    assert_eq!((read.at().to_string().as_str(), read.switch()), (at, Some(Name::from_bytes([9; 32]))));
    assert_eq!(read.addresses().count(), 1);
    let further: Vec<LinkTarget> = ["tls://edge.example", "wss://edge.example"].map(|to| to.parse().unwrap()).into();
    let read = Token::from_line(&read.also(further.clone()).to_line()).unwrap();
    assert_eq!(read.addresses().skip(1).cloned().collect::<Vec<_>>(), further);
    assert_eq!(read.clone().also(vec![further[0].clone(); 9]).addresses().count(), crate::peer::MAX_LANES);
    let membership = read.admit(name, NOW - 60, ISSUED + 8).unwrap();
    let cert = membership.verify(home.identity.name(), None, NOW).unwrap();
    assert_eq!((cert.entity, cert.role.as_str(), cert.not_after), (name, "switch", NOW + 600));
    assert_eq!(membership.serial_unverified(), Ok(ISSUED + 7), "revoked by the invitation's");
    assert_eq!(Membership::from_pem(&membership.to_pem()), Ok(membership.clone()));

    let member = Member { identity: newcomer, papers: Credentials { membership: membership.clone(), peers: vec![] } };
    let mut trust = home.member(11, "switch").trust(true);
    assert!(trust.admit(Role::Switch, &member.as_switch(), member.shows(), NOW).is_ok());
    trust.take_revocation(&home.proof(), &home.revoke(1, 0, vec![ISSUED + 7])).unwrap();
    let refused = trust.admit(Role::Switch, &member.as_switch(), member.shows(), NOW).unwrap_err().to_string();
    assert!(refused.contains("revoked: the Invite"), "{refused}");

    assert!(matches!(read.admit(name, NOW, (NOW + 61) * 1_000_000_000), Err(CertError::Expired { .. })));
    let forged = |change: &dyn Fn(&mut MemberCert)| {
        let mut claims = membership.cert.claims_unverified().unwrap();
        change(&mut claims);
        let cert = issue(&key(77), &claims).unwrap();
        Membership { cert, ..membership.clone() }.verify(home.identity.name(), None, NOW).unwrap_err()
    };
    assert!(matches!(forged(&|c| c.role = "rib".into()), CertError::WrongRole { .. }));
    assert!(matches!(forged(&|c| c.not_after = NOW + 601), CertError::Malformed(_)));
    assert!(matches!(forged(&|c| c.serial = ISSUED), CertError::BeforeDelegation { .. }));
    assert!(matches!(forged(&|c| c.serial = (NOW + 61) * 1_000_000_000), CertError::Expired { .. }));
    assert!(matches!(forged(&|c| c.domain = name), CertError::WrongDomain { .. }));
    let alone = Membership { invite: None, ..membership.clone() };
    assert!(matches!(alone.verify(home.identity.name(), None, NOW), Err(CertError::WrongKey { .. })));
}

#[test]
fn a_damaged_line_is_refused_without_being_repeated() {
    let line = Domain::new(1).invite("switch", 7).to_line();
    for length in 0..line.len() {
        let error = Token::from_line(&line[..length]).unwrap_err().to_string();
        assert!(length < 12 || !error.contains(&line[4..length]), "{error}");
    }
    for at in (4..line.len()).step_by(7) {
        let mut changed = line.as_bytes().to_vec();
        changed[at] = if changed[at] == b'A' { b'B' } else { b'A' };
        let changed = String::from_utf8(changed).unwrap();
        // Where to dial and the name of the switch there are not signed: they are whoever's who
        // gives the line.
        if let Ok(read) = Token::from_line(&changed) {
            assert!(read.invite().is_ok(), "{at}");
        }
    }
    assert!(matches!(Token::from_line("gdp2abc"), Err(TokenError::NotAToken)));
    assert!(matches!(Token::from_line(&format!("gdp1{}", "A".repeat(10_000))), Err(TokenError::Damaged(_))));
    assert!(!format!("{:?}", Domain::new(1).invite("switch", 7)).contains("4d4d4d"), "no key");
}

#[test]
fn papers_are_bounded_and_an_entitys_own() {
    let (home, away) = (Domain::new(1), Domain::new(2));
    let mut switch = home.member(11, "switch");
    switch.papers.peers = (0..=MAX_PEERS as u64).map(|serial| home.peer(&away, "visit", serial)).collect();
    assert!(Trust::new(switch.identity.name(), Arc::new(switch.papers.clone()), true).is_err());
    switch.papers.peers.truncate(MAX_PEERS);
    Trust::new(switch.identity.name(), Arc::new(switch.papers.clone()), true).unwrap();
    switch.papers.peers = vec![away.peer(&home, "visit", 1)];
    let foreign = Trust::new(switch.identity.name(), Arc::new(switch.papers.clone()), true).unwrap_err();
    assert!(foreign.to_string().contains("wrong key"), "{foreign}");
    let of_other = home.member(12, "switch").papers;
    let error = Trust::new(switch.identity.name(), Arc::new(of_other), true).unwrap_err();
    assert!(error.to_string().contains("wrong entity"), "{error}");
}

/// What is signed, and where it is in an invitation's line. Signatures are random, so they are not
/// part of it.
#[test]
fn vectors_of_domains() {
    let (home, away) = (Domain::new(1), Domain::new(2));
    let (member, token) = (home.member(11, "switch"), home.invite("switch", 7));
    let revocation = home.revoke(1, ISSUED, vec![ISSUED + 12]);
    let computed = serde_json::json!({
        "domain_key": hex::encode(home.identity.key().public()),
        "domain": home.identity.name(),
        "member_cert": signed(&member.papers.membership.cert),
        "invite": signed(token.invite_signed()),
        "peer_cert": signed(&home.peer(&away, "peering,visit", 5)),
        "revocation": signed(&revocation),
        "invited_key": hex::encode([77; 32]),
        "at": token.at().to_string(),
        "switch": token.switch(),
    });
    crate::vectors::check("domain.json", &computed);
}

fn signed<T: Claims>(signed: &Signed<T>) -> serde_json::Value {
    use coset::TaggedCborSerializable;
    let cose = coset::CoseSign1::from_tagged_slice(signed.as_bytes()).unwrap();
    serde_json::json!({
        "claims": signed.claims_unverified().unwrap(),
        "payload": hex::encode(cose.payload.as_ref().unwrap()),
        "to_be_signed": hex::encode(cose.tbs_data(T::CONTEXT.as_bytes())),
    })
}

struct Domain {
    identity: Identity,
}

struct Member {
    identity: Identity,
    papers: Credentials,
}

impl Domain {
    fn new(seed: u8) -> Self {
        Self { identity: Identity::new(key(seed), "domain") }
    }

    fn proof(&self) -> NameProof {
        self.identity.proof()
    }

    /// Its serial ends in `seed`.
    fn member(&self, seed: u8, role: &str) -> Member {
        let identity = Identity::new(key(seed), "member");
        let claims = MemberCert {
            domain: self.identity.name(),
            entity: identity.name(),
            role: role.into(),
            serial: ISSUED + u64::from(seed),
            not_before: NOW - 60,
            not_after: NOW + 60,
        };
        let membership = Membership::issue(&self.identity, &claims).unwrap();
        Member { identity, papers: Credentials { membership, peers: vec![] } }
    }

    fn peer(&self, peer: &Self, rights: &str, serial: u64) -> Signed<PeerCert> {
        let (domain, peer, rights) = (self.identity.name(), peer.identity.name(), rights.parse().unwrap());
        let serial = ISSUED + serial;
        let claims = PeerCert { domain, peer, rights, serial, not_before: NOW - 60, not_after: NOW + 60 };
        issue(self.identity.key(), &claims).unwrap()
    }

    fn revoke(&self, number: u64, floor: u64, revoked: Vec<u64>) -> Signed<Revocation> {
        issue(self.identity.key(), &Revocation { name: self.identity.name(), number, floor, revoked, signer: None })
            .unwrap()
    }

    fn invite(&self, role: &str, serial: u64) -> Token {
        let invited = key(77);
        let claims = Invite {
            domain: self.identity.name(),
            key: invited.verify_key(),
            role: role.into(),
            serial: ISSUED + serial,
            not_before: NOW - 60,
            not_after: NOW + 60,
            member_until: NOW + 600,
        };
        claims.check_bounds().unwrap();
        let invite = issue(self.identity.key(), &claims).unwrap();
        let at = "udp://edge.example:31415".parse::<LinkTarget>().unwrap();
        Token::new(self.proof(), invite, invited, at, Some(Name::from_bytes([9; 32]))).unwrap()
    }
}

impl Member {
    fn shows(&self) -> Option<&Credentials> {
        Some(&self.papers)
    }

    fn trust(&self, members_only: bool) -> Trust {
        Trust::new(self.identity.name(), Arc::new(self.papers.clone()), members_only).unwrap()
    }

    fn as_switch(&self) -> Peer {
        self.peer(Role::Switch)
    }

    fn as_endpoint(&self) -> Peer {
        self.peer(Role::Endpoint)
    }

    fn peer(&self, role: Role) -> Peer {
        let proof = self.identity.proof();
        Peer { name: self.identity.name(), proof, key: proof.verify_key().unwrap(), role, lane: 0 }
    }
}

fn key(seed: u8) -> SigningKey {
    SigningKey::from_secret_bytes(&[seed; 32]).unwrap()
}

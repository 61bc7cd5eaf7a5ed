//! Delegation, roles and revocation: what holds, and what must be refused with the error that says
//! which.

use super::*;
use crate::identity::{Identity, SigningKey};
use crate::name;
use crate::name::{Name, NameProof};

const NOW: u64 = 1_800_000_000;
/// Serials are times of issue in nanoseconds.
const ISSUED: u64 = NOW * 1_000_000_000;

#[test]
fn a_delegate_issues_what_its_delegation_lets_it_for_as_long_as_both_hold() {
    let f = Fixture::new();
    let cert = f.by_delegate(&f.ad_cert(), &Delegation { not_after: NOW + 3, ..f.delegation() });
    let claims = cert.verify(&f.proof, None, NOW).unwrap();
    assert_eq!((claims.not_before, claims.not_after), (NOW - 5, NOW + 3));
    assert_eq!(cert.verify(&f.proof, None, NOW + 3).unwrap().entity, f.robot());
    assert_eq!(cert.verify(&f.proof, None, NOW + 4), Err(CertError::Expired { at: NOW + 3, now: NOW + 4 }));

    let grant = Reading { grant: f.by_delegate(&f.grant(), &f.delegation()), member: None };
    assert_eq!(grant.verify(&f.proof, f.robot(), None, NOW).unwrap().name, f.name);
}

#[test]
fn each_bad_delegation_has_its_error() {
    let f = Fixture::new();
    let other = Name::from_bytes([9; 32]);
    let (cert, delegation) = (f.ad_cert(), f.delegation());
    let refused = |cert: &AdCert, delegation: &Delegation| {
        f.by_delegate(cert, delegation).verify(&f.proof, None, NOW).unwrap_err()
    };
    assert_eq!(
        refused(&cert, &Delegation { name: other, ..delegation.clone() }),
        CertError::WrongName { expected: f.name, got: other },
        "a delegate of another name"
    );
    assert_eq!(
        refused(&AdCert { name: other, ..cert.clone() }, &delegation),
        CertError::WrongName { expected: f.name, got: other }
    );
    let error = refused(&cert, &Delegation { publish: false, ..delegation.clone() });
    assert_eq!(error, CertError::NotDelegated { what: "AdCert", delegate: f.delegate.verify_key().to_string() });
    let without = f.by_delegate(&f.grant(), &Delegation { read: false, ..delegation.clone() });
    let error = without.verify(&f.proof, None, NOW).unwrap_err();
    assert!(matches!(error, CertError::NotDelegated { what: "ReadGrant", .. }), "{error}");
    assert_eq!(
        refused(&cert, &Delegation { not_after: NOW - 1, ..delegation.clone() }),
        CertError::Expired { at: NOW - 1, now: NOW }
    );
    assert_eq!(
        refused(&cert, &Delegation { not_before: NOW + CLOCKS_DIFFER + 1, not_after: u64::MAX, ..delegation.clone() }),
        CertError::NotYetValid { from: NOW + CLOCKS_DIFFER + 1, now: NOW }
    );
    let early = AdCert { serial: delegation.serial - 1, ..cert.clone() };
    assert!(matches!(refused(&early, &delegation), CertError::BeforeDelegation { what: "AdCert", .. }));

    let stranger = SigningKey::from_secret_bytes(&[9; 32]).unwrap();
    let (by_delegate, of_delegate) = (issue(&f.delegate, &cert).unwrap(), issue(&f.owner, &delegation).unwrap());
    for (what, cert, delegation) in [
        ("no delegation", by_delegate.clone(), None),
        ("a stranger's delegation", by_delegate.clone(), Some(issue(&stranger, &delegation).unwrap())),
        ("the delegate's own", by_delegate, Some(issue(&f.delegate, &delegation).unwrap())),
        ("a stranger's certificate", issue(&stranger, &cert).unwrap(), Some(of_delegate.clone())),
        ("the owner's, as the delegate's", issue(&f.owner, &cert).unwrap(), Some(of_delegate)),
    ] {
        let error = Issued { cert, delegation }.verify(&f.proof, None, NOW).unwrap_err();
        assert!(matches!(error, CertError::WrongKey { .. }), "{what}: {error}");
    }
}

/// A delegate cannot make another key a delegate: there is room for one delegation, and the owner
/// must have signed it.
#[test]
fn a_delegation_is_not_passed_on() {
    let f = Fixture::new();
    let second = SigningKey::from_secret_bytes(&[9; 32]).unwrap();
    let passed_on = Delegation { delegate: second.verify_key(), ..f.delegation() };
    let cert = Issued {
        cert: issue(&second, &f.ad_cert()).unwrap(),
        delegation: Some(issue(&f.delegate, &passed_on).unwrap()),
    };
    let error = cert.verify(&f.proof, None, NOW).unwrap_err();
    assert!(matches!(error, CertError::WrongKey { what: "Delegation", .. }), "{error}");
}

#[test]
fn what_is_revoked_or_below_the_floor_does_not_hold() {
    let f = Fixture::new();
    let (cert, grant) = (f.ad_cert(), f.grant());
    let delegation = Delegation { serial: ISSUED - 10, ..f.delegation() };
    let (owners, delegates) = (Issued::from(issue(&f.owner, &cert).unwrap()), f.by_delegate(&cert, &delegation));
    let reading = Reading::from(issue(&f.owner, &grant).unwrap());
    let revocation =
        |floor, revoked: &[u64]| Revocation { name: f.name, number: 4, floor, revoked: revoked.to_vec(), signer: None };
    let revoked = |what, serial, floor| Err(CertError::Revoked { what, serial, floor, number: 4 });

    for (what, revocation, expected) in [
        ("nothing", revocation(0, &[]), None),
        ("others", revocation(ISSUED - 10, &[ISSUED - 1, ISSUED + 1]), None),
        ("its serial", revocation(7, &[3, ISSUED, ISSUED + 1]), Some((ISSUED, 7))),
        ("by the floor", revocation(ISSUED + 1, &[]), Some((ISSUED, ISSUED + 1))),
    ] {
        let result = owners.verify(&f.proof, Some(&revocation), NOW).map(drop);
        assert_eq!(result, expected.map_or(Ok(()), |(serial, floor)| revoked("AdCert", serial, floor)), "{what}");
        let result = reading.verify(&f.proof, f.robot(), Some(&revocation), NOW).map(drop);
        assert_eq!(result, expected.map_or(Ok(()), |(serial, floor)| revoked("ReadGrant", serial, floor)), "{what}");
        assert_eq!(delegates.verify(&f.proof, Some(&revocation), NOW).is_err(), expected.is_some(), "{what}");
    }
    // With a delegation falls what was issued under it, and only that.
    let of_delegation = revocation(0, &[ISSUED - 10]);
    let result = delegates.verify(&f.proof, Some(&of_delegation), NOW).map(drop);
    assert_eq!(result, revoked("Delegation", ISSUED - 10, 0));
    owners.verify(&f.proof, Some(&of_delegation), NOW).unwrap();
    let text = result.unwrap_err().to_string();
    assert!(text.contains("Delegation with serial") && text.contains("revocation 4"), "{text}");
    // It does not come back with the next delegation of the same key.
    let anew = f.by_delegate(&cert, &Delegation { serial: ISSUED + 1, ..delegation });
    let error = anew.verify(&f.proof, Some(&of_delegation), NOW).unwrap_err();
    assert!(matches!(error, CertError::BeforeDelegation { .. }), "{error}");

    let of_other = Revocation { name: Name::from_bytes([9; 32]), ..revocation(0, &[]) };
    assert!(matches!(owners.verify(&f.proof, Some(&of_other), NOW), Err(CertError::WrongName { .. })));
}

#[test]
fn a_revocation_is_only_replaced_by_a_later_one() {
    let f = Fixture::new();
    let held = Revocation { name: f.name, number: 5, floor: 0, revoked: vec![1, 2], signer: None };
    held.check_replaces(None).unwrap();
    held.check_replaces(Some(&held)).unwrap();
    Revocation { number: 6, revoked: vec![], ..held.clone() }.check_replaces(Some(&held)).unwrap();
    for number in [0, 4] {
        let older = Revocation { number, ..held.clone() };
        assert_eq!(older.check_replaces(Some(&held)), Err(CertError::RolledBack { got: number, known: 5 }));
    }
    let another = Revocation { revoked: vec![1], ..held.clone() };
    assert_eq!(another.check_replaces(Some(&held)), Err(CertError::RolledBack { got: 5, known: 5 }));

    for revoked in [vec![2, 1], vec![1, 1], (0..=MAX_REVOKED as u64).collect()] {
        assert!(issue(&f.owner, &Revocation { revoked, ..held.clone() }).is_err());
    }
    let revoked = (u64::MAX - MAX_REVOKED as u64 + 1..=u64::MAX).collect();
    let largest = issue(&f.owner, &Revocation { revoked, ..held }).unwrap();
    assert!(largest.as_bytes().len() < MAX_SIGNED * 3 / 4);
}

#[test]
fn a_grant_to_a_role_reaches_the_domains_members_in_it() {
    let f = Fixture::new();
    let reading = f.role_reading(|_| ());
    assert_eq!(reading.verify(&f.proof, f.robot(), None, NOW).unwrap().not_after, NOW + 5);
    let short = f.role_reading(|member| member.not_after = NOW + 1);
    assert_eq!(short.verify(&f.proof, f.robot(), None, NOW).unwrap().not_after, NOW + 1);
    assert!(matches!(short.verify(&f.proof, f.robot(), None, NOW + 2), Err(CertError::Expired { .. })));
}

#[test]
fn an_invited_member_has_no_role_for_grants() {
    let f = Fixture::new();
    let invited = SigningKey::from_secret_bytes(&[8; 32]).unwrap();
    let MemberCert { domain, role, serial, not_before, not_after, .. } = f.member();
    let invite =
        Invite { domain, key: invited.verify_key(), role, serial, not_before, not_after, member_until: not_after };
    let membership = Membership {
        domain: f.domain.proof(),
        cert: issue(&invited, &f.member()).unwrap(),
        invite: Some(issue(f.domain.key(), &invite).unwrap()),
        renewal: None,
    };
    membership.verify(domain, None, NOW).unwrap();
    let reading = Reading { member: Some(membership.into()), ..f.role_reading(|_| ()) };
    let error = reading.verify(&f.proof, f.robot(), None, NOW).unwrap_err();
    assert!(matches!(error, CertError::ByInvitation { .. }), "{error}");
    assert_eq!(Reading::from_pem(&reading.to_pem()), Ok(reading));
}

#[test]
fn each_way_not_to_have_the_role_has_its_error() {
    let f = Fixture::new();
    let other = Name::from_bytes([9; 32]);
    let refused = |reading: Reading| reading.verify(&f.proof, f.robot(), None, NOW).unwrap_err();
    let (expected, got) = ("operator".to_owned(), "guest".to_owned());
    assert_eq!(refused(f.role_reading(|m| m.role = got.clone())), CertError::WrongRole { expected, got });
    let of_other = CertError::WrongEntity { expected: f.robot(), got: other };
    assert_eq!(refused(f.role_reading(|m| m.entity = other)), of_other);
    let mut reading = f.role_reading(|_| ());
    reading.member = None;
    assert!(matches!(refused(reading), CertError::NotAMember { .. }));

    let foreign = Identity::new(SigningKey::from_secret_bytes(&[9; 32]).unwrap(), "domain");
    let renamed = Identity::new(f.domain.key().clone(), "proxy");
    let claims = |domain| MemberCert { domain, ..f.member() };
    for (what, member) in [
        ("another domain's member", Membership::issue(&foreign, &claims(foreign.name())).unwrap()),
        ("the domain's key by another name", Membership::issue(&renamed, &claims(renamed.name())).unwrap()),
        (
            "a certificate that names another domain",
            Membership {
                domain: f.domain.proof(),
                cert: issue(f.domain.key(), &claims(other)).unwrap(),
                invite: None,
                renewal: None,
            },
        ),
    ] {
        let error = refused(Reading { member: Some(member.into()), ..f.role_reading(|_| ()) });
        assert!(matches!(error, CertError::WrongDomain { .. }), "{what}: {error}");
    }
    let forged = Membership {
        domain: f.domain.proof(),
        cert: issue(foreign.key(), &f.member()).unwrap(),
        invite: None,
        renewal: None,
    };
    let error = refused(Reading { member: Some(forged.into()), ..f.role_reading(|_| ()) });
    assert!(matches!(error, CertError::WrongKey { what: "MemberCert", .. }), "{error}");
    assert!(Membership::issue(&foreign, &f.member()).is_err(), "not its member to name");

    let superfluous = Reading { grant: issue(&f.owner, &f.grant()).unwrap().into(), ..f.role_reading(|_| ()) };
    assert!(matches!(refused(superfluous), CertError::Malformed(_)));
    for role in ["", "Operator", "a b", "ä", &"a".repeat(MAX_ROLE + 1)] {
        let to = Grantee::Role { domain: f.domain.name(), role: role.into() };
        assert!(issue(&f.owner, &ReadGrant { to, ..f.grant() }).is_err(), "{role:?}");
        assert!(issue(f.domain.key(), &MemberCert { role: role.into(), ..f.member() }).is_err(), "{role:?}");
    }
}

#[test]
fn the_names_of_other_entities_are_no_domains() {
    let f = Fixture::new();
    for kind in name::ENTITY_KINDS {
        let entity = Identity::new(f.domain.key().clone(), kind);
        let to = Grantee::Role { domain: entity.name(), role: f.member().role };
        let member = MemberCert { domain: entity.name(), ..f.member() };
        let member = Some(Membership::issue(&entity, &member).unwrap().into());
        let reading = Reading { member, ..issue(&f.owner, &ReadGrant { to, ..f.grant() }).unwrap().into() };
        let refused = reading.verify(&f.proof, f.robot(), None, NOW);
        assert_eq!(refused, Err(CertError::NotADomain { name: entity.name(), kind }));
    }
    let successor = SigningKey::from_secret_bytes(&[7; 32]).unwrap().verify_key();
    let metadata = name::domain_metadata(Some(&successor));
    let card = crate::card::NameCard::new(f.domain.key().verify_key(), metadata).unwrap();
    let domain = Identity::of_domain(f.domain.key().clone(), &card).unwrap();
    let member = Membership::issue(&domain, &MemberCert { domain: domain.name(), ..f.member() }).unwrap();
    member.verify(domain.name(), None, NOW).unwrap();
    let topic = crate::card::NameCard::create(f.domain.key().verify_key(), "topic", "/a", "b/msg/C", None).unwrap();
    assert!(Identity::of_domain(f.domain.key().clone(), &topic).is_none(), "its key signs for no domain");
}

#[test]
fn a_chain_survives_its_file_and_its_message() {
    let f = Fixture::new();
    let mut reading = f.role_reading(|_| ());
    reading.grant = f.by_delegate(&reading.grant.cert.claims_unverified().unwrap(), &f.delegation());
    reading.verify(&f.proof, f.robot(), None, NOW).unwrap();
    let text = reading.to_pem();
    assert_eq!(text.matches("-----BEGIN GDP ").count(), 4, "{text}");
    assert_eq!(Reading::from_pem(&text), Ok(reading.clone()));
    let bytes = crate::cbor::encode(&reading).unwrap();
    assert_eq!(crate::cbor::decode::<Reading>(&bytes, 1 << 16), Ok(reading.clone()));
    // The member's part comes from the domain, in a file of its own.
    let member = *reading.member.clone().unwrap();
    assert_eq!(Membership::from_pem(&member.to_pem()), Ok(member.clone()));
    assert_eq!(Reading::from_pem(&format!("{}\n{}", reading.grant.to_pem(), member.to_pem())), Ok(reading.clone()));

    let grant = reading.grant.to_pem();
    for (what, text) in [
        ("the member first", member.to_pem() + &grant),
        ("the member twice", format!("{grant}{}{}", member.to_pem(), member.to_pem())),
        ("two grants", format!("{grant}{grant}")),
        ("no proof of the domain", grant.clone() + &member.cert.to_pem()),
        ("words between", grant.replacen("-----\n-----", "-----\nwords\n-----", 1)),
        ("words behind", format!("{grant}words")),
        ("no end", grant[..grant.len() - 10].to_owned()),
        ("an AdCert", f.by_delegate(&f.ad_cert(), &f.delegation()).to_pem()),
        ("nothing", String::new()),
        ("too much", " ".repeat(MAX_CERT_FILE + 1)),
    ] {
        assert!(Reading::from_pem(&text).is_err(), "{what}");
    }
    assert!(Issued::<ReadGrant>::from_pem(&text).is_err(), "a member's certificate is no part of an owner's");
}

/// A floor covers what was issued until it was signed. A serial of the far future would survive it,
/// and every delegation that the owner takes back.
#[test]
fn a_serial_of_the_far_future_never_holds() {
    let f = Fixture::new();
    let all = Revocation { name: f.name, number: 1, floor: ISSUED + 1, revoked: vec![], signer: None };
    let again = Delegation { serial: ISSUED + 1, ..f.delegation() };
    for serial in [last_serial(NOW) + 1, u64::MAX] {
        let later = |what| CertError::IssuedLater { what, serial, now: NOW };
        let cert = AdCert { serial, ..f.ad_cert() };
        let by_owner = Issued::from(issue(&f.owner, &cert).unwrap());
        assert_eq!(by_owner.verify(&f.proof, None, NOW), Err(later("AdCert")));
        assert_eq!(by_owner.verify(&f.proof, Some(&all), NOW), Err(later("AdCert")));
        assert_eq!(f.by_delegate(&cert, &again).verify(&f.proof, Some(&all), NOW), Err(later("AdCert")));
        let ahead = Delegation { serial, ..f.delegation() };
        assert_eq!(f.by_delegate(&cert, &ahead).verify(&f.proof, None, NOW), Err(later("Delegation")));
        let grant = issue(&f.owner, &ReadGrant { serial, ..f.grant() }).unwrap();
        assert_eq!(grant.verify(&f.owner.verify_key(), NOW), Err(later("ReadGrant")));

        let member = Membership::issue(&f.domain, &MemberCert { serial, ..f.member() }).unwrap();
        assert_eq!(member.verify(f.domain.name(), None, NOW), Err(later("MemberCert")));
        let (domain, peer, rights) = (f.domain.name(), f.robot(), PeerRights::default());
        let peer = PeerCert { domain, peer, rights, serial, not_before: NOW, not_after: NOW };
        let peer = issue(f.domain.key(), &peer).unwrap();
        assert_eq!(peer.verify_peer(&f.domain.proof(), None, NOW), Err(later("PeerCert")));
    }
    let last = Issued::from(issue(&f.owner, &AdCert { serial: last_serial(NOW), ..f.ad_cert() }).unwrap());
    last.verify(&f.proof, Some(&all), NOW).unwrap();
}

struct Fixture {
    owner: SigningKey,
    delegate: SigningKey,
    domain: Identity,
    robot: Identity,
    proof: NameProof,
    name: Name,
}

impl Fixture {
    fn new() -> Self {
        let owner = SigningKey::from_secret_bytes(&[1; 32]).unwrap();
        let proof = NameProof { owner_key: owner.public(), digest: name::inner_digest(&Default::default()) };
        Self {
            name: proof.name().unwrap(),
            owner,
            proof,
            delegate: SigningKey::from_secret_bytes(&[2; 32]).unwrap(),
            domain: Identity::new(SigningKey::from_secret_bytes(&[3; 32]).unwrap(), "domain"),
            robot: Identity::new(SigningKey::from_secret_bytes(&[4; 32]).unwrap(), "proxy"),
        }
    }

    fn robot(&self) -> Name {
        self.robot.name()
    }

    fn ad_cert(&self) -> AdCert {
        AdCert {
            name: self.name,
            entity: self.robot(),
            scope: vec![],
            serial: ISSUED,
            not_before: NOW - 5,
            not_after: NOW + 5,
        }
    }

    fn grant(&self) -> ReadGrant {
        let to = Grantee::Entity(self.robot());
        ReadGrant { name: self.name, to, serial: ISSUED, not_before: NOW - 5, not_after: NOW + 5 }
    }

    fn delegation(&self) -> Delegation {
        Delegation {
            name: self.name,
            delegate: self.delegate.verify_key(),
            publish: true,
            read: true,
            serial: ISSUED,
            not_before: NOW - 60,
            not_after: NOW + 60,
        }
    }

    fn member(&self) -> MemberCert {
        MemberCert {
            domain: self.domain.name(),
            entity: self.robot(),
            role: "operator".into(),
            serial: ISSUED,
            not_before: NOW - 60,
            not_after: NOW + 60,
        }
    }

    fn by_delegate<T: Claims>(&self, claims: &T, delegation: &Delegation) -> Issued<T> {
        Issued {
            cert: issue(&self.delegate, claims).unwrap(),
            delegation: Some(issue(&self.owner, delegation).unwrap()),
        }
    }

    /// A grant to the domain's operators, and the robot's certificate of being one.
    fn role_reading(&self, change: impl FnOnce(&mut MemberCert)) -> Reading {
        let mut member = self.member();
        change(&mut member);
        let to = Grantee::Role { domain: self.domain.name(), role: "operator".into() };
        let grant = issue(&self.owner, &ReadGrant { to, ..self.grant() }).unwrap();
        Reading { member: Some(Membership::issue(&self.domain, &member).unwrap().into()), ..grant.into() }
    }
}

//! Of which domain a switch is: believed only if the domain and the switch both say so.

use super::domain::roles;
use super::{
    CertError, Host, Invite, Locator, MAX_ADDRESSES, MAX_LOCATED, MAX_LOCATOR, MemberCert, Membership, Revocation,
    SwitchStatement, issue,
};
use super::{MembershipRenewal, RenewalDelegation};
use crate::cbor;
use crate::identity::{Identity, SigningKey};
use crate::name::Name;

const NOW: u64 = 150;

#[test]
fn a_switch_is_of_a_domain_only_if_all_of_it_fits() {
    let (domain, switch, other) = (identity(1, "domain"), identity(2, "switch"), identity(3, "switch"));
    let claims = statement(&domain, &switch);
    for role in [roles::SWITCH, roles::RIB, roles::BORDER] {
        let right = host(&domain, &switch, role);
        let (member, verified) = right.verify(domain.name(), None, NOW).unwrap();
        assert_eq!((member.role.as_str(), verified), (role, SwitchStatement { not_after: 200, ..claims.clone() }));
        let bytes = cbor::encode(&right).unwrap();
        assert_eq!(cbor::decode::<Host>(&bytes, bytes.len()).unwrap(), right);
    }
    let right = host(&domain, &switch, roles::SWITCH);
    let revoked = Revocation { name: domain.name(), number: 1, floor: 8, revoked: vec![], signer: None };
    assert!(matches!(right.verify(domain.name(), Some(&revoked), NOW), Err(CertError::Revoked { .. })));
    assert!(matches!(right.verify(domain.name(), None, 201), Err(CertError::Expired { .. })));
    assert!(matches!(right.verify(other.name(), None, NOW), Err(CertError::WrongDomain { .. })));

    let states = |key: &Identity, claims: SwitchStatement| issue(key.key(), &claims).unwrap();
    let brief =
        Host { statement: states(&switch, SwitchStatement { not_after: 160, ..claims.clone() }), ..right.clone() };
    assert_eq!(brief.verify(domain.name(), None, 160).unwrap().1.not_after, 160);
    assert!(matches!(brief.verify(domain.name(), None, 161), Err(CertError::Expired { .. })));

    let with = |change: &dyn Fn(&mut Host)| {
        let mut host = right.clone();
        change(&mut host);
        host.verify(domain.name(), None, NOW).unwrap_err()
    };
    for (what, error, expected) in [
        ("no switch", with(&|h| h.membership = member(&domain, &switch, "robot")), "wrong role"),
        ("another's membership", with(&|h| h.membership = member(&domain, &other, roles::SWITCH)), "wrong entity"),
        ("another's key", with(&|h| h.proof = other.proof()), "wrong entity"),
        ("another's signature", with(&|h| h.statement = states(&other, claims.clone())), "wrong key"),
        ("the domain's signature", with(&|h| h.statement = states(&domain, claims.clone())), "wrong key"),
        (
            "of another switch",
            with(&|h| h.statement = states(&switch, SwitchStatement { switch: other.name(), ..claims.clone() })),
            "wrong switch",
        ),
        (
            "of another domain",
            with(&|h| h.statement = states(&switch, SwitchStatement { domain: other.name(), ..claims.clone() })),
            "wrong domain",
        ),
    ] {
        assert!(error.to_string().contains(expected), "{what}: {error}");
    }
    let crowded = SwitchStatement { addresses: vec!["[2001:db8::1]:9".parse().unwrap(); MAX_ADDRESSES + 1], ..claims };
    assert!(issue(switch.key(), &crowded).is_err());
}

#[test]
fn what_is_stated_again_is_the_same_and_anything_else_is_not() {
    let (domain, switch) = (identity(1, "domain"), identity(2, "switch"));
    let held = host(&domain, &switch, roles::BORDER);
    let claims = statement(&domain, &switch);
    let with = |claims: SwitchStatement| Host { statement: issue(switch.key(), &claims).unwrap(), ..held.clone() };
    assert!(held.says_the_same(&held) && held.says_the_same(&with(SwitchStatement { serial: 2, ..claims.clone() })));
    for (what, other) in [
        ("addresses", with(SwitchStatement { addresses: vec![], ..claims.clone() })),
        ("an end", with(SwitchStatement { not_after: 501, ..claims })),
        ("a membership", Host { membership: member(&domain, &switch, roles::RIB), ..held.clone() }),
    ] {
        assert!(!held.says_the_same(&other), "{what}");
    }
}

#[test]
fn a_domain_cannot_claim_the_switch_of_another() {
    let (domain, thief, switch) = (identity(1, "domain"), identity(4, "domain"), identity(2, "switch"));
    let right = host(&domain, &switch, roles::SWITCH);
    let claimed = Host { membership: member(&thief, &switch, roles::SWITCH), ..right.clone() };
    assert!(matches!(claimed.verify(thief.name(), None, NOW), Err(CertError::WrongDomain { .. })));
    let said = issue(thief.key(), &statement(&thief, &switch)).unwrap();
    let forged = Host { statement: said, ..claimed };
    assert!(matches!(forged.verify(thief.name(), None, NOW), Err(CertError::WrongKey { .. })));
    right.verify(domain.name(), None, NOW).unwrap();
}

#[test]
fn a_locator_is_of_borders_and_bounded() {
    let (domain, switch) = (identity(1, "domain"), identity(2, "switch"));
    let (border, no_border) = (host(&domain, &switch, roles::BORDER), host(&domain, &switch, roles::RIB));
    let verify = |borders: Vec<Host>| Locator { borders }.verify(domain.name(), None, NOW);
    let whole = verify(vec![border.clone(); MAX_LOCATED]).unwrap();
    assert_eq!(whole, vec![Ok(SwitchStatement { not_after: 200, ..statement(&domain, &switch) }); MAX_LOCATED]);
    let mixed = verify(vec![no_border, border.clone()]).unwrap();
    assert!(matches!(mixed[..], [Err(CertError::WrongRole { .. }), Ok(_)]), "each stands for itself: {mixed:?}");
    assert!(matches!(verify(vec![border.clone(); MAX_LOCATED + 1]), Err(CertError::Malformed(_))));

    // The largest that there can be.
    let key = SigningKey::from_secret_bytes(&[9; 32]).unwrap();
    let (invite_key, role, serial) = (key.verify_key(), roles::BORDER.to_owned(), u64::MAX);
    let (not_before, not_after, member_until) = (u64::MAX, u64::MAX, u64::MAX);
    let invite = Invite {
        domain: domain.name(),
        key: invite_key,
        role: role.clone(),
        serial,
        not_before,
        not_after,
        member_until,
    };
    let cert = MemberCert { domain: domain.name(), entity: switch.name(), role, serial, not_before, not_after };
    let addresses = vec!["[ffff:ffff:ffff:ffff:ffff:ffff:ffff:ffff]:65535".parse().unwrap(); MAX_ADDRESSES];
    let claims = SwitchStatement { addresses, serial, not_after, ..statement(&domain, &switch) };
    let terms = RenewalDelegation {
        domain: domain.name(),
        member: serial,
        key: key.verify_key(),
        lifetime: 60,
        serial,
        not_before,
        not_after,
    };
    let delegation = issue(domain.key(), &terms).unwrap();
    let membership = Membership {
        domain: domain.proof(),
        cert: issue(&key, &cert).unwrap(),
        invite: Some(issue(domain.key(), &invite).unwrap()),
        renewal: Some(MembershipRenewal { delegation, cert: issue(&key, &cert).unwrap() }),
    };
    let largest = Host { statement: issue(switch.key(), &claims).unwrap(), membership, ..border };
    let size = Locator { borders: vec![largest; MAX_LOCATED] }.size();
    assert!(size <= MAX_LOCATOR, "{size} bytes");
}

fn statement(domain: &Identity, switch: &Identity) -> SwitchStatement {
    let addresses = vec!["192.0.2.1:31415".parse().unwrap(), "[2001:db8::1]:31415".parse().unwrap()];
    SwitchStatement { switch: switch.name(), domain: domain.name(), addresses, serial: 1, not_after: 500 }
}

fn member(domain: &Identity, entity: &Identity, role: &str) -> Membership {
    let (domain_name, entity): (Name, Name) = (domain.name(), entity.name());
    let cert =
        MemberCert { domain: domain_name, entity, role: role.into(), serial: 7, not_before: 100, not_after: 200 };
    Membership::issue(domain, &cert).unwrap()
}

fn host(domain: &Identity, switch: &Identity, role: &str) -> Host {
    let statement = issue(switch.key(), &statement(domain, switch)).unwrap();
    Host { proof: switch.proof(), statement, membership: member(domain, switch, role) }
}

fn identity(seed: u8, kind: &str) -> Identity {
    Identity::new(SigningKey::from_secret_bytes(&[seed; 32]).unwrap(), kind)
}

//! Labels, bounds, and to whom an enrollment belongs, also after the domain's key was replaced.

use super::*;
use crate::card::NameCard;
use crate::cert::{MemberCert, Revocation, issue};
use crate::identity::{Identity, SigningKey};
use crate::name::domain_metadata;

const NOW: u64 = 1_800_000_000;

fn domain(seed: u8) -> Identity {
    Identity::new(SigningKey::from_secret_bytes(&[seed; 32]).unwrap(), "domain")
}

fn sample(domain: &Identity, member: u64) -> Enrollment {
    Enrollment {
        domain: domain.name(),
        member,
        label: "robot7".into(),
        expose: vec!["/camera/**".into()],
        import: vec![TopicsOf { member: "server".into(), topics: vec!["/cmd_vel".into()] }],
        read: vec![],
        join_service: domain.key().verify_key(),
        serial: 7,
        not_before: NOW - 60,
        not_after: NOW + 60,
    }
}

fn member(domain: &Identity, serial: u64) -> Membership {
    let (name, entity) = (domain.name(), Identity::generate("proxy").unwrap().name());
    let role = "robot".to_owned();
    let claims = MemberCert { domain: name, entity, role, serial, not_before: NOW - 60, not_after: NOW + 60 };
    Membership::issue(domain, &claims).unwrap()
}

#[test]
fn a_label_is_a_segment_of_a_ros_name() {
    for good in ["a", "robot7", "arm_left"] {
        check_label(good).unwrap();
    }
    for bad in ["", "7robot", "Robot", "alice-laptop", "a/b", "*", "_x", &"a".repeat(33)] {
        assert!(check_label(bad).unwrap_err().to_string().contains("namespace"), "{bad}");
    }
}

#[test]
fn an_enrollment_holds_for_its_member_in_its_domain_while_it_is_valid() {
    let (home, other) = (domain(1), domain(2));
    let membership = member(&home, 5);
    let signed = issue(home.key(), &sample(&home, 5)).unwrap();
    let (entity, claims) = signed.verify_for(home.name(), &membership, NOW).unwrap();
    assert_eq!((entity, claims.label.as_str()), (membership.cert.claims_unverified().unwrap().entity, "robot7"));

    let another = signed.verify_for(home.name(), &member(&home, 6), NOW).unwrap_err();
    assert!(another.to_string().contains("another member"), "{another}");
    assert!(signed.verify_for(other.name(), &membership, NOW).is_err());
    assert!(signed.verify_for(home.name(), &membership, NOW + 61).is_err());
    let forged = issue(other.key(), &sample(&home, 5)).unwrap();
    assert!(forged.verify_for(home.name(), &membership, NOW).is_err());
}

#[test]
fn lists_and_patterns_are_bounded() {
    let home = domain(1);
    let base = sample(&home, 5);
    let many = vec!["/a".to_owned(); MAX_PATTERNS + 1];
    let rules = vec![TopicsOf { member: ALL_MEMBERS.into(), topics: vec![] }; MAX_PATTERNS + 1];
    for claims in [
        Enrollment { expose: many.clone(), ..base.clone() },
        Enrollment { read: vec![TopicsOf { member: ALL_MEMBERS.into(), topics: many }], ..base.clone() },
        Enrollment { read: rules, ..base.clone() },
        Enrollment { expose: vec!["/".repeat(300)], ..base.clone() },
        Enrollment { import: vec![TopicsOf { member: "A".into(), topics: vec![] }], ..base },
    ] {
        assert!(issue(home.key(), &claims).is_err(), "{claims:?}");
    }
}

#[test]
fn a_retired_key_signs_nothing_that_holds() {
    let (first, second, other) = (key(1), key(2), key(3));
    let card = NameCard::new(first.verify_key(), domain_metadata(Some(&second.verify_key()))).unwrap();
    let (name, proof) = (card.name(), card.proof());
    let by = |signer: &SigningKey| Identity::of_domain(signer.clone(), &card).unwrap();
    assert!(Identity::of_domain(other.clone(), &card).is_none());
    let entity = Identity::new(key(4), "proxy").name();
    let member = |signer: &SigningKey, serial| {
        let role = "robot".to_owned();
        let claims = MemberCert { domain: name, entity, role, serial, not_before: NOW - 60, not_after: NOW + 60 };
        Membership::issue(&by(signer), &claims).unwrap()
    };
    let (old, new) = (member(&first, 5), member(&second, 6));
    for membership in [&old, &new] {
        membership.verify(name, None, NOW).unwrap();
    }
    let forged = Membership { cert: issue(&other, &new.cert.claims_unverified().unwrap()).unwrap(), ..new.clone() };
    assert!(matches!(forged.verify(name, None, NOW), Err(CertError::WrongKey { .. })));

    let signer = Some(second.verify_key());
    let retired = Revocation { name, number: 1, floor: 0, revoked: vec![], signer };
    new.verify(name, Some(&retired), NOW).unwrap();
    assert!(matches!(old.verify(name, Some(&retired), NOW), Err(CertError::Retired { .. })));

    // Neither a revocation by the first key nor one that leaves the signer out replaces it.
    let verify = |signer: &SigningKey, claims: &Revocation| issue(signer, claims).unwrap().verify_revocation(&proof);
    assert_eq!(verify(&second, &retired), Ok(retired.clone()));
    let later = Revocation { number: 9, ..retired.clone() };
    assert!(matches!(verify(&first, &later), Err(CertError::Retired { .. })));
    let without = Revocation { signer: None, ..later.clone() };
    assert!(matches!(without.check_replaces(Some(&retired)), Err(CertError::Retired { .. })));
    later.check_replaces(Some(&retired)).unwrap();

    // The first key retires nobody, and a high number of its revocations prevents nothing.
    let reversed = Revocation { signer: Some(first.verify_key()), ..later.clone() };
    assert!(verify(&first, &reversed).unwrap_err().to_string().contains("only a successor"));
    let highest = Revocation { number: u64::MAX, ..without };
    highest.check_replaces(None).unwrap();
    retired.check_replaces(Some(&highest)).unwrap();

    // Nor does an enrollment by the first key widen what a later membership shares.
    let enrollment = |signer: &SigningKey, member| {
        issue(signer, &Enrollment { domain: name, ..sample(&by(signer), member) }).unwrap()
    };
    enrollment(&first, 5).verify_for(name, &old, NOW).unwrap();
    enrollment(&second, 5).verify_for(name, &old, NOW).unwrap();
    enrollment(&second, 6).verify_for(name, &new, NOW).unwrap();
    assert!(matches!(enrollment(&first, 6).verify_for(name, &new, NOW), Err(CertError::Retired { .. })));
}

fn key(seed: u8) -> SigningKey {
    SigningKey::from_secret_bytes(&[seed; 32]).unwrap()
}

//! A renewal extends one membership, within what the domain stated, and admits nobody.

use super::*;
use crate::cert::{Invite, Membership, Revocation, issue};
use crate::identity::{Identity, SigningKey};

const NOW: u64 = 1_800_000_000;
const NANOS: u64 = 1_000_000_000;
const DAY: u64 = 86400;

struct Fixture {
    domain: Identity,
    renewer: SigningKey,
    entity: Name,
    base: Membership,
}

fn key(seed: u8) -> SigningKey {
    SigningKey::from_secret_bytes(&[seed; 32]).unwrap()
}

impl Fixture {
    fn new() -> Self {
        let domain = Identity::new(key(1), "domain");
        let entity = Identity::new(key(3), "proxy").name();
        let base = Membership::issue(&domain, &claims(&domain, entity, NOW)).unwrap();
        Self { renewer: key(2), entity, base, domain }
    }

    fn delegation(&self, change: impl FnOnce(&mut RenewalDelegation)) -> Signed<RenewalDelegation> {
        let mut claims = RenewalDelegation {
            domain: self.domain.name(),
            member: NOW * NANOS,
            key: self.renewer.verify_key(),
            lifetime: 60 * DAY,
            serial: NOW * NANOS,
            not_before: NOW - 60,
            not_after: NOW + 365 * DAY,
        };
        change(&mut claims);
        issue(self.domain.key(), &claims).unwrap()
    }

    fn renewed(&self, at: u64) -> Membership {
        self.base.renew(&self.renewer, &self.delegation(|_| ()), at * NANOS).unwrap()
    }

    fn refused(&self, membership: &Membership) -> String {
        membership.verify_signatures(self.domain.name()).unwrap_err().to_string()
    }
}

fn claims(domain: &Identity, entity: Name, at: u64) -> MemberCert {
    let (role, serial) = ("robot".to_owned(), at * NANOS);
    MemberCert { domain: domain.name(), entity, role, serial, not_before: at - 60, not_after: at + 60 * DAY }
}

#[test]
fn a_membership_is_extended_until_its_delegation_ends() {
    let f = Fixture::new();
    let domain = f.domain.name();
    assert!(!f.base.is_half_over(NOW + 29 * DAY).unwrap() && f.base.is_half_over(NOW + 30 * DAY).unwrap());
    let renewed = f.renewed(NOW + 31 * DAY);
    assert!(f.base.verify(domain, None, NOW + 61 * DAY).is_err());
    let cert = renewed.verify(domain, None, NOW + 61 * DAY).unwrap();
    assert_eq!((cert.entity, cert.not_after, cert.serial), (f.entity, NOW + 91 * DAY, NOW * NANOS));
    assert!(renewed.verify(domain, None, NOW + 92 * DAY).is_err());
    assert!(!renewed.is_half_over(NOW + 60 * DAY).unwrap() && renewed.is_half_over(NOW + 62 * DAY).unwrap());

    let again = renewed.renew(&f.renewer, &f.delegation(|_| ()), (NOW + 350 * DAY) * NANOS).unwrap();
    assert_eq!(again.verify(domain, None, NOW + 351 * DAY).unwrap().not_after, NOW + 365 * DAY);
    assert!(again.renew(&f.renewer, &f.delegation(|_| ()), (NOW + 366 * DAY) * NANOS).is_err());
    assert_eq!(Membership::from_pem(&again.to_pem()), Ok(again));
}

#[test]
fn an_invited_member_is_renewed_under_the_serial_of_its_invitation() {
    let f = Fixture::new();
    let (invited, serial) = (key(7), NOW * NANOS);
    let invite = Invite {
        domain: f.domain.name(),
        key: invited.verify_key(),
        role: "robot".into(),
        serial,
        not_before: NOW,
        not_after: NOW + DAY,
        member_until: NOW + 60 * DAY,
    };
    let cert = issue(&invited, &claims(&f.domain, f.entity, NOW)).unwrap();
    let invite = Some(issue(f.domain.key(), &invite).unwrap());
    let base = Membership { domain: f.domain.proof(), cert, invite, renewal: None };
    let renewed = base.renew(&f.renewer, &f.delegation(|_| ()), (NOW + 50 * DAY) * NANOS).unwrap();
    assert_eq!(renewed.serial_unverified(), Ok(serial));
    assert!(renewed.verify(f.domain.name(), None, NOW + 100 * DAY).is_ok());
}

#[test]
fn the_key_of_a_delegation_renews_its_member_alone() {
    let f = Fixture::new();
    let renewed = f.renewed(NOW);
    let with = |renewal: MembershipRenewal| Membership { renewal: Some(renewal), ..f.base.clone() };
    let renewal = renewed.renewal.clone().unwrap();

    let another = Membership { renewal: None, ..Fixture { entity: f.domain.name(), ..Fixture::new() }.base };
    assert!(another.renew(&f.renewer, &f.delegation(|terms| terms.member = 1), NOW * NANOS).is_err());

    // The delegate cannot admit: its certificate alone is no membership.
    let cert = renewal.cert.clone();
    assert!(f.refused(&Membership { cert, renewal: None, ..f.base.clone() }).contains("wrong key"));

    let sign = |signer: &SigningKey, change: fn(&mut MemberCert)| {
        let mut claims = claims(&f.domain, f.entity, NOW + 1);
        change(&mut claims);
        with(MembershipRenewal { cert: issue(signer, &claims).unwrap(), ..renewal.clone() })
    };
    assert!(sign(&f.renewer, |_| ()).verify_signatures(f.domain.name()).is_ok());
    for (signer, change, reason) in [
        (&f.renewer, (|claims| claims.entity = Name::from_bytes([9; 32])) as fn(&mut MemberCert), "another membership"),
        (&f.renewer, |claims| claims.domain = Name::from_bytes([9; 32]), "another membership"),
        (&f.renewer, |claims| claims.role = "rib".into(), "role rib"),
        (&f.renewer, |claims| claims.not_after += 2 * DAY, "longer than"),
        (&f.renewer, |claims| (claims.serial, claims.not_after) = (9 * claims.serial, NOW + 364 * DAY), "longer than"),
        (&f.renewer, |claims| claims.serial = NOW * NANOS - 1, "before its delegation"),
        (&key(9), |_| (), "wrong key"),
    ] {
        let error = f.refused(&sign(signer, change));
        assert!(error.contains(reason), "{reason}: {error}");
    }
    let foreign = issue(&key(9), &renewal.delegation.claims_unverified().unwrap()).unwrap();
    assert!(f.refused(&with(MembershipRenewal { delegation: foreign, ..renewal })).contains("wrong key"));
}

#[test]
fn a_renewal_ends_with_the_revocation_of_member_or_delegation() {
    let f = Fixture::new();
    let delegation = f.delegation(|terms| terms.serial += 5);
    let renewed = f.base.renew(&f.renewer, &delegation, (NOW + 1) * NANOS).unwrap();
    for revoked in [NOW * NANOS, NOW * NANOS + 5, (NOW + 1) * NANOS] {
        let revocation =
            Revocation { name: f.domain.name(), number: 1, floor: 0, revoked: vec![revoked], signer: None };
        let error = renewed.verify(f.domain.name(), Some(&revocation), NOW + 2).unwrap_err();
        assert!(error.to_string().contains("revoked"), "{revoked}: {error}");
    }
}

//! Unit tests of `domain`.

use super::*;
use gdp_core::identity::SigningKey;

#[test]
fn the_first_entity_is_admitted_and_no_other() {
    let key = SigningKey::generate().unwrap().verify_key();
    let [robot, thief] = [1, 2].map(|n| Name::from_bytes([n; 32]));
    let invite = |serial| Invite {
        domain: Name::default(),
        key,
        role: "arm".into(),
        serial,
        not_before: 0,
        not_after: 100,
        member_until: 200,
    };
    let [robot_now, thief_now] = [robot, thief].map(|entity| Admitted { entity, until: 200 });
    let mut invitations = Invitations::default();
    assert_eq!(invitations.admit(&invite(7), robot_now, 100), Ok(true));
    assert_eq!(invitations.admit(&invite(7), robot_now, 150), Ok(false), "it is one already");
    let refused = invitations.admit(&invite(7), thief_now, 50);
    assert_eq!(refused, Err(NotInvited::Used { serial: 7, by: robot }));
    assert_eq!(
        invitations.admit(&invite(8), thief_now, 101),
        Err(NotInvited::TooLate { serial: 8, at: 100, now: 101 })
    );

    let mut after_a_restart = Invitations::recall(invitations.all().copied());
    assert!(after_a_restart.has_admitted(7, &robot, 200) && !after_a_restart.has_admitted(7, &thief, 200));
    assert!(after_a_restart.admit(&invite(7), thief_now, 50).is_err());
}

#[test]
fn a_renewed_member_is_remembered_for_longer() {
    let key = SigningKey::generate().unwrap().verify_key();
    let (domain, role) = (Name::default(), "arm".to_owned());
    let invite = Invite { domain, key, role, serial: 7, not_before: 0, not_after: 100, member_until: 200 };
    let mut invitations = Invitations::default();
    assert_eq!(invitations.admit(&invite, member(200), 50), Ok(true));
    let renewed = member(300);
    assert!(!invitations.has_admitted(7, &renewed.entity, 300));
    assert_eq!(invitations.admit(&invite, renewed, 150), Ok(true));
    assert_eq!(invitations.admit(&invite, renewed, 150), Ok(false));
    let thief = Admitted { entity: Name::from_bytes([9; 32]), ..renewed };
    assert!(matches!(invitations.admit(&invite, thief, 150), Err(NotInvited::Used { .. })));

    // A renewal does not show that the invitation was used in time.
    let mut lost = Invitations::default();
    assert!(matches!(lost.admit(&invite, renewed, 150), Err(NotInvited::TooLate { .. })));
}

fn member(until: u64) -> Admitted {
    Admitted { entity: Name::default(), until }
}

#[test]
fn what_is_remembered_is_bounded_and_ends() {
    let key = SigningKey::generate().unwrap().verify_key();
    let invite = |serial, member_until| Invite {
        domain: Name::default(),
        key,
        role: "arm".into(),
        serial,
        not_before: 0,
        not_after: member_until,
        member_until,
    };
    let mut invitations = Invitations::default();
    for serial in 0..MAX_USED as u64 {
        invitations.remember(&invite(serial, 100), member(100));
    }
    assert_eq!(invitations.admit(&invite(1 << 20, 300), member(300), 100), Err(NotInvited::Full));
    assert_eq!(invitations.admit(&invite(1 << 20, 300), member(300), 101), Ok(true));
    assert_eq!(invitations.all().count(), 1);
}

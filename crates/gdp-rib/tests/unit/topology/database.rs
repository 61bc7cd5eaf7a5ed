//! Unit tests of `topology::database`.

use super::*;
use gdp_core::cert::issue;
use gdp_core::identity::SigningKey;
use gdp_core::name::NameProof;

const NOW: Duration = Duration::from_secs(1000);

#[test]
fn the_newest_counts_and_ends_in_time() {
    let mut database = Database::default();
    let take = |d: &mut Database, run, number, expires_in| {
        let (flooded, claims) = state(1, run, number, expires_in);
        d.take(NOW, flooded, claims, |_| true)
    };
    let other = |claims: LinkState| LinkState { lifetime: 100, ..claims };
    let twice = [state(1, 2, 5, 100), signed(other(state(1, 2, 5, 100).1), 100)];
    let newer = twice.iter().max_by_key(|(flooded, _)| flooded.state.payload_unverified().unwrap()).unwrap();
    let take_again = |d: &mut Database, (flooded, claims): &(Flooded, LinkState)| {
        d.take(NOW, flooded.clone(), claims.clone(), |_| true)
    };
    assert_eq!(take_again(&mut database, newer), Taken::News { changed: true });
    assert_eq!(take_again(&mut database, newer), Taken::Known);
    let older = twice.iter().find(|other| *other != newer).unwrap();
    assert_eq!(take_again(&mut database, older), Taken::Older, "of the same number, one of the two");
    assert_eq!(take(&mut database, 2, 4, 100), Taken::Older);
    assert_eq!(take(&mut database, 1, 9, 100), Taken::Older);
    assert_eq!(take(&mut database, 2, 6, 10), Taken::News { changed: false });
    assert_eq!(take(&mut database, 3, 1, u32::MAX), Taken::News { changed: true }, "another run may keep another bit");
    let seconds = Duration::from_secs;
    assert_eq!(database.next_expiry(), Some(NOW + seconds(180)), "not longer than it says itself");
    assert_eq!(database.flooded(NOW + seconds(80), &name(1)).map(|told| told.expires_in), Some(100));
    assert_eq!(database.flooded(NOW + Duration::from_millis(179_500), &name(1)), None);
    assert!(!database.expire(NOW + seconds(179)) && database.expire(NOW + seconds(180)));
    assert_eq!(database.switches().count(), 0);
}

#[test]
fn the_same_payload_under_another_signature_is_known() {
    let (flooded, claims) = state(1, 2, 5, 100);
    let (again, _) = signed(claims.clone(), 100);
    assert_ne!(flooded.state.as_bytes(), again.state.as_bytes());
    for [first, second] in [[&flooded, &again], [&again, &flooded]] {
        let mut database = Database::default();
        let mut take = |flooded: &Flooded| database.take(NOW, flooded.clone(), claims.clone(), |_| true);
        assert_eq!((take(first), take(second)), (Taken::News { changed: true }, Taken::Known));
    }
}

#[test]
fn whoever_is_not_reached_makes_room() {
    let mut database = Database::default();
    for i in 0..MAX_SWITCHES as u16 {
        let (flooded, claims) = state(i, 1, 1, 100);
        assert_eq!(database.take(NOW, flooded, claims, |_| true), Taken::News { changed: true });
    }
    let (flooded, claims) = state(999, 1, 1, 100);
    assert_eq!(database.take(NOW, flooded.clone(), claims.clone(), |_| true), Taken::NoRoom);
    assert_eq!(database.take(NOW, flooded, claims, |n| *n != name(7)), Taken::News { changed: true });
    assert!(database.switches().count() == MAX_SWITCHES && database.switches().all(|n| *n != name(7)));
}

fn state(i: u16, run: u64, number: u64, expires_in: u32) -> (Flooded, LinkState) {
    let claims = LinkState {
        switch: name(i),
        run,
        number,
        bit: None,
        neighbours: vec![],
        silent: 0,
        rib: false,
        borders: vec![],
        lifetime: 180,
    };
    signed(claims, expires_in)
}

/// Signs by a new key each time.
fn signed(claims: LinkState, expires_in: u32) -> (Flooded, LinkState) {
    let key = SigningKey::generate().unwrap();
    let proof = NameProof { owner_key: key.public(), digest: [0; 32] };
    (Flooded { proof, state: issue(&key, &claims).unwrap(), expires_in }, claims)
}

fn name(i: u16) -> Name {
    let mut bytes = [0; 32];
    bytes[..2].copy_from_slice(&i.to_be_bytes());
    Name::from_bytes(bytes)
}

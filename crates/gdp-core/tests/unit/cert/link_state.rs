//! Unit tests of `cert::link_state`.

use super::*;
use crate::cert::{MAX_SIGNED, issue};
use crate::identity::SigningKey;

#[test]
fn the_largest_statement_is_a_certificate_and_what_is_out_of_bounds_is_none() {
    let key = SigningKey::from_secret_bytes(&[1; 32]).unwrap();
    let near = |i: usize| (Name::from_bytes([0xc0 + i as u8 % 64; 32]), u32::MAX);
    let neighbours: Vec<_> = (0..MAX_NEIGHBOURS).map(near).collect();
    let switch = Name::from_bytes([1; 32]);
    let border = |i: usize| Adjoining {
        domain: Name::from_bytes([0xe0 + i as u8; 32]),
        switch: Name::from_bytes([0xff; 32]),
        cost: u32::MAX,
        transit: true,
        ours_transit: true,
        parent: Some(u8::MAX),
    };
    let largest = LinkState {
        switch,
        run: u64::MAX,
        number: u64::MAX,
        bit: Some(63),
        neighbours,
        silent: u64::MAX >> (64 - MAX_NEIGHBOURS),
        rib: true,
        borders: (0..MAX_BORDERS).map(border).collect(),
        lifetime: MAX_LIFETIME,
    };
    let signed = issue(&key, &largest).unwrap();
    assert!(signed.as_bytes().len() <= MAX_SIGNED);
    assert_eq!(signed.verify_signature(&key.verify_key()), Ok(largest.clone()));
    let with = |change: &dyn Fn(&mut LinkState)| {
        let mut claims = largest.clone();
        change(&mut claims);
        issue(&key, &claims).map(drop).unwrap_err().to_string()
    };
    for (error, needle) in [
        (with(&|s| s.neighbours.push((Name::from_bytes([0xff; 32]), 1))), "46 neighbours"),
        (with(&|s| s.neighbours.swap(0, 1)), "order"),
        (with(&|s| s.neighbours[1] = s.neighbours[0]), "order"),
        (with(&|s| s.neighbours[0].1 = 0), "costs nothing"),
        (with(&|s| s.switch = s.neighbours[0].0), "the switch itself"),
        (with(&|s| s.silent = 1 << MAX_NEIGHBOURS), "silent that are none"),
        (with(&|s| s.borders.push(border(20))), "17 links into other domains"),
        (with(&|s| s.borders.swap(0, 1)), "order of domains"),
        (with(&|s| s.borders[1] = s.borders[0].clone()), "order of domains"),
        (with(&|s| s.borders[0].cost = 0), "costs nothing"),
        (with(&|s| s.borders[0].switch = switch), "the switch itself"),
        (with(&|s| s.bit = Some(64)), "below 64"),
        (with(&|s| s.lifetime = 0), "lifetime"),
        (with(&|s| s.lifetime = MAX_LIFETIME + 1), "lifetime"),
    ] {
        assert!(error.contains(needle), "{error}");
    }
}

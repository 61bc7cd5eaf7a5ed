//! Unit tests of `topology::flooding`.

use super::*;
use gdp_core::cert::{Adjoining, LinkState, MAX_BORDERS, MAX_NEIGHBOURS, issue};
use gdp_core::identity::SigningKey;
use gdp_core::name::NameProof;
use gdp_proto::control::{Request, encode};

const NOW: Duration = Duration::from_secs(1000);

#[test]
fn a_neighbour_is_told_until_it_answers() {
    let (database, mut flooding) = (database(1), Flooding::default());
    flooding.up(7, database.switches());
    let [batch] = &flooding.next(NOW, &database)[..] else { panic!("one batch") };
    assert!(flooding.next(NOW, &database).is_empty(), "it is on its way");
    flooding.answered(NOW, batch.id, false);
    assert!(flooding.next(NOW, &database).is_empty(), "not at once");
    let retry = flooding.retry_at().unwrap();
    let [again] = &flooding.next(retry, &database)[..] else { panic!("one batch") };
    assert_eq!(again.states[0].state, batch.states[0].state);
    flooding.answered(retry, again.id, true);
    assert!(flooding.next(retry, &database).is_empty() && flooding.retry_at().is_none());
    flooding.owe_all(name(0));
    flooding.holds(7, &name(0));
    assert!(flooding.next(retry, &database).is_empty(), "it has told us itself");
    flooding.owe_all(name(0));
    flooding.down(7);
    assert!(flooding.next(retry, &database).is_empty());
}

#[test]
fn whatever_there_is_to_tell_fits_messages_and_so_many_are_out_at_once() {
    let (database, mut flooding) = (database(256), Flooding::default());
    flooding.up(7, database.switches());
    let mut told = BTreeSet::new();
    let mut out = flooding.next(NOW, &database);
    assert_eq!(out.len(), MOST_OUT);
    while let Some(Batch { id, states }) = out.pop() {
        told.extend(states.iter().map(|told| told.state.claims_unverified().unwrap().switch));
        encode(&Request::Flood { states }).expect("it fits");
        flooding.answered(NOW, id, true);
        out.extend(flooding.next(NOW, &database));
    }
    assert_eq!(told.len(), 256);
}

fn database(switches: u16) -> Database {
    let (key, mut database) = (SigningKey::generate().unwrap(), Database::default());
    for i in 0..switches {
        let neighbours = (1000..).take(MAX_NEIGHBOURS).map(|i| (name(i), u32::MAX)).collect();
        let border = |i| {
            let (domain, switch, cost) = (name(i), name(1000), u32::MAX);
            Adjoining { domain, switch, cost, transit: true, ours_transit: true, parent: Some(u8::MAX) }
        };
        let claims = LinkState {
            switch: name(i),
            run: u64::MAX,
            number: u64::MAX,
            bit: Some(63),
            neighbours,
            silent: 1,
            rib: true,
            borders: (2000..).take(MAX_BORDERS).map(border).collect(),
            lifetime: 180,
        };
        let proof = NameProof { owner_key: key.public(), digest: [0xff; 32] };
        let flooded = Flooded { proof, state: issue(&key, &claims).unwrap(), expires_in: 180 };
        database.take(NOW, flooded, claims, |_| true);
    }
    database
}

fn name(i: u16) -> Name {
    let mut bytes = [0xff; 32];
    bytes[..2].copy_from_slice(&i.to_be_bytes());
    Name::from_bytes(bytes)
}

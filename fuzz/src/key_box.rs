//! Key boxes, as they come from who keeps them.

use std::sync::OnceLock;

use gdp_core::cert::{Claims, Signed, issue};
use gdp_core::identity::Identity;
use gdp_core::keys::{EpochKey, KeyBox, open, wrap};
use gdp_e2e::keys::KeyStore;
use gdp_wire::Name;

const EPOCH: u32 = 1_800_000_000;

/// A reader takes the box that was made for it, and no other: neither one that the writer has not
/// signed, nor one that it has, with something else in it.
pub fn key_box(data: &[u8]) {
    let world = World::get();
    let Ok(signed) = Signed::<KeyBox>::from_bytes(data.to_vec()) else { return };
    let mut store = KeyStore::new(world.name, &world.reader);
    let verify_key = world.writer.key().verify_key();
    let taken = store.take(0, world.writer.name(), &verify_key, &signed);
    assert_eq!(taken.is_ok(), signed == world.signed);
    let Ok(claims) = signed.claims_unverified() else { return };
    claims.check_bounds().expect("what was parsed");
    let signed = issue(world.writer.key(), &claims).expect("what was parsed");
    let for_reader = (claims.reader, world.reader.box_key());
    let opened = open(&signed, claims.name, (claims.writer, &verify_key), for_reader);
    assert_eq!(opened.is_ok(), claims == world.claims, "{claims:?}");
}

pub fn seeds() -> Vec<(String, Vec<u8>)> {
    let world = World::get();
    let resigned = issue(world.reader.key(), &world.claims).expect("a box");
    vec![
        ("a box".into(), world.signed.as_bytes().to_vec()),
        ("a box that another signed".into(), resigned.as_bytes().to_vec()),
    ]
}

/// A box, and those it is between.
struct World {
    name: Name,
    writer: Identity,
    reader: Identity,
    signed: Signed<KeyBox>,
    claims: KeyBox,
}

impl World {
    fn get() -> &'static Self {
        static WORLD: OnceLock<World> = OnceLock::new();
        WORLD.get_or_init(|| {
            let name = Name::from_bytes([1; 32]);
            let [writer, reader] = ["robot", "cloud"].map(|kind| Identity::generate(kind).expect("an identity"));
            let key = EpochKey::generate().expect("a key");
            let signed = wrap(name, &writer, (reader.name(), &reader.box_public()), EPOCH, &key).expect("a box");
            let claims = signed.claims_unverified().expect("a box");
            Self { name, writer, reader, signed, claims }
        })
    }
}

//! Unit tests of `catalog`.

use gdp_core::cert::{Grantee, issue};
use gdp_core::identity::SigningKey;

use super::*;

#[test]
fn what_is_listed_is_of_the_owner_and_of_nobody_else() {
    let (owner, other) = (SigningKey::generate().unwrap(), SigningKey::generate().unwrap());
    let card = card(&owner, "/chatter");
    let catalog = Catalog::new(vec![entry(&owner, "/chatter", 2), entry(&owner, "/map", 0)]).unwrap();
    let bytes = catalog.to_bytes().unwrap();
    let listed = Catalog::read(&bytes, owner.verify_key()).unwrap();
    assert_eq!((&listed[0].0, listed[0].1.len(), listed[1].0.get("topic")), (&card, 2, Some("/map")));
    let claims = listed[0].1[0].verify(&listed[0].0.proof(), None, 1).unwrap();
    assert_eq!(claims.name, card.name());

    // Read as another owner's, they are other names, for which the grants are worth nothing.
    let stolen = Catalog::read(&bytes, other.verify_key()).unwrap();
    assert_ne!(stolen[0].0.name(), card.name());
    stolen[0].1[0].verify(&stolen[0].0.proof(), None, 1).unwrap_err();
}

#[test]
fn what_is_no_catalog_or_too_much_is_refused() {
    let owner = SigningKey::generate().unwrap();
    let key = owner.verify_key();
    let read = |catalog: &Catalog| Catalog::read(&catalog.to_bytes().unwrap(), key);
    let of = |entries| Catalog { version: VERSION, entries };
    let good = of(vec![entry(&owner, "/a", 1)]);
    assert_eq!(read(&good).unwrap().len(), 1);
    let twice = read(&of([good.entries.clone(), good.entries.clone()].concat())).unwrap_err();
    assert!(matches!(twice, CatalogError::Twice(_)), "{twice}");
    let version = read(&Catalog { version: 2, ..good.clone() }).unwrap_err();
    assert!(matches!(version, CatalogError::Version(2)), "{version}");

    let empty = |topic: String| Entry { metadata: Metadata::from([("topic".into(), topic)]), grants: vec![] };
    let many = (0..=MAX_ENTRIES).map(|i| empty(i.to_string())).collect();
    assert!(matches!(read(&of(many)), Err(CatalogError::TooMuch { what: "names", .. })));
    let grants = vec![good.entries[0].grants[0].clone(); MAX_GRANTS + 1];
    let crowded = of(vec![Entry { grants, ..good.entries[0].clone() }]);
    assert!(matches!(read(&crowded), Err(CatalogError::TooMuch { what: "grants of a name", .. })));
    assert!(Catalog::new(crowded.entries).is_err());
    assert!(matches!(read(&of(vec![empty("x".repeat(5000))])), Err(CatalogError::Card(_))));

    let bytes = good.to_bytes().unwrap();
    for length in 0..bytes.len() {
        Catalog::read(&bytes[..length], key).unwrap_err();
    }
    // Whatever is changed on the way is refused, or leads to other names or to grants that are
    // worth nothing.
    for at in 0..bytes.len() {
        let mut changed = bytes.clone();
        changed[at] ^= 1;
        let Ok(listed) = Catalog::read(&changed, key) else { continue };
        let holds = |(card, grants): &Listing| grants.iter().any(|grant| grant.verify(&card.proof(), None, 1).is_ok());
        assert!(!listed.iter().any(holds), "byte {at}");
    }
    Catalog::read(&vec![0; MAX_CATALOG + 1], key).unwrap_err();
}

fn card(owner: &SigningKey, topic: &str) -> NameCard {
    let nonce = Some("n".into());
    NameCard::create(owner.verify_key(), "topic", topic, "std_msgs/msg/String", nonce).unwrap()
}

fn entry(owner: &SigningKey, topic: &str, grants: u64) -> Entry {
    let card = card(owner, topic);
    let grant = |serial| {
        let (name, to) = (card.name(), Grantee::Entity(card.name()));
        issue(owner, &ReadGrant { name, to, serial, not_before: 0, not_after: u64::MAX }).unwrap().into()
    };
    Entry { metadata: card.metadata().clone(), grants: (0..grants).map(grant).collect() }
}

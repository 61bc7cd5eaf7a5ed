//! Unit tests of `cert::allow`.

use super::*;

fn card(owner: &SigningKey) -> NameCard {
    NameCard::create(owner.verify_key(), "topic", "/chatter", "std_msgs/msg/String", None).unwrap()
}

#[test]
fn what_the_owner_signs_holds_for_the_entity_and_the_days() {
    let (owner, entity, other) =
        (SigningKey::generate().unwrap(), Name::from_bytes([7; 32]), Name::from_bytes([8; 32]));
    let (card, now) = (card(&owner), unix_seconds());
    let (after_a_week, day) = (now + 8 * 24 * 3600, 24 * 3600);
    let ad = owner.allow_publish(&card, entity).for_days(7).sign().unwrap();
    let claims = ad.verify_for(&card.proof(), entity, None, now).unwrap();
    assert!((7 * day..=7 * day + 5).contains(&(claims.not_after - now)), "{claims:?}");
    ad.verify_for(&card.proof(), other, None, now).unwrap_err();
    ad.verify_for(&card.proof(), entity, None, after_a_week).unwrap_err();
    let grant = owner.allow_read(&card, entity).valid_for(Duration::from_secs(60)).sign().unwrap();
    grant.verify(&card.proof(), entity, None, now).unwrap();
    grant.verify(&card.proof(), other, None, now).unwrap_err();
    grant.verify(&card.proof(), entity, None, now + 120).unwrap_err();
}

#[test]
fn a_key_that_is_not_the_owners_signs_nothing() {
    let (owner, thief) = (SigningKey::generate().unwrap(), SigningKey::generate().unwrap());
    let (card, entity) = (card(&owner), Name::from_bytes([7; 32]));
    for error in
        [thief.allow_publish(&card, entity).sign().unwrap_err(), thief.allow_read(&card, entity).sign().unwrap_err()]
    {
        assert!(matches!(error, CertError::WrongKey { .. }), "{error}");
    }
}

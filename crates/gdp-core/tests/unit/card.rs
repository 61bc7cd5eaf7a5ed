//! Unit tests of `card`.

use super::*;
use crate::identity::SigningKey;

fn card() -> NameCard {
    let owner = SigningKey::from_secret_bytes(&[7; 32]).unwrap().verify_key();
    NameCard::create(owner, "topic", "/chatter", "std_msgs/msg/String", Some("n".into())).unwrap()
}

#[test]
fn the_card_derives_the_same_name_everywhere() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("chatter.json");
    card().save_new(&path).unwrap();
    let loaded = NameCard::load(&path).unwrap();
    assert_eq!(loaded, card());
    assert_eq!(loaded.name(), card().proof().name().unwrap());
    assert_eq!(loaded.get("topic"), Some("/chatter"));
    assert!(card().save_new(&path).is_err(), "an existing card is not overwritten");
}

#[test]
fn a_random_nonce_makes_two_cards_of_one_topic_differ() {
    let owner = SigningKey::from_secret_bytes(&[7; 32]).unwrap().verify_key();
    let [a, b] = [(); 2].map(|()| NameCard::create(owner, "topic", "/t", "T", None).unwrap());
    assert_eq!(a.get("nonce").unwrap().len(), 32);
    assert_ne!(a.name(), b.name());
}

#[test]
fn what_is_not_exactly_a_card_is_refused() {
    let good = card().to_json();
    NameCard::from_json(&good).unwrap();
    for (what, text) in [
        ("other topic", good.replace("/chatter", "/other")),
        (
            "other owner",
            good.replace(
                &card().owner_key().to_string(),
                &SigningKey::from_secret_bytes(&[8; 32]).unwrap().verify_key().to_string(),
            ),
        ),
        ("other version", good.replace("\"version\": 1", "\"version\": 2")),
        ("unknown field", good.replace("\"version\": 1", "\"version\": 1, \"x\": 1")),
        ("number", good.replace("\"/chatter\"", "5")),
        ("duplicate key", good.replace("\"kind\": \"topic\"", "\"kind\": \"topic\", \"kind\": \"topic\"")),
        ("trailing text", format!("{good}x")),
        ("empty", String::new()),
        ("key off the curve", good.replace(&card().owner_key().to_string(), &"f".repeat(66))),
    ] {
        assert_ne!(text, good, "{what}");
        assert!(NameCard::from_json(&text).is_err(), "{what}");
    }
}

#[test]
fn another_file_is_said_to_be_what_it_is() {
    let of = |text: &str| NameCard::from_json(text).unwrap_err().to_string();
    let cert = of("-----BEGIN GDP AD CERT-----\nAAAA\n-----END GDP AD CERT-----\n");
    assert!(
        cert.starts_with("not a name card: it is a certificate to publish (GDP AD CERT); a name card is"),
        "{cert}"
    );
    assert!(of("kind: proxy\n-----BEGIN PRIVATE KEY-----\n").contains("it is a private key"));
    let junk = of("junk");
    assert!(junk.contains("`gdp-ctl name create`") && !junk.contains("column"), "{junk}");
}

#[test]
fn cards_are_bounded() {
    let owner = SigningKey::from_secret_bytes(&[7; 32]).unwrap().verify_key();
    let new = |entries: Vec<(String, String)>| NameCard::new(owner, entries.into_iter().collect());
    assert!(new(vec![("k".into(), "v".repeat(MAX_VALUE))]).is_ok());
    assert!(new(vec![("k".into(), "v".repeat(MAX_VALUE + 1))]).is_err());
    assert!(new(vec![("k".repeat(MAX_KEY + 1), "v".into())]).is_err());
    assert!(new(vec![(String::new(), "v".into())]).is_err());
    assert!(new((0..=MAX_ENTRIES).map(|i| (i.to_string(), String::new())).collect()).is_err());

    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("long.json");
    std::fs::write(&path, " ".repeat(MAX_FILE + 1)).unwrap();
    assert!(matches!(NameCard::load(&path), Err(CardError::TooLong(_))));
    let endless = NameCard::load(Path::new("/dev/zero"));
    assert!(matches!(endless, Err(CardError::TooLong(_))), "{endless:?}");
}

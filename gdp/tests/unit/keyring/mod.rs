//! Unit tests of `keyring`.

use super::*;
use gdp_core::cert::{Grantee, ReadGrant, issue};
use gdp_core::identity::SigningKey;

const NOW: u64 = 1_000_000;

struct Folder {
    folder: tempfile::TempDir,
    owner: SigningKey,
}

impl Folder {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), owner: SigningKey::generate().unwrap() }
    }

    fn card(&self, file: &str, kind: &str, topic: &str) -> NameCard {
        let card = NameCard::create(self.owner.verify_key(), kind, topic, "std_msgs/msg/String", None).unwrap();
        card.save_new(&self.folder.path().join(file)).unwrap();
        card
    }

    fn grant(&self, file: &str, name: Name, entity: Name, not_after: u64) {
        let claims = ReadGrant { name, to: Grantee::Entity(entity), serial: not_after, not_before: 0, not_after };
        let grant = Reading::from(issue(&self.owner, &claims).unwrap());
        std::fs::write(self.folder.path().join(file), grant.to_pem()).unwrap();
    }

    fn open(&self) -> Keyring {
        Keyring::open(self.folder.path()).unwrap()
    }
}

#[test]
fn a_card_is_found_by_topic_digits_and_file() {
    let folder = Folder::new();
    let chatter = folder.card("a.card", "topic", "/chatter");
    folder.card("b.card", "service", "/plan");
    let keyring = folder.open();
    let file = folder.folder.path().join("a.card").display().to_string();
    let name = chatter.name().to_string();
    for what in ["/chatter", "chatter", &name, &name[..16], &file] {
        assert_eq!(keyring.find(what, "topic").unwrap(), chatter, "{what}");
    }
    assert_eq!(keyring.cards("topic").count(), 1);
    assert!(matches!(keyring.find("/plan", "topic"), Err(FindError::Unknown { .. })));
    assert!(matches!(keyring.find(&name, "service"), Err(FindError::Other { .. })));
}

#[test]
fn two_names_of_one_topic_are_told_apart_by_their_digits() {
    let folder = Folder::new();
    let (one, two) = (folder.card("a.card", "topic", "/tf"), folder.card("b.card", "topic", "/tf"));
    let keyring = folder.open();
    let refusal = keyring.find("/tf", "topic").unwrap_err().to_string();
    assert!(refusal.contains(&one.name().to_string()) && refusal.contains(&two.name().to_string()), "{refusal}");
    assert_eq!(keyring.find(&two.name().to_string(), "topic").unwrap(), two);
}

#[test]
fn the_grant_that_holds_longest_is_taken_and_the_remedy_is_named() {
    let folder = Folder::new();
    let card = folder.card("a.card", "topic", "/chatter");
    let (entity, other) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]));
    let missing = folder.open().grant(&card, entity, NOW).unwrap_err().to_string();
    assert!(missing.contains("grant add") && missing.contains(&entity.to_string()), "{missing}");
    folder.grant("old.grant", card.name(), entity, NOW - 10_000);
    assert!(folder.open().grant(&card, entity, NOW).unwrap_err().to_string().contains("old.grant"));
    folder.grant("new.grant", card.name(), entity, NOW + 10);
    folder.grant("newer.grant", card.name(), entity, NOW + 20);
    folder.grant("others.grant", card.name(), other, NOW + 30);
    let taken = folder.open().grant(&card, entity, NOW).unwrap();
    assert_eq!(taken.grant.cert.claims_unverified().unwrap().not_after, NOW + 20);
}

#[test]
fn what_is_no_card_is_named_and_left_out() {
    let folder = Folder::new();
    folder.card("a.card", "topic", "/chatter");
    std::fs::write(folder.folder.path().join("b.card"), "junk").unwrap();
    std::fs::write(folder.folder.path().join("c.grant"), "junk").unwrap();
    std::fs::write(folder.folder.path().join("notes.txt"), "junk").unwrap();
    let keyring = folder.open();
    assert_eq!((keyring.cards("topic").count(), keyring.left_out.len()), (1, 2));
    assert!(keyring.left_out.iter().all(|reason| reason.contains("b.card") || reason.contains("c.grant")));
    assert!(matches!(Keyring::open(Path::new("/nowhere")), Err(KeyringError::Folder { .. })));
}

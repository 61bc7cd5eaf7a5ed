//! The owner of a name, for tests that issue its certificates themselves.

use gdp_core::card::NameCard;
use gdp_core::identity::SigningKey;

pub struct Owner {
    pub key: SigningKey,
    pub card: NameCard,
}

impl Owner {
    /// Creates the owner of a topic or service.
    pub fn new(kind: &str, of: &str) -> Self {
        let key = SigningKey::generate().unwrap();
        let card = NameCard::create(key.verify_key(), kind, of, "T", None).unwrap();
        Self { key, card }
    }
}

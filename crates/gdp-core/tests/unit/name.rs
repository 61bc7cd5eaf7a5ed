//! Unit tests of `name`.

use super::*;
use crate::identity::SigningKey;

fn metadata(entries: &[(&str, &str)]) -> Metadata {
    entries.iter().map(|(k, v)| (k.to_string(), v.to_string())).collect()
}

/// The order of RFC 8785 §3.2.3: U+1F600 is two code units that begin with D83D, so it sorts before
/// U+FB33, although its UTF-8 and its code point are larger.
#[test]
fn keys_are_ordered_by_utf_16_code_units() {
    let map = metadata(&[
        ("\u{20ac}", "Euro Sign"),
        ("\r", "Carriage Return"),
        ("\u{fb33}", "Hebrew Letter Dalet With Dagesh"),
        ("1", "One"),
        ("\u{1f600}", "Emoji: Grinning Face"),
        ("\u{80}", "Control"),
        ("\u{f6}", "Latin Small Letter O With Diaeresis"),
    ]);
    let json = canonical_json(&map);
    let order = ["Carriage", "One", "Control", "Latin", "Euro", "Emoji", "Hebrew"];
    let found: Vec<_> = order.iter().map(|word| json.find(word).unwrap()).collect();
    assert!(found.is_sorted(), "{json}");
}

#[test]
fn strings_are_escaped_as_rfc_8785_says() {
    let map = metadata(&[("k", "\u{20ac}$\u{f}\n\tA'B\"\\\\\"/\u{7f}\u{0}\u{8}\u{c}\r")]);
    assert_eq!(canonical_json(&map), "{\"k\":\"\u{20ac}$\\u000f\\n\\tA'B\\\"\\\\\\\\\\\"/\u{7f}\\u0000\\b\\f\\r\"}");
    assert_eq!(canonical_json(&Metadata::new()), "{}");
    let parsed: Metadata = serde_json::from_str(&canonical_json(&map)).unwrap();
    assert_eq!(parsed, map);
}

#[test]
fn every_input_changes_the_name() {
    let (key, other) = (
        SigningKey::from_secret_bytes(&[1; 32]).unwrap().public(),
        SigningKey::from_secret_bytes(&[2; 32]).unwrap().public(),
    );
    let digest = inner_digest(&metadata(&[("topic", "/chatter")]));
    let name = derive(&key, &digest);
    assert_ne!(derive(&other, &digest), name);
    assert_ne!(derive(&key, &inner_digest(&metadata(&[("topic", "/chatter2")]))), name);
    assert_ne!(derive(&key, &inner_digest(&metadata(&[("topic2", "/chatter")]))), name);
}

#[test]
fn a_proof_with_a_key_off_the_curve_proves_nothing() {
    let digest = [1; 32];
    let proof = NameProof { owner_key: SigningKey::from_secret_bytes(&[1; 32]).unwrap().public(), digest };
    assert_eq!(proof.name(), Ok(derive(&proof.owner_key, &digest)));
    assert_eq!(NameProof { owner_key: [0xff; 33], digest }.name(), Err(CryptoError::BadPublicKey));
    let bytes = crate::cbor::encode(&proof).unwrap();
    assert_eq!(crate::cbor::decode::<NameProof>(&bytes, 200), Ok(proof));
}

#[test]
fn prefixes_match_whole_digits() {
    let name = Name::from_bytes([0xa7; 32]);
    for text in ["a", "A7", "a7a", &name.to_string()] {
        assert!(text.parse::<NamePrefix>().unwrap().matches(&name), "{text}");
    }
    assert!(!"a8".parse::<NamePrefix>().unwrap().matches(&name));
    assert_eq!(NamePrefix::from(name).full(), Some(name));
    for text in ["", "xyz", "a7 ", &"a".repeat(65), "é"] {
        assert_eq!(text.parse::<NamePrefix>(), Err(NamePrefixError), "{text}");
    }
    assert!(serde_json::from_str::<NamePrefix>("\"\"").is_err());
}

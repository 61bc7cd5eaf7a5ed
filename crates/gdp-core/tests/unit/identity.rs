//! Unit tests of `identity`.

use super::*;
use std::fs;
use std::os::unix::fs::PermissionsExt;

#[test]
fn a_key_survives_its_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("key.pem");
    let key = SigningKey::generate().unwrap();
    key.save_new(&path).unwrap();
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.starts_with("-----BEGIN PRIVATE KEY-----\n"));
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o7777, 0o600);

    let loaded = SigningKey::load(&path).unwrap();
    assert_eq!(loaded.public(), key.public());
    let signature = loaded.sign(b"message").unwrap();
    key.verify_key().verify(b"message", &signature).unwrap();
    assert!(matches!(key.save_new(&path), Err(SecretFileError::Exists(_))));
}

#[test]
fn a_readable_or_broken_key_file_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("key.pem");
    SigningKey::generate().unwrap().save_new(&path).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).unwrap();
    let error = SigningKey::load(&path).unwrap_err().to_string();
    assert!(error.contains("chmod 600"), "{error}");
    // A refused file is not replaced either.
    assert!(matches!(SigningKey::load_or_generate(&path), Err(SecretFileError::TooOpen { .. })));

    fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
    for content in ["", "rubbish", "-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n"] {
        fs::write(&path, content).unwrap();
        let error = SigningKey::load(&path).unwrap_err().to_string();
        assert!(error.contains("key.pem"), "{error}");
    }
    fs::write(&path, [0xff; 10]).unwrap();
    assert!(SigningKey::load(&path).is_err());
}

#[test]
fn a_key_file_may_state_its_kind() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("robot.pem");
    let robot = Identity::generate("proxy").unwrap();
    robot.save_new(&path).unwrap();
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.starts_with("kind: proxy\n-----BEGIN PRIVATE KEY-----\n"), "the key follows");
    let file = KeyFile::load(&path).unwrap();
    assert_eq!(file.kind.as_deref(), Some("proxy"));
    assert_eq!(file.identity_or("tool").name(), robot.name());
    assert_eq!(SigningKey::load(&path).unwrap().public(), robot.key().public());

    // Explanatory text of others, a kind that is none, and a file without text.
    let key = text.strip_prefix("kind: proxy\n").unwrap();
    for (before, kind) in [
        ("Bag Attributes\r\nkind: tool\r\n", Some("tool")),
        ("kind: Two words\n", None),
        ("key of\n", None),
        ("", None),
    ] {
        fs::write(&path, format!("{before}{key}")).unwrap();
        let file = KeyFile::load(&path).unwrap();
        assert_eq!(file.kind.as_deref(), kind, "{before}");
        assert_eq!(file.identity_or("proxy").name() == robot.name(), kind.is_none(), "{before}");
    }

    let made = Identity::load_or_generate(&dir.path().join("s1.pem"), "switch").unwrap();
    let file = KeyFile::load(&dir.path().join("s1.pem")).unwrap();
    assert_eq!(file.kind.as_deref(), Some("switch"));
    assert_eq!(file.identity_or("").name(), made.name());
    fs::write(&path, "-----BEGIN GDP AD CERT-----\nAAAA\n-----END GDP AD CERT-----\n").unwrap();
    let error = SigningKey::load(&path).unwrap_err().to_string();
    assert!(error.contains("robot.pem: it is a certificate to publish (GDP AD CERT), not a private key"), "{error}");
}

#[test]
fn processes_that_start_together_get_one_key() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("key.pem");
    let names: Vec<Name> = std::thread::scope(|scope| {
        let starts: Vec<_> =
            (0..4).map(|_| scope.spawn(|| Identity::load_or_generate(&path, "proxy").unwrap().name())).collect();
        starts.into_iter().map(|start| start.join().unwrap()).collect()
    });
    assert!(names.iter().all(|name| *name == names[0]));
}

#[test]
fn the_kind_is_part_of_the_name() {
    let key = SigningKey::generate().unwrap();
    let (switch, rib) = (Identity::new(key.clone(), "switch"), Identity::new(key, "rib"));
    assert_ne!(switch.name(), rib.name());
    assert_eq!(switch.proof().name().unwrap(), switch.name());
}

#[test]
fn nothing_prints_a_secret() {
    let key = SigningKey::from_secret_bytes(&[0x42; 32]).unwrap();
    let text = format!("{key:?} {:?}", Identity::new(key.clone(), "proxy"));
    assert!(!text.contains("4242424242") && !text.contains("66, 66, 66"), "{text}");
}

#[test]
fn public_keys_are_points_on_the_curve() {
    let key = SigningKey::generate().unwrap().verify_key();
    assert_eq!(key.to_string().parse(), Ok(key));
    for text in ["", "02", &"0".repeat(66), &format!("02{}", "f".repeat(64)), &format!("{key}00")] {
        assert_eq!(text.parse::<VerifyKey>(), Err(CryptoError::BadPublicKey), "{text}");
    }
    assert_eq!(serde_json::from_str::<VerifyKey>(&serde_json::to_string(&key).unwrap()).unwrap(), key);
    assert!(serde_json::from_str::<VerifyKey>(&format!("\"02{}\"", "f".repeat(64))).is_err());
}

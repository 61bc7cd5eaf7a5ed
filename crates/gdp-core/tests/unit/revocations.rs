//! Unit tests of `revocations`.

use std::fs;
use std::os::unix::fs::PermissionsExt;

use super::*;
use crate::cert::{MAX_REVOKED, issue};
use crate::identity::SigningKey;

#[test]
fn what_was_kept_comes_back_and_is_verified() {
    let folder = tempfile::tempdir().unwrap();
    let file = RevocationFile::new(folder.path().join("revocations"), 1 << 20);
    assert_eq!(file.load().unwrap(), []);
    let origin = Some(Origin { through: Name::from_bytes([9; 32]), by_tool: true });
    let (one, full) = (signed(1, 1, vec![7]), signed(2, 3, (0..MAX_REVOKED as u64).collect()));
    let full = SignedRevocation { origin, ..full };
    // Signed by another owner.
    let forged = SignedRevocation { proof: one.proof, ..full.clone() };
    assert_eq!(file.save([&one, &forged, &full]).unwrap(), 0);
    assert_eq!(fs::metadata(file.path()).unwrap().permissions().mode() & 0o7777, 0o600);
    let loaded: Vec<_> = file.load().unwrap().into_iter().map(|(kept, claims)| (kept, claims.number)).collect();
    assert_eq!(loaded, [(one.clone(), 1), (full, 3)]);
    assert_eq!(file.save([&one]).unwrap(), 0);
    assert_eq!(file.load().unwrap().len(), 1);
}

#[test]
fn files_are_bounded_and_damage_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let file = RevocationFile::new(folder.path().join("revocations"), 1000);
    let many: Vec<_> = (1..10).map(|seed| signed(seed, 1, vec![])).collect();
    let omitted = file.save(&many).unwrap();
    let loaded = file.load().unwrap();
    assert!(omitted > 0 && loaded.len() + omitted == many.len());
    assert_eq!(loaded[0].0, many[0], "the first are those that count");
    let bytes = fs::read(file.path()).unwrap();
    for length in (0..bytes.len()).filter(|length| *length != HEAD.len()) {
        fs::write(file.path(), &bytes[..length]).unwrap();
        let whole_entries = file.load().map_or(0, |loaded| loaded.len());
        assert!(whole_entries < loaded.len(), "{length}");
    }
    fs::write(file.path(), b"something else").unwrap();
    assert!(file.load().unwrap_err().to_string().contains("remove it"));
    fs::write(file.path(), vec![0; 1001]).unwrap();
    assert!(matches!(file.load(), Err(SecretFileError::TooLong { .. })));
}

fn signed(seed: u8, number: u64, revoked: Vec<u64>) -> SignedRevocation {
    let owner = SigningKey::from_secret_bytes(&[seed; 32]).unwrap();
    let proof = NameProof { owner_key: owner.public(), digest: [seed; 32] };
    let claims = Revocation { name: proof.name().unwrap(), number, floor: 0, revoked, signer: None };
    SignedRevocation { proof, revocation: issue(&owner, &claims).unwrap(), origin: None }
}

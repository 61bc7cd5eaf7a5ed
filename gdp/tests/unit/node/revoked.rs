//! Unit tests of `node::revoked`.

use std::time::{Duration, Instant};

use super::*;
use gdp_core::cert::issue;
use gdp_core::identity::SigningKey;

fn revocation() -> (NameProof, Signed<Revocation>, Revocation) {
    let owner = SigningKey::generate().unwrap();
    let proof = NameProof { owner_key: owner.public(), digest: [1; 32] };
    let claims = Revocation { name: proof.name().unwrap(), number: 1, floor: 0, revoked: vec![1], signer: None };
    (proof, issue(&owner, &claims).unwrap(), claims)
}

#[test]
fn what_could_not_be_saved_is_saved_later() {
    let (parent, entity) = (tempfile::tempdir().unwrap(), Name::from_bytes([7; 32]));
    let folder = parent.path().join("made/for/it");
    let revoked = Revoked::open(Some(&folder), entity).unwrap();
    let (proof, signed, claims) = revocation();
    revoked.keep(proof, signed, claims.clone());
    std::fs::remove_dir(&folder).unwrap();
    revoked.save();
    assert!(revoked.is_unsaved());
    std::fs::create_dir(&folder).unwrap();
    revoked.save();
    assert!(!revoked.is_unsaved());
    let again = Revoked::open(Some(&folder), entity).unwrap();
    assert_eq!(again.of(&claims.name).unwrap().1, claims);
}

#[test]
fn whoever_saves_finds_it_saved_afterwards() {
    let (proof, signed, claims) = revocation();
    for _ in 0..20 {
        let folder = tempfile::tempdir().unwrap();
        let revoked = Revoked::open(Some(folder.path()), Name::default()).unwrap();
        revoked.keep(proof, signed.clone(), claims.clone());
        std::thread::scope(|threads| {
            threads.spawn(|| revoked.save());
            let deadline = Instant::now() + Duration::from_secs(60);
            while revoked.is_unsaved() {
                assert!(Instant::now() < deadline, "it is not saved");
                std::thread::yield_now();
            }
            // The other thread is writing now.
            revoked.save();
            assert!(Revoked::open(Some(folder.path()), Name::default()).unwrap().of(&claims.name).is_some());
        });
    }
}

#[test]
fn a_folder_that_cannot_be_made_is_told_of() {
    let parent = tempfile::tempdir().unwrap();
    let file = parent.path().join("file");
    std::fs::write(&file, "").unwrap();
    let error = Revoked::open(Some(&file.join("folder")), Name::default()).err().unwrap().to_string();
    assert!(error.contains("file/folder: cannot make the folder"), "{error}");
}

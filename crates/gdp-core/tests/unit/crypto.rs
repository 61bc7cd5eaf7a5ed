//! Published vectors, and each back end checked against the other in both directions.

use super::*;
use crate::identity::SigningKey;

#[test]
fn sha256_of_abc() {
    let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!(hex::encode(sha256(&[b"a", b"", b"bc"])), expected);
}

/// RFC 5869 A.1, first 32 bytes of the output.
#[test]
fn hkdf_of_rfc_5869() {
    let salt = hex::decode("000102030405060708090a0b0c").unwrap();
    let info = hex::decode("f0f1f2f3f4f5f6f7f8f9").unwrap();
    let expected = "3cb25f25faacd57a90434f64d0362f2a2d2d0a90cf1a5a4c5db02d56ecc4c5bf";
    let key = hkdf_sha256(&salt, &[0x0b; 22], &[&info[..4], &info[4..]]).unwrap();
    assert_eq!(hex::encode(*key), expected);
}

/// Test case 16 of "The Galois/Counter Mode of Operation" (McGrew, Viega).
#[test]
fn aes_256_gcm_of_the_specification() {
    let key = hex::decode("feffe9928665731c6d6a8f9467308308feffe9928665731c6d6a8f9467308308").unwrap();
    let nonce = hex::decode("cafebabefacedbaddecaf888").unwrap();
    let aad = hex::decode("feedfacedeadbeeffeedfacedeadbeefabaddad2").unwrap();
    let plaintext = hex::decode(
        "d9313225f88406e5a55909c5aff5269a86a7a9531534f7da2e4c303d8a318a721c3c0c95956809532fcf0e2449a6b525b16aedf5aa0de657ba637b39",
    )
    .unwrap();
    for backend in Backend::ALL {
        let aead = backend.aead(key.as_slice().try_into().unwrap()).unwrap();
        let mut data = plaintext.clone();
        let tag = aead.seal(nonce.as_slice().try_into().unwrap(), &aad, &mut data).unwrap();
        assert_eq!(hex::encode(&data[..16]), "522dc1f099567d07f47f37a32a84427d", "{backend:?}");
        assert_eq!(hex::encode(tag), "76fc6ece0f4e1768cddf8853bb2d551b", "{backend:?}");
    }
}

#[test]
fn each_back_end_opens_what_the_other_sealed() {
    let (key, nonce) = ([7u8; 32], [9u8; NONCE_LEN]);
    for (sealer, opener) in pairs() {
        for len in [0usize, 1, 15, 16, 17, 1400] {
            let plaintext: Vec<u8> = (0..len).map(|i| i as u8).collect();
            let mut data = plaintext.clone();
            let tag = sealer.aead(&key).unwrap().seal(&nonce, b"aad", &mut data).unwrap();
            let aead = opener.aead(&key).unwrap();
            let mut out = vec![0u8; len];
            aead.open(&nonce, b"aad", &data, &tag, &mut out).unwrap();
            assert_eq!(out, plaintext);
            let mut wrong_tag = tag;
            wrong_tag[len % TAG_LEN] ^= 1;
            assert_eq!(aead.open(&nonce, b"aad", &data, &wrong_tag, &mut out), Err(CryptoError::Forged));
            assert_eq!(aead.open(&nonce, b"axd", &data, &tag, &mut out), Err(CryptoError::Forged));
            assert!(aead.open(&nonce, b"aad", &data, &tag, &mut vec![0; len + 1]).is_err());
        }
    }
}

#[test]
fn each_back_end_verifies_what_the_other_signed() {
    let key = SigningKey::generate().unwrap();
    let pkcs8 = key.pkcs8_der();
    for (signing, verifying) in pairs() {
        let signature = signing.signer(&pkcs8).unwrap().sign(b"message").unwrap();
        let verifier = verifying.verifier(&key.public()).unwrap();
        verifier.verify(b"message", &signature).unwrap();
        assert_eq!(verifier.verify(b"massage", &signature), Err(CryptoError::BadSignature));
        for at in 0..SIGNATURE_LEN {
            let mut wrong = signature;
            wrong[at] ^= 0x10;
            assert_eq!(verifier.verify(b"message", &wrong), Err(CryptoError::BadSignature), "byte {at}");
        }
        let other = verifying.verifier(&SigningKey::generate().unwrap().public()).unwrap();
        assert_eq!(other.verify(b"message", &signature), Err(CryptoError::BadSignature));
    }
}

/// RFC 5903 §8.1 (a group key exchange over P-256).
#[test]
fn ecdh_of_rfc_5903() {
    let bytes = |text: &str| -> [u8; 32] { hex::decode(text).unwrap().try_into().unwrap() };
    let i = bytes("c88f01f510d9ac3f70a292daa2316de544e9aab8afe84049c62a9c57862d1433");
    let r = bytes("c6ef9c5d78ae012a011164acb397ce2088685d8f06bf9be0b283ab46476bee53");
    let shared = "d6840f6b42f6edafd13116e0e12565202fef8e9ece7dce03812464d04b9442de";
    let public = agreement_public(&r).unwrap();
    assert_eq!(hex::encode(&public[1..]), "d12dfb5289c8d4f81208b70270398c342296970a0bccb74c736fc7554494bf63");
    assert_eq!(hex::encode(*agree(&i, &public).unwrap()), shared);
    assert_eq!(hex::encode(*agree(&r, &agreement_public(&i).unwrap()).unwrap()), shared);
}

/// Returns the other form of a signature, by p256's arithmetic.
pub fn restated(signature: &[u8; SIGNATURE_LEN]) -> [u8; SIGNATURE_LEN] {
    let parsed = p256::ecdsa::Signature::from_slice(signature).unwrap();
    let (r, s) = parsed.split_scalars();
    p256::ecdsa::Signature::from_scalars(r.to_bytes(), (-*s).to_bytes()).unwrap().to_bytes().into()
}

/// If one back end accepted a high `s` and the other did not, two nodes could disagree about one
/// message.
#[test]
fn both_back_ends_sign_with_a_low_s_and_refuse_a_high_one() {
    let key = SigningKey::generate().unwrap();
    for signing in Backend::ALL {
        let signer = signing.signer(&key.pkcs8_der()).unwrap();
        // By chance, half of all signatures would have a high s.
        for message in 0u8..64 {
            let signature = signer.sign(&[message]).unwrap();
            let high = restated(&signature);
            assert_eq!(p256::ecdsa::Signature::from_slice(&signature).unwrap().normalize_s().to_bytes()[..], signature);
            assert_eq!(low_s::lower(high), signature);
            for verifying in Backend::ALL {
                let verifier = verifying.verifier(&key.public()).unwrap();
                assert_eq!(verifier.verify(&[message], &signature), Ok(()), "{signing:?}, {verifying:?}");
                assert_eq!(verifier.verify(&[message], &high), Err(CryptoError::HighS), "{signing:?}, {verifying:?}");
            }
        }
    }
}

#[test]
fn what_is_no_key_is_refused_by_both() {
    let mut off_curve = [0xffu8; PUBLIC_KEY_LEN];
    off_curve[0] = 2;
    let mut wrong_prefix = SigningKey::generate().unwrap().public();
    wrong_prefix[0] = 4;
    // SEC1's compact form, which has no sign.
    let mut compact = wrong_prefix;
    compact[0] = 5;
    for bytes in [[0u8; PUBLIC_KEY_LEN], off_curve, wrong_prefix, compact] {
        for backend in Backend::ALL {
            assert_eq!(backend.verifier(&bytes).err(), Some(CryptoError::BadPublicKey), "{backend:?}");
        }
        assert_eq!(agree(&[1; 32], &bytes).err(), Some(CryptoError::BadPublicKey));
        assert_eq!(hpke_seal(&bytes, b"", b"").err(), Some(CryptoError::BadPublicKey));
    }
    for secret in [[0; 32], [0xff; 32]] {
        assert_eq!(agreement_public(&secret).err(), Some(CryptoError::BadPrivateKey));
    }
    for backend in Backend::ALL {
        assert_eq!(backend.signer(b"not DER").err(), Some(CryptoError::BadPrivateKey), "{backend:?}");
    }
}

/// Returns each back end with each, in both roles.
fn pairs() -> impl Iterator<Item = (Backend, Backend)> {
    Backend::ALL.iter().flat_map(|a| Backend::ALL.iter().map(|b| (*a, *b)))
}

#[test]
fn a_process_keeps_the_back_end_that_it_used_first() {
    let used = Backend::selected();
    for &wanted in Backend::ALL {
        let result = wanted.select();
        assert_eq!(result, if wanted == used { Ok(()) } else { Err(BackendError { wanted, used }) });
    }
    assert_eq!(Backend::selected(), used);
}

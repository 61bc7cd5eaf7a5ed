//! Unit tests of `crypto::hpke`.

use super::*;
use crate::crypto::{Backend, NONCE_LEN, agree, agreement_public};
use ::hpke::aead::AesGcm128;
use p256::PublicKey;

const SECRET: &str = "f3ce7fdae57e1a310d87f1ebbde6f328be0a99cdbcadf4d6589cf29de4b8ffd2";
const ENCAPSULATED: &str = "04a92719c6195d5085104f469a8b9814d5838ff72b60501e2c4466e5e67b325ac9\
                            8536d7b61a1af4b78e5b7f951c0900be863c403ce65c9bfcb9382657222d18c4";
const INFO: &[u8] = b"Ode on a Grecian Urn";

/// RFC 9180 §A.3.1. The RFC prints no vectors with AES-256-GCM on this curve; this suite differs in
/// the cipher alone.
#[test]
fn the_suite_with_aes_128_opens_what_the_rfc_sealed() {
    let ciphertext = "5ad590bb8baa577f8619db35a36311226a896e7342a6d836d8b7bcd2f20b6c7f9076ac232e3ab2523f39513434";
    let plaintext = single_shot_open::<AesGcm128, HkdfSha256, DhP256HkdfSha256>(
        &OpModeR::Base,
        &PrivateKey::from_bytes(&secret()).unwrap(),
        &EncappedKey::from_bytes(&bytes(ENCAPSULATED)).unwrap(),
        INFO,
        &bytes(ciphertext),
        b"Count-0",
    );
    assert_eq!(plaintext.unwrap(), b"Beauty is truth, truth beauty");
    let shared_secret = "c0d26aeab536609a572b07695d933b589dcf363ff9d93c93adea537aeabb8cb8";
    assert_eq!(hex::encode(decapsulated(&bytes(ENCAPSULATED))), shared_secret);
}

/// The steps of RFC 9180 §4 and §5, written out, over each back end.
#[test]
fn what_it_seals_is_what_the_rfc_says() {
    let public = agreement_public(&secret()).unwrap();
    let sealed = seal(&public, INFO, b"a key").unwrap();
    assert_eq!(sealed.len(), b"a key".len() + OVERHEAD);
    let (encapsulated, ciphertext) = sealed.split_at(ENCAPSULATED_LEN);
    let shared = decapsulated(encapsulated);
    let suite = [&b"HPKE"[..], &[0, 0x10, 0, 1, 0, 2]].concat();
    let extract = |salt: &[u8], label: &[u8], ikm: &[u8]| labelled_extract(salt, &suite, label, ikm);
    let context = [&[0][..], &extract(&[], b"psk_id_hash", &[]), &extract(&[], b"info_hash", INFO)].concat();
    let secret = extract(&shared, b"secret", &[]);
    let key = labelled_expand(&secret, &suite, b"key", &context, 32);
    let nonce = labelled_expand(&secret, &suite, b"base_nonce", &context, NONCE_LEN);
    let (ciphertext, tag) = ciphertext.split_last_chunk().unwrap();
    for backend in Backend::ALL {
        let mut plaintext = vec![0; ciphertext.len()];
        let aead = backend.aead(key.as_slice().try_into().unwrap()).unwrap();
        aead.open(nonce.as_slice().try_into().unwrap(), &[], ciphertext, tag, &mut plaintext).unwrap();
        assert_eq!(plaintext, b"a key");
    }
}

#[test]
fn only_the_key_and_the_info_open_it() {
    let public = agreement_public(&secret()).unwrap();
    let sealed = seal(&public, INFO, b"a key").unwrap();
    assert_eq!(open(&secret(), INFO, &sealed).unwrap().as_slice(), b"a key");
    assert_eq!(open(&secret(), b"other", &sealed).err(), Some(CryptoError::Forged));
    assert_eq!(open(&[1; 32], INFO, &sealed).err(), Some(CryptoError::Forged));
    for at in 0..sealed.len() {
        let mut changed = sealed.clone();
        changed[at] ^= 1;
        assert_eq!(open(&secret(), INFO, &changed).err(), Some(CryptoError::Forged), "byte {at}");
        assert_eq!(open(&secret(), INFO, &sealed[..at]).err(), Some(CryptoError::Forged), "cut to {at}");
    }
    assert_eq!(seal(&[0xff; PUBLIC_KEY_LEN], INFO, b"a key").err(), Some(CryptoError::BadPublicKey));
}

/// RFC 9180 §4.1, ExtractAndExpand of Decap.
fn decapsulated(encapsulated: &[u8]) -> Vec<u8> {
    let compressed = |point: &[u8]| PublicKey::from_sec1_bytes(point).unwrap().to_sec1_point(true);
    let peer = compressed(encapsulated).as_bytes().try_into().unwrap();
    let shared = agree(&secret(), &peer).unwrap();
    let own = agreement_public(&secret()).unwrap();
    let own = PublicKey::from_sec1_bytes(&own).unwrap().to_sec1_point(false);
    let suite = [&b"KEM"[..], &[0, 0x10]].concat();
    let prk = labelled_extract(&[], &suite, b"eae_prk", shared.as_slice());
    labelled_expand(&prk, &suite, b"shared_secret", &[encapsulated, own.as_bytes()].concat(), 32)
}

fn labelled_extract(salt: &[u8], suite: &[u8], label: &[u8], ikm: &[u8]) -> Vec<u8> {
    let ikm = [b"HPKE-v1", suite, label, ikm].concat();
    hkdf::Hkdf::<sha2::Sha256>::extract(Some(salt), &ikm).0.to_vec()
}

fn labelled_expand(prk: &[u8], suite: &[u8], label: &[u8], info: &[u8], len: usize) -> Vec<u8> {
    let info = [&(len as u16).to_be_bytes()[..], b"HPKE-v1", suite, label, info].concat();
    let mut out = vec![0; len];
    hkdf::Hkdf::<sha2::Sha256>::from_prk(prk).unwrap().expand(&info, &mut out).unwrap();
    out
}

fn secret() -> [u8; 32] {
    bytes(SECRET).try_into().unwrap()
}

fn bytes(text: &str) -> Vec<u8> {
    hex::decode(text).unwrap()
}

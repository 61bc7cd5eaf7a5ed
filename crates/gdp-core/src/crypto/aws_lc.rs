//! The default back end: AWS-LC through aws-lc-rs. Only `crypto` calls it.

use crate::crypto::error::CryptoError;
use crate::crypto::lengths::{NONCE_LEN, PUBLIC_KEY_LEN, SIGNATURE_LEN, TAG_LEN};
use aws_lc_rs::{
    aead::{AES_256_GCM, Aad, LessSafeKey, Nonce, UnboundKey},
    agreement::{self, ECDH_P256, PrivateKey},
    digest,
    encoding::{AsBigEndian, EcPublicKeyCompressedBin},
    hkdf,
    rand::SystemRandom,
    signature::{ECDSA_P256_SHA256_FIXED, ECDSA_P256_SHA256_FIXED_SIGNING, EcdsaKeyPair, ParsedPublicKey},
};
use zeroize::Zeroizing;

pub fn sha256(parts: &[&[u8]]) -> [u8; 32] {
    // Hashing at once is several times faster for a few blocks, because the library allocates a
    // context on the heap.
    let mut gathered = [0u8; 512];
    let digest = match parts {
        [all] => digest::digest(&digest::SHA256, all),
        _ => match gather(parts, &mut gathered) {
            Some(all) => digest::digest(&digest::SHA256, all),
            None => {
                let mut context = digest::Context::new(&digest::SHA256);
                parts.iter().for_each(|part| context.update(part));
                context.finish()
            }
        },
    };
    let mut out = [0u8; 32];
    out.copy_from_slice(digest.as_ref());
    out
}

/// Concatenates the parts in `place`, or returns `None` if they do not fit.
fn gather<'a>(parts: &[&[u8]], place: &'a mut [u8]) -> Option<&'a [u8]> {
    let mut at = 0;
    for part in parts {
        place.get_mut(at..at + part.len())?.copy_from_slice(part);
        at += part.len();
    }
    Some(&place[..at])
}

pub fn hkdf_sha256(salt: &[u8], ikm: &[u8], info: &[&[u8]]) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
    let mut out = Zeroizing::new([0u8; 32]);
    hkdf::Salt::new(hkdf::HKDF_SHA256, salt)
        .extract(ikm)
        .expand(info, hkdf::HKDF_SHA256)
        .and_then(|okm| okm.fill(out.as_mut_slice()))
        .map_err(|_| CryptoError::Internal)?;
    Ok(out)
}

pub fn agreement_public(secret: &[u8; 32]) -> Result<[u8; PUBLIC_KEY_LEN], CryptoError> {
    let public = private_key(secret)?.compute_public_key().map_err(|_| CryptoError::Internal)?;
    let bytes: EcPublicKeyCompressedBin<'_> = public.as_be_bytes().map_err(|_| CryptoError::Internal)?;
    bytes.as_ref().try_into().map_err(|_| CryptoError::Internal)
}

pub fn agree(secret: &[u8; 32], public: &[u8; PUBLIC_KEY_LEN]) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
    let public = agreement::UnparsedPublicKey::new(&ECDH_P256, public);
    let mut shared = Zeroizing::new([0u8; 32]);
    agreement::agree(&private_key(secret)?, public, CryptoError::BadPublicKey, |x| {
        shared.copy_from_slice(x.get(..32).ok_or(CryptoError::Internal)?);
        Ok(())
    })?;
    Ok(shared)
}

fn private_key(secret: &[u8; 32]) -> Result<PrivateKey, CryptoError> {
    PrivateKey::from_private_key(&ECDH_P256, secret).map_err(|_| CryptoError::BadPrivateKey)
}

pub struct Aead(LessSafeKey);

impl Aead {
    pub fn new(key: &[u8; 32]) -> Result<Self, CryptoError> {
        let key = UnboundKey::new(&AES_256_GCM, key).map_err(|_| CryptoError::Internal)?;
        Ok(Self(LessSafeKey::new(key)))
    }

    pub fn seal(&self, nonce: &[u8; NONCE_LEN], aad: &[u8], data: &mut [u8]) -> Result<[u8; TAG_LEN], CryptoError> {
        let tag = self
            .0
            .seal_in_place_separate_tag(Nonce::assume_unique_for_key(*nonce), Aad::from(aad), data)
            .map_err(|_| CryptoError::Internal)?;
        tag.as_ref().try_into().map_err(|_| CryptoError::Internal)
    }

    pub fn open(
        &self,
        nonce: &[u8; NONCE_LEN],
        aad: &[u8],
        ciphertext: &[u8],
        tag: &[u8; TAG_LEN],
        out: &mut [u8],
    ) -> Result<(), CryptoError> {
        self.0
            .open_separate_gather(Nonce::assume_unique_for_key(*nonce), Aad::from(aad), ciphertext, tag, out)
            .map_err(|_| CryptoError::Forged)
    }
}

pub struct Verifier(ParsedPublicKey);

impl Verifier {
    pub fn new(public: &[u8; PUBLIC_KEY_LEN]) -> Result<Self, CryptoError> {
        ParsedPublicKey::new(&ECDSA_P256_SHA256_FIXED, public).map(Self).map_err(|_| CryptoError::BadPublicKey)
    }

    pub fn verify(&self, message: &[u8], signature: &[u8; SIGNATURE_LEN]) -> Result<(), CryptoError> {
        self.0.verify_sig(message, signature).map_err(|_| CryptoError::BadSignature)
    }
}

pub struct Signer(EcdsaKeyPair);

impl Signer {
    pub fn new(pkcs8_der: &[u8]) -> Result<Self, CryptoError> {
        EcdsaKeyPair::from_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, pkcs8_der)
            .map(Self)
            .map_err(|_| CryptoError::BadPrivateKey)
    }

    pub fn sign(&self, message: &[u8]) -> Result<[u8; SIGNATURE_LEN], CryptoError> {
        let signature = self.0.sign(&SystemRandom::new(), message).map_err(|_| CryptoError::Internal)?;
        signature.as_ref().try_into().map_err(|_| CryptoError::Internal)
    }
}

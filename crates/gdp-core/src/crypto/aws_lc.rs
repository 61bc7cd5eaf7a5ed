//! The faster back end: AWS-LC through aws-lc-rs. Only `crypto` calls it.

use crate::crypto::error::CryptoError;
use crate::crypto::lengths::{NONCE_LEN, PUBLIC_KEY_LEN, SIGNATURE_LEN, TAG_LEN};
use aws_lc_rs::{
    aead::{AES_256_GCM, Aad, LessSafeKey, Nonce, UnboundKey},
    rand::SystemRandom,
    signature::{ECDSA_P256_SHA256_FIXED, ECDSA_P256_SHA256_FIXED_SIGNING, EcdsaKeyPair, ParsedPublicKey},
};

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

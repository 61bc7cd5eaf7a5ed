//! RustCrypto's `sha2`, `hkdf`, `aes-gcm` and `p256`. Only `crypto` calls it. Its signatures are
//! deterministic (RFC 6979), which the test vectors rely on.

use crate::crypto::error::CryptoError;
use crate::crypto::lengths::{NONCE_LEN, PUBLIC_KEY_LEN, SIGNATURE_LEN, TAG_LEN};
use aes_gcm::{
    Aes256Gcm, KeyInit,
    aead::{AeadInOut, inout::InOutBuf},
};
use p256::ecdsa::{
    Signature, SigningKey, VerifyingKey,
    signature::{Signer as _, Verifier as _},
};
use p256::elliptic_curve::sec1::ToSec1Point;
use p256::pkcs8::DecodePrivateKey;
use p256::{PublicKey, SecretKey, ecdh};
use sha2::{Digest, Sha256};
use zeroize::Zeroizing;

/// Returns the SHA-256 hash of the concatenation of `parts`.
pub fn sha256(parts: &[&[u8]]) -> [u8; 32] {
    let mut hasher = Sha256::new();
    parts.iter().for_each(|part| hasher.update(part));
    hasher.finalize().into()
}

/// Derives 32 bytes by HKDF-SHA256 (RFC 5869), with `info` as the concatenation of its parts.
pub fn hkdf_sha256(salt: &[u8], ikm: &[u8], info: &[&[u8]]) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
    let mut out = Zeroizing::new([0u8; 32]);
    hkdf::Hkdf::<Sha256>::new(Some(salt), ikm)
        .expand_multi_info(info, out.as_mut_slice())
        .map_err(|_| CryptoError::Internal)?;
    Ok(out)
}

/// Returns the public key, SEC1 compressed, of a private P-256 key (32 bytes, big endian).
pub fn agreement_public(secret: &[u8; 32]) -> Result<[u8; PUBLIC_KEY_LEN], CryptoError> {
    let point = private_key(secret)?.public_key().to_sec1_point(true);
    point.as_bytes().try_into().map_err(|_| CryptoError::Internal)
}

/// Performs ECDH on P-256 and returns the shared x coordinate. Pass it through [`hkdf_sha256`].
pub fn agree(secret: &[u8; 32], public: &[u8; PUBLIC_KEY_LEN]) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
    let public = public_key(public)?;
    let shared = ecdh::diffie_hellman(private_key(secret)?.to_nonzero_scalar(), public.as_affine());
    let mut out = Zeroizing::new([0u8; 32]);
    out.copy_from_slice(shared.raw_secret_bytes());
    Ok(out)
}

/// Parses a public key, SEC1 compressed. Other forms of 33 bytes would give a key two encodings.
pub fn public_key(public: &[u8; PUBLIC_KEY_LEN]) -> Result<PublicKey, CryptoError> {
    let is_compressed = matches!(public[0], 2 | 3);
    let parsed = PublicKey::from_sec1_bytes(public).ok().filter(|_| is_compressed);
    parsed.ok_or(CryptoError::BadPublicKey)
}

fn private_key(secret: &[u8; 32]) -> Result<SecretKey, CryptoError> {
    SecretKey::from_slice(secret).map_err(|_| CryptoError::BadPrivateKey)
}

pub struct Aead(Aes256Gcm);

impl Aead {
    pub fn new(key: &[u8; 32]) -> Self {
        Self(Aes256Gcm::new(key.into()))
    }

    pub fn seal(&self, nonce: &[u8; NONCE_LEN], aad: &[u8], data: &mut [u8]) -> Result<[u8; TAG_LEN], CryptoError> {
        let tag = self.0.encrypt_inout_detached(nonce.into(), aad, data.into()).map_err(|_| CryptoError::Internal)?;
        Ok(tag.into())
    }

    pub fn open(
        &self,
        nonce: &[u8; NONCE_LEN],
        aad: &[u8],
        ciphertext: &[u8],
        tag: &[u8; TAG_LEN],
        out: &mut [u8],
    ) -> Result<(), CryptoError> {
        let buffer = InOutBuf::new(ciphertext, out).map_err(|_| CryptoError::Internal)?;
        self.0.decrypt_inout_detached(nonce.into(), aad, buffer, tag.into()).map_err(|_| CryptoError::Forged)
    }
}

pub struct Verifier(VerifyingKey);

impl Verifier {
    pub fn new(public: &[u8; PUBLIC_KEY_LEN]) -> Result<Self, CryptoError> {
        Ok(Self(public_key(public)?.into()))
    }

    pub fn verify(&self, message: &[u8], signature: &[u8; SIGNATURE_LEN]) -> Result<(), CryptoError> {
        let signature = Signature::from_slice(signature).map_err(|_| CryptoError::BadSignature)?;
        self.0.verify(message, &signature).map_err(|_| CryptoError::BadSignature)
    }
}

pub struct Signer(SigningKey);

impl Signer {
    pub fn new(pkcs8_der: &[u8]) -> Result<Self, CryptoError> {
        SigningKey::from_pkcs8_der(pkcs8_der).map(Self).map_err(|_| CryptoError::BadPrivateKey)
    }

    pub fn sign(&self, message: &[u8]) -> [u8; SIGNATURE_LEN] {
        let signature: Signature = self.0.sign(message);
        signature.to_bytes().into()
    }
}

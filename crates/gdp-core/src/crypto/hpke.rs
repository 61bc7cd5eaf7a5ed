//! Hybrid public key encryption (HPKE, RFC 9180) in base mode, one message at a time. The suite is
//! DHKEM(P-256, HKDF-SHA256), HKDF-SHA256, AES-256-GCM, by rustls over AWS-LC. Only `crypto` calls
//! it. There is no second back end.

use p256::PublicKey;
use p256::elliptic_curve::sec1::ToSec1Point;
use rustls::crypto::aws_lc_rs::hpke::DH_KEM_P256_HKDF_SHA256_AES_256;
use rustls::crypto::hpke::{EncapsulatedSecret, Hpke, HpkePrivateKey, HpkePublicKey};
use zeroize::Zeroizing;

use crate::crypto::error::CryptoError;
use crate::crypto::lengths::{PUBLIC_KEY_LEN, TAG_LEN};

/// Bytes of an encapsulated key: a SEC1 uncompressed point (RFC 9180 §7.1.1).
const ENCAPSULATED_LEN: usize = 65;

pub const OVERHEAD: usize = ENCAPSULATED_LEN + TAG_LEN;

pub fn seal(public: &[u8; PUBLIC_KEY_LEN], info: &[u8], plaintext: &[u8]) -> Result<Vec<u8>, CryptoError> {
    let point = PublicKey::from_sec1_bytes(public).map_err(|_| CryptoError::BadPublicKey)?.to_sec1_point(false);
    let (encapsulated, ciphertext) = DH_KEM_P256_HKDF_SHA256_AES_256
        .seal(info, &[], plaintext, &HpkePublicKey(point.as_bytes().to_vec()))
        .map_err(|_| CryptoError::Internal)?;
    Ok([encapsulated.0, ciphertext].concat())
}

pub fn open(secret: &[u8; 32], info: &[u8], sealed: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
    let (encapsulated, ciphertext) = sealed.split_at_checked(ENCAPSULATED_LEN).ok_or(CryptoError::Forged)?;
    let secret = HpkePrivateKey::from(secret.to_vec());
    DH_KEM_P256_HKDF_SHA256_AES_256
        .open(&EncapsulatedSecret(encapsulated.to_vec()), info, &[], ciphertext, &secret)
        .map(Zeroizing::new)
        .map_err(|_| CryptoError::Forged)
}

#[cfg(test)]
#[path = "../../tests/unit/crypto/hpke.rs"]
mod tests;

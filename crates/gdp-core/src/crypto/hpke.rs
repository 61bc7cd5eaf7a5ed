//! Hybrid public key encryption (HPKE, RFC 9180) in base mode, one message at a time. The suite is
//! DHKEM(P-256, HKDF-SHA256), HKDF-SHA256, AES-256-GCM, by the crate `hpke` over RustCrypto. Only
//! `crypto` calls it.

use ::hpke::aead::AesGcm256;
use ::hpke::kdf::HkdfSha256;
use ::hpke::kem::{DhP256HkdfSha256, Kem};
use ::hpke::{Deserializable, OpModeR, OpModeS, Serializable, single_shot_open, single_shot_seal};
use p256::elliptic_curve::sec1::ToSec1Point;
use zeroize::Zeroizing;

use crate::crypto::error::CryptoError;
use crate::crypto::lengths::{PUBLIC_KEY_LEN, TAG_LEN};
use crate::crypto::rust_crypto::public_key;

/// Bytes of an encapsulated key: a SEC1 uncompressed point (RFC 9180 §7.1.1).
const ENCAPSULATED_LEN: usize = 65;

pub const OVERHEAD: usize = ENCAPSULATED_LEN + TAG_LEN;

type EncappedKey = <DhP256HkdfSha256 as Kem>::EncappedKey;
type PrivateKey = <DhP256HkdfSha256 as Kem>::PrivateKey;
type HpkePublicKey = <DhP256HkdfSha256 as Kem>::PublicKey;

pub fn seal(public: &[u8; PUBLIC_KEY_LEN], info: &[u8], plaintext: &[u8]) -> Result<Vec<u8>, CryptoError> {
    let point = public_key(public)?.to_sec1_point(false);
    let public = HpkePublicKey::from_bytes(point.as_bytes()).map_err(|_| CryptoError::BadPublicKey)?;
    let sealed =
        single_shot_seal::<AesGcm256, HkdfSha256, DhP256HkdfSha256>(&OpModeS::Base, &public, info, plaintext, &[]);
    let (encapsulated, ciphertext) = sealed.map_err(|_| CryptoError::Internal)?;
    Ok([&encapsulated.to_bytes()[..], &ciphertext].concat())
}

pub fn open(secret: &[u8; 32], info: &[u8], sealed: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
    let (encapsulated, ciphertext) = sealed.split_at_checked(ENCAPSULATED_LEN).ok_or(CryptoError::Forged)?;
    let encapsulated = EncappedKey::from_bytes(encapsulated).map_err(|_| CryptoError::Forged)?;
    let secret = PrivateKey::from_bytes(secret).map_err(|_| CryptoError::BadPrivateKey)?;
    single_shot_open::<AesGcm256, HkdfSha256, DhP256HkdfSha256>(
        &OpModeR::Base,
        &secret,
        &encapsulated,
        info,
        ciphertext,
        &[],
    )
    .map(Zeroizing::new)
    .map_err(|_| CryptoError::Forged)
}

#[cfg(test)]
#[path = "../../tests/unit/crypto/hpke.rs"]
mod tests;

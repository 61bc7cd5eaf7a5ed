//! Cryptographic primitives, without any protocol.
//!
//! Everything is RustCrypto's: `sha2`, `hkdf`, `aes-gcm`, `p256` and `hpke`. AES-256-GCM and
//! signatures of messages, and the verification of all signatures, also have a faster back end,
//! AWS-LC. `cargo xtask bench crypto` compares them. The outputs of both are interchangeable, and
//! the tests check each against the other.
//!
//! ECDSA signatures are 64 bytes `r ‖ s`. Both back ends produce and accept only the lower of the
//! two equivalent values of `s`, so that signed bytes have one form.

#[cfg(feature = "aws-lc")]
mod aws_lc;
mod backend;
mod error;
mod hpke;
mod lengths;
mod low_s;
mod parsed;
mod rust_crypto;

use std::fmt;

use subtle::ConstantTimeEq;

pub use backend::{Backend, BackendError};
pub use error::CryptoError;
pub use lengths::{NONCE_LEN, PUBLIC_KEY_LEN, SIGNATURE_LEN, TAG_LEN};
pub use parsed::parsed;
pub use rust_crypto::{agree, agreement_public, hkdf_sha256, sha256};

/// AES-256-GCM with detached 16-byte tags. The caller must never use a nonce twice with one key.
pub struct Aead(AeadImpl);

enum AeadImpl {
    #[cfg(feature = "aws-lc")]
    AwsLc(aws_lc::Aead),
    RustCrypto(Box<rust_crypto::Aead>),
}

impl Aead {
    /// Encrypts `data` in place and returns the tag.
    pub fn seal(&self, nonce: &[u8; NONCE_LEN], aad: &[u8], data: &mut [u8]) -> Result<[u8; TAG_LEN], CryptoError> {
        match &self.0 {
            #[cfg(feature = "aws-lc")]
            AeadImpl::AwsLc(aead) => aead.seal(nonce, aad, data),
            AeadImpl::RustCrypto(aead) => aead.seal(nonce, aad, data),
        }
    }

    /// Decrypts `ciphertext` into `out`, which must have the same length. After an error the
    /// content of `out` is unspecified.
    pub fn open(
        &self,
        nonce: &[u8; NONCE_LEN],
        aad: &[u8],
        ciphertext: &[u8],
        tag: &[u8; TAG_LEN],
        out: &mut [u8],
    ) -> Result<(), CryptoError> {
        match &self.0 {
            #[cfg(feature = "aws-lc")]
            AeadImpl::AwsLc(aead) => aead.open(nonce, aad, ciphertext, tag, out),
            AeadImpl::RustCrypto(aead) => aead.open(nonce, aad, ciphertext, tag, out),
        }
    }
}

impl fmt::Debug for Aead {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Aead(…)")
    }
}

/// Verifier of ECDSA P-256 signatures with SHA-256.
pub struct Verifier(VerifierImpl);

enum VerifierImpl {
    #[cfg(feature = "aws-lc")]
    AwsLc(aws_lc::Verifier),
    RustCrypto(rust_crypto::Verifier),
}

impl Verifier {
    /// Verifies a signature. One with a high `s` is refused as [`CryptoError::HighS`].
    pub fn verify(&self, message: &[u8], signature: &[u8; SIGNATURE_LEN]) -> Result<(), CryptoError> {
        if !low_s::is_low(signature) {
            return Err(CryptoError::HighS);
        }
        match &self.0 {
            #[cfg(feature = "aws-lc")]
            VerifierImpl::AwsLc(verifier) => verifier.verify(message, signature),
            VerifierImpl::RustCrypto(verifier) => verifier.verify(message, signature),
        }
    }
}

impl fmt::Debug for Verifier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Verifier(…)")
    }
}

/// Signer of ECDSA P-256 signatures with SHA-256. Clears its key when dropped.
pub struct Signer(SignerImpl);

enum SignerImpl {
    #[cfg(feature = "aws-lc")]
    AwsLc(aws_lc::Signer),
    RustCrypto(rust_crypto::Signer),
}

impl Signer {
    /// Signs `message`. The result has a low `s`.
    pub fn sign(&self, message: &[u8]) -> Result<[u8; SIGNATURE_LEN], CryptoError> {
        let signature = match &self.0 {
            #[cfg(feature = "aws-lc")]
            SignerImpl::AwsLc(signer) => signer.sign(message)?,
            SignerImpl::RustCrypto(signer) => signer.sign(message),
        };
        Ok(low_s::lower(signature))
    }
}

impl fmt::Debug for Signer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Signer(…)")
    }
}

/// Bytes that [`hpke_seal`] adds to a plaintext.
pub const HPKE_OVERHEAD: usize = hpke::OVERHEAD;

/// Encrypts `plaintext` to the holder of the private key of `public`.
///
/// HPKE (RFC 9180) in base mode: DHKEM(P-256, HKDF-SHA256), HKDF-SHA256, AES-256-GCM, no additional
/// data. The result is the encapsulated key (65 bytes), then ciphertext and tag. It does not
/// authenticate the sender.
pub fn hpke_seal(public: &[u8; PUBLIC_KEY_LEN], info: &[u8], plaintext: &[u8]) -> Result<Vec<u8>, CryptoError> {
    hpke::seal(public, info, plaintext)
}

/// Decrypts the output of [`hpke_seal`] with the same `info`.
pub fn hpke_open(secret: &[u8; 32], info: &[u8], sealed: &[u8]) -> Result<zeroize::Zeroizing<Vec<u8>>, CryptoError> {
    hpke::open(secret, info, sealed)
}

/// Compares two secrets in constant time.
pub fn same_secret(a: &[u8; 32], b: &[u8; 32]) -> bool {
    a.ct_eq(b).into()
}

/// Returns random bytes from the system, fit for keys, sessions and nonces.
pub fn random<const N: usize>() -> Result<[u8; N], CryptoError> {
    let mut bytes = [0u8; N];
    getrandom::fill(&mut bytes).map_err(|_| CryptoError::NoRandom)?;
    Ok(bytes)
}

#[cfg(test)]
#[path = "../../tests/unit/crypto.rs"]
pub(crate) mod tests;

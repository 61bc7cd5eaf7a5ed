//! Cryptographic primitives with two interchangeable back ends: aws-lc-rs (default, fast) and
//! RustCrypto (portable). Both are always compiled, and the tests check each against the other.
//! This module contains no protocol.
//!
//! ECDSA signatures are 64 bytes `r ‖ s`. Both back ends produce and accept only the lower of the
//! two equivalent values of `s`, so that signed bytes have one form.

mod aws_lc;
mod error;
mod hpke;
mod lengths;
mod low_s;
mod parsed;
mod rust_crypto;

use std::fmt;

pub use error::CryptoError;
pub use lengths::{NONCE_LEN, PUBLIC_KEY_LEN, SIGNATURE_LEN, TAG_LEN};
pub use parsed::parsed;

/// Implementation of the primitives. The outputs of both are interchangeable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Backend {
    #[default]
    AwsLc,
    RustCrypto,
}

impl Backend {
    pub const ALL: [Self; 2] = [Self::AwsLc, Self::RustCrypto];

    /// Returns the SHA-256 hash of the concatenation of `parts`.
    pub fn sha256(self, parts: &[&[u8]]) -> [u8; 32] {
        match self {
            Self::AwsLc => aws_lc::sha256(parts),
            Self::RustCrypto => rust_crypto::sha256(parts),
        }
    }

    /// Derives 32 bytes by HKDF-SHA256 (RFC 5869), with `info` as the concatenation of its parts.
    pub fn hkdf_sha256(
        self,
        salt: &[u8],
        ikm: &[u8],
        info: &[&[u8]],
    ) -> Result<zeroize::Zeroizing<[u8; 32]>, CryptoError> {
        match self {
            Self::AwsLc => aws_lc::hkdf_sha256(salt, ikm, info),
            Self::RustCrypto => rust_crypto::hkdf_sha256(salt, ikm, info),
        }
    }

    /// Creates an AES-256-GCM cipher with `key`.
    pub fn aead(self, key: &[u8; 32]) -> Result<Aead, CryptoError> {
        Ok(Aead(match self {
            Self::AwsLc => AeadImpl::AwsLc(aws_lc::Aead::new(key)?),
            Self::RustCrypto => AeadImpl::RustCrypto(Box::new(rust_crypto::Aead::new(key))),
        }))
    }

    /// Parses a public key for verifying many signatures.
    pub fn verifier(self, public: &[u8; PUBLIC_KEY_LEN]) -> Result<Verifier, CryptoError> {
        Ok(Verifier(match self {
            Self::AwsLc => VerifierImpl::AwsLc(aws_lc::Verifier::new(public)?),
            Self::RustCrypto => VerifierImpl::RustCrypto(rust_crypto::Verifier::new(public)?),
        }))
    }

    /// Creates a signing key pair from a PKCS#8 P-256 private key.
    pub fn signer(self, pkcs8_der: &[u8]) -> Result<Signer, CryptoError> {
        Ok(Signer(match self {
            Self::AwsLc => SignerImpl::AwsLc(aws_lc::Signer::new(pkcs8_der)?),
            Self::RustCrypto => SignerImpl::RustCrypto(rust_crypto::Signer::new(pkcs8_der)?),
        }))
    }

    /// Returns the public key, SEC1 compressed, of a private P-256 key (32 bytes, big endian).
    pub fn agreement_public(self, secret: &[u8; 32]) -> Result<[u8; PUBLIC_KEY_LEN], CryptoError> {
        match self {
            Self::AwsLc => aws_lc::agreement_public(secret),
            Self::RustCrypto => rust_crypto::agreement_public(secret),
        }
    }

    /// Performs ECDH on P-256 and returns the shared x coordinate. Pass it through
    /// [`Self::hkdf_sha256`].
    pub fn agree(
        self,
        secret: &[u8; 32],
        public: &[u8; PUBLIC_KEY_LEN],
    ) -> Result<zeroize::Zeroizing<[u8; 32]>, CryptoError> {
        match self {
            Self::AwsLc => aws_lc::agree(secret, public),
            Self::RustCrypto => rust_crypto::agree(secret, public),
        }
    }
}

/// AES-256-GCM with detached 16-byte tags. The caller must never use a nonce twice with one key.
pub struct Aead(AeadImpl);

enum AeadImpl {
    AwsLc(aws_lc::Aead),
    RustCrypto(Box<rust_crypto::Aead>),
}

impl Aead {
    /// Encrypts `data` in place and returns the tag.
    pub fn seal(&self, nonce: &[u8; NONCE_LEN], aad: &[u8], data: &mut [u8]) -> Result<[u8; TAG_LEN], CryptoError> {
        match &self.0 {
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
    AwsLc(aws_lc::Signer),
    RustCrypto(rust_crypto::Signer),
}

impl Signer {
    /// Signs `message`. The result has a low `s`.
    pub fn sign(&self, message: &[u8]) -> Result<[u8; SIGNATURE_LEN], CryptoError> {
        let signature = match &self.0 {
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
    aws_lc_rs::constant_time::verify_slices_are_equal(a, b).is_ok()
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

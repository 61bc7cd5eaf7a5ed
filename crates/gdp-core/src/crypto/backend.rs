//! The implementation of AES-256-GCM and ECDSA for messages, and of all verification.

use std::fmt;
use std::sync::OnceLock;

use serde::Deserialize;

#[cfg(feature = "aws-lc")]
use super::aws_lc;
use super::{Aead, AeadImpl, Signer, SignerImpl, Verifier, VerifierImpl, rust_crypto};
use crate::crypto::error::CryptoError;
use crate::crypto::lengths::PUBLIC_KEY_LEN;

/// Implementation of AES-256-GCM and ECDSA. The outputs of both are interchangeable, so nodes with
/// different ones understand each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
pub enum Backend {
    /// AWS-LC, in C and assembly. Only with the cargo feature `aws-lc`, the default.
    #[cfg(feature = "aws-lc")]
    #[serde(rename = "aws-lc")]
    AwsLc,
    /// RustCrypto, all in Rust.
    #[serde(rename = "rustcrypto")]
    RustCrypto,
}

/// The process has used another back end already.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("crypto: {wanted} cannot be selected, because {used} is in use already; start the program anew")]
pub struct BackendError {
    pub wanted: Backend,
    pub used: Backend,
}

impl fmt::Display for Backend {
    /// Writes the word of the configuration.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            #[cfg(feature = "aws-lc")]
            Self::AwsLc => "aws-lc",
            Self::RustCrypto => "rustcrypto",
        })
    }
}

/// The selected back end of this process.
static SELECTED: OnceLock<Backend> = OnceLock::new();

impl Backend {
    pub const ALL: &[Self] = &[
        #[cfg(feature = "aws-lc")]
        Self::AwsLc,
        Self::RustCrypto,
    ];

    /// Selects the back end of this process. Call it before any key is parsed.
    pub fn select(self) -> Result<(), BackendError> {
        let used = *SELECTED.get_or_init(|| self);
        if used == self { Ok(()) } else { Err(BackendError { wanted: self, used }) }
    }

    /// Returns the selected back end of this process: the first of [`Self::ALL`], unless
    /// [`Self::select`] was called before.
    pub fn selected() -> Self {
        *SELECTED.get_or_init(|| Self::ALL[0])
    }

    /// Creates an AES-256-GCM cipher with `key`.
    pub fn aead(self, key: &[u8; 32]) -> Result<Aead, CryptoError> {
        Ok(Aead(match self {
            #[cfg(feature = "aws-lc")]
            Self::AwsLc => AeadImpl::AwsLc(aws_lc::Aead::new(key)?),
            Self::RustCrypto => AeadImpl::RustCrypto(Box::new(rust_crypto::Aead::new(key))),
        }))
    }

    /// Parses a public key for verifying many signatures.
    pub fn verifier(self, public: &[u8; PUBLIC_KEY_LEN]) -> Result<Verifier, CryptoError> {
        Ok(Verifier(match self {
            #[cfg(feature = "aws-lc")]
            Self::AwsLc => VerifierImpl::AwsLc(aws_lc::Verifier::new(public)?),
            Self::RustCrypto => VerifierImpl::RustCrypto(rust_crypto::Verifier::new(public)?),
        }))
    }

    /// Creates a signing key pair from a PKCS#8 P-256 private key.
    pub fn signer(self, pkcs8_der: &[u8]) -> Result<Signer, CryptoError> {
        Ok(Signer(match self {
            #[cfg(feature = "aws-lc")]
            Self::AwsLc => SignerImpl::AwsLc(aws_lc::Signer::new(pkcs8_der)?),
            Self::RustCrypto => SignerImpl::RustCrypto(rust_crypto::Signer::new(pkcs8_der)?),
        }))
    }
}

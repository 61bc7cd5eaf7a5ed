//! Errors of the cryptographic primitives.

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CryptoError {
    #[error("authentication failed: the data was not sealed with this key, or was changed")]
    Forged,
    #[error("the signature does not fit the data and the key")]
    BadSignature,
    #[error("the signature has a high s, where only the low form is accepted; sign anew with a current release")]
    HighS,
    #[error("not a P-256 public key: 33 bytes, a compressed point on the curve")]
    BadPublicKey,
    #[error("not a P-256 private key")]
    BadPrivateKey,
    #[error("the system's random number generator failed")]
    NoRandom,
    #[error("the cryptographic library failed; the input may be too large for it")]
    Internal,
}

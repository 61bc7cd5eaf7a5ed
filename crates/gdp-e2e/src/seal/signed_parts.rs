//! What a reader checks of a signed message: its signature and its age.

use super::DropReason;
use super::wire::Proof;
use crate::seal::event::Push;
use gdp_core::crypto::CryptoError;

/// What a signature covers besides the header, and the proof of it.
pub struct SignedParts<'a> {
    pub commitment: [u8; 32],
    /// Digests of the segments' plaintexts.
    pub digests: &'a [[u8; 32]],
    pub proof: Proof<'a>,
}

pub fn unsigned(error: CryptoError) -> DropReason {
    if error == CryptoError::HighS { DropReason::HighS } else { DropReason::BadSignature }
}

/// Checks the age of what has proven to be signed.
pub fn check_age(push: &mut Push<'_>, timestamp_ns: u64) -> Result<(), DropReason> {
    let age = u128::from(push.now.unix_ns.saturating_sub(timestamp_ns));
    if age <= push.shared.limits.max_age.as_nanos() {
        return Ok(());
    }
    push.out.too_old = true;
    Err(DropReason::TooOld)
}

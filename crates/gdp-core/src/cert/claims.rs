//! Common parts of all certificates and statements. Times are Unix seconds, both ends included.

use crate::cert::error::CertError;
use serde::{Serialize, de::DeserializeOwned};

/// Tolerance in seconds for an issuer's clock that is ahead of the verifier's. Expiry has no such
/// tolerance: a verifier whose clock is behind already accepts longer.
pub const CLOCKS_DIFFER: u64 = 60;

/// Validity period in Unix seconds, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Validity {
    pub not_before: u64,
    pub not_after: u64,
}

impl Validity {
    /// Unlimited validity, for what is bounded otherwise. A statement, for example, is bounded by
    /// its serial and its attachment.
    pub const ALWAYS: Self = Self { not_before: 0, not_after: u64::MAX };

    /// Checks that `now` is within the period, with a tolerance of [`CLOCKS_DIFFER`] at its
    /// beginning.
    pub fn check(&self, now: u64) -> Result<(), CertError> {
        if now.saturating_add(CLOCKS_DIFFER) < self.not_before {
            return Err(CertError::NotYetValid { from: self.not_before, now });
        }
        if now > self.not_after {
            return Err(CertError::Expired { at: self.not_after, now });
        }
        Ok(())
    }

    /// Returns the intersection of two periods.
    pub fn and(self, other: Self) -> Self {
        Self { not_before: self.not_before.max(other.not_before), not_after: self.not_after.min(other.not_after) }
    }

    pub(super) fn check_order(&self) -> Result<(), CertError> {
        let Self { not_before, not_after } = self;
        if not_before > not_after {
            return Err(CertError::Malformed(format!("begins at {not_before}, after it ends at {not_after}")));
        }
        Ok(())
    }
}

/// Claims of one kind of certificate or statement.
pub trait Claims: Serialize + DeserializeOwned {
    /// Name of the kind in messages for people.
    const KIND: &'static str;
    /// Label of the text form, between `-----BEGIN ` and `-----`.
    const LABEL: &'static str;
    /// Content type and external AAD of the signature. It differs for each kind and version.
    const CONTEXT: &'static str;

    fn validity(&self) -> Validity;

    /// Checks bounds that the types do not express.
    fn check_bounds(&self) -> Result<(), CertError> {
        self.validity().check_order()
    }
}

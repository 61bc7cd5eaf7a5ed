//! What all certificates and statements have in common. Times are Unix seconds, both ends included.

use crate::cert::error::CertError;
use serde::{Serialize, de::DeserializeOwned};

/// Seconds by which the clock of who issues something may be ahead of that of who verifies it.
/// Nothing is taken so much longer: a clock that is behind already errs that way.
pub const CLOCKS_DIFFER: u64 = 60;

/// When something holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Validity {
    pub not_before: u64,
    pub not_after: u64,
}

impl Validity {
    /// For what is bounded in another way, as a statement is by its serial and its attachment.
    pub const ALWAYS: Self = Self { not_before: 0, not_after: u64::MAX };

    /// Whether it is so at `now`, give or take [`CLOCKS_DIFFER`] at the beginning.
    pub fn check(&self, now: u64) -> Result<(), CertError> {
        if now.saturating_add(CLOCKS_DIFFER) < self.not_before {
            return Err(CertError::NotYetValid { from: self.not_before, now });
        }
        if now > self.not_after {
            return Err(CertError::Expired { at: self.not_after, now });
        }
        Ok(())
    }

    /// When this and `other` both hold.
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

/// One kind of certificate or statement.
pub trait Claims: Serialize + DeserializeOwned {
    /// What people call it.
    const KIND: &'static str;
    /// Between `-----BEGIN ` and `-----` in its text form.
    const LABEL: &'static str;
    /// Content type and external AAD of the signature; differs for each kind and version.
    const CONTEXT: &'static str;

    fn validity(&self) -> Validity;

    /// Bounds that the types do not express.
    fn check_bounds(&self) -> Result<(), CertError> {
        self.validity().check_order()
    }
}

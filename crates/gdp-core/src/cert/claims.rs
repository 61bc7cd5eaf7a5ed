//! Common parts of all certificates and statements. Times are Unix seconds, both ends included.

use crate::cert::error::CertError;
use gdp_util::date::rfc3339;
use serde::{Serialize, de::DeserializeOwned};

/// Tolerance in seconds for an issuer's clock that is ahead of the verifier's. Expiry has no such
/// tolerance: a verifier whose clock is behind already accepts longer.
pub const CLOCKS_DIFFER: u64 = 60;

/// Seconds by which issuers begin a validity earlier, so that a clock that is slightly behind
/// accepts the certificate.
pub const BACKDATED: u64 = 300;

/// Maximum lead in seconds of a serial over the verifier's clock, where the serial is the time of
/// issue. A revocation of all that was issued so far covers serials up to its own time, so a serial
/// of the far future would survive it.
pub const SERIAL_AHEAD: u64 = 600;

/// Returns the highest serial that holds at `now` (Unix seconds), where serials are times of issue.
pub fn last_serial(now: u64) -> u64 {
    now.saturating_add(SERIAL_AHEAD).saturating_mul(1_000_000_000)
}

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
            let (begin, end) = (rfc3339(*not_before), rfc3339(*not_after));
            return Err(CertError::Malformed(format!("begins {begin}, after it ends {end}")));
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

    /// Returns the serial of a kind whose serial is its time of issue in Unix nanoseconds.
    fn issued_at(&self) -> Option<u64> {
        None
    }

    /// Checks that the claims hold at `now` (Unix seconds), and were issued by then.
    fn check_time(&self, now: u64) -> Result<(), CertError> {
        match self.issued_at() {
            Some(serial) if serial > last_serial(now) => Err(CertError::IssuedLater { what: Self::KIND, serial, now }),
            _ => self.validity().check(now),
        }
    }

    /// Checks bounds that the types do not express.
    fn check_bounds(&self) -> Result<(), CertError> {
        self.validity().check_order()
    }
}

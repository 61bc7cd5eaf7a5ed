//! Serial numbers and validity periods of certificates.

use gdp_core::cert::BACKDATED;
use gdp_util::unix_time::{unix_nanos, unix_seconds};

/// Returns the serial of a certificate issued now.
pub fn serial_now() -> u64 {
    unix_nanos()
}

/// Returns the start and end of the validity of a certificate issued now.
pub fn validity(seconds: u64) -> (u64, u64) {
    let now = unix_seconds();
    (now.saturating_sub(BACKDATED), now.saturating_add(seconds))
}

/// Returns the seconds for which a certificate of this validity was issued.
pub fn lifetime(not_before: u64, not_after: u64) -> u64 {
    not_after.saturating_sub(not_before).saturating_sub(BACKDATED).max(1)
}

/// Parses `90s`, `15m`, `2h`, `7d`, or a bare number of seconds.
pub fn parse_seconds(text: &str) -> Result<u32, String> {
    let (digits, unit) = match text.strip_suffix(['s', 'm', 'h', 'd']) {
        Some(digits) => (digits, &text[digits.len()..]),
        None => (text, "s"),
    };
    let factor = match unit {
        "m" => 60,
        "h" => 3600,
        "d" => 86400,
        _ => 1,
    };
    let seconds = digits.parse::<u32>().ok().and_then(|n| n.checked_mul(factor)).filter(|n| *n > 0);
    seconds.ok_or_else(|| format!("{text:?} is not a time such as 90s, 15m, 2h or 7d"))
}

#[cfg(test)]
#[path = "../../tests/unit/cli/issuing.rs"]
mod tests;

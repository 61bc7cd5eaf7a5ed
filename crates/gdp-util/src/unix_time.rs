//! The clock of this machine, in the form of certificates and link states. A time before 1970 reads
//! as 0.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Returns the seconds since 1970.
pub fn unix_seconds() -> u64 {
    unix_time().as_secs()
}

/// Returns the nanoseconds since 1970.
pub fn unix_nanos() -> u64 {
    u64::try_from(unix_time().as_nanos()).unwrap_or(u64::MAX)
}

/// Returns the time since 1970.
pub fn unix_time() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

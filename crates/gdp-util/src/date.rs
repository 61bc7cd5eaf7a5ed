//! Times for people: RFC 3339 in UTC, and the distance from now.

const MINUTE: u64 = 60;
const HOUR: u64 = 60 * MINUTE;
const DAY: u64 = 24 * HOUR;

/// Last second of the year 9999, the last year of RFC 3339.
const LAST: u64 = 253_402_300_799;

/// Returns a time in Unix seconds as RFC 3339, such as `2026-11-27T12:30:00Z`.
pub fn rfc3339(seconds: u64) -> String {
    if seconds > LAST {
        return "after the year 9999".into();
    }
    let (days, second) = (seconds / DAY, seconds % DAY);
    // The year begins in March, so that a leap day is its last. An era has 400 years.
    let since_era_0 = days + 719_468;
    let (era, day_of_era) = (since_era_0 / 146_097, since_era_0 % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = 400 * era + year_of_era + u64::from(month <= 2);
    let (hour, minute, second) = (second / HOUR, second % HOUR / MINUTE, second % MINUTE);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

/// Returns a time and its distance from `now`, such as `2026-11-27T12:30:00Z, in 23 h` or
/// `2026-11-23T12:29:14Z, 1 s ago`.
pub fn relative(at: u64, now: u64) -> String {
    let time = rfc3339(at);
    match at.checked_sub(now) {
        Some(_) if at > LAST => time,
        Some(0) => format!("{time}, now"),
        Some(left) => format!("{time}, in {}", rounded(left)),
        None => format!("{time}, {} ago", rounded(now - at)),
    }
}

/// Returns a number of seconds in one unit, rounded to the nearest, such as `90 s` or `365 d`.
pub fn rounded(seconds: u64) -> String {
    let (unit, name) = match seconds {
        0..120 => (1, "s"),
        120..7_200 => (MINUTE, "min"),
        7_200..172_800 => (HOUR, "h"),
        _ => (DAY, "d"),
    };
    format!("{} {name}", seconds.saturating_add(unit / 2) / unit)
}

#[cfg(test)]
#[path = "../tests/unit/date.rs"]
mod tests;

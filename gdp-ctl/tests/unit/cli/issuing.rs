//! Unit tests of `cli::issuing`.

use super::*;

#[test]
fn times_have_units_and_bounds() {
    assert_eq!(parse_seconds("90"), Ok(90));
    assert_eq!(parse_seconds("15m"), Ok(900));
    assert_eq!(parse_seconds("7d"), Ok(604_800));
    for text in ["", "0", "h", "-1s", "1.5h", "99999999d", "5w"] {
        assert!(parse_seconds(text).is_err(), "{text:?}");
    }
}

#[test]
fn a_renewal_lasts_as_long_as_the_certificate_did() {
    let (not_before, not_after) = validity(604_800);
    assert_eq!(lifetime(not_before, not_after), 604_800);
    assert_eq!((lifetime(0, 0), lifetime(5, 100)), (1, 1));
}

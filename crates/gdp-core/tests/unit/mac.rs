//! Unit tests of `mac`.

use super::*;

#[test]
fn addresses_read_as_people_write_them() {
    let mac = [2, 0, 0, 0, 0xab, 1];
    assert_eq!(DisplayMac(mac).to_string(), "02:00:00:00:ab:01");
    assert_eq!(parse_mac("02:00:00:00:AB:01"), Some(mac));
    for text in ["", "02:00:00:00:ab", "02:00:00:00:ab:01:02", "2:0:0:0:ab:1", "+2:00:00:00:ab:01", "02-00-00-00-ab-01"]
    {
        assert_eq!(parse_mac(text), None, "{text}");
    }
}

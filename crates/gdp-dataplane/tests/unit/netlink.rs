//! Unit tests of `netlink`.

use super::*;

#[test]
fn attributes_are_found_and_nonsense_is_not_followed() {
    let attributes = [5, 0, 1, 0, 7, 0, 0, 0, 6, 0, 2, 0x80, 1, 2];
    assert_eq!(attribute(&attributes, 1), Some(&[7][..]));
    assert_eq!(attribute(&attributes, 2), Some(&[1, 2][..]));
    assert_eq!(attribute(&attributes, 3), None);
    assert_eq!(number(&attributes, 2), None, "too short for a number");
    assert_eq!(attribute(&[0, 0, 1, 0], 2), None, "an attribute without a length");
    assert_eq!(attribute(&[200, 0, 1, 0], 1), None, "longer than the message");
}

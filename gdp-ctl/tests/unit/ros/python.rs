//! Unit tests of `ros::python`.

use super::*;

/// The expected texts are the output of Python 3.11.
#[test]
fn floats_are_as_short_as_they_can_be() {
    for (value, printed) in [
        (0.0, "0.0"),
        (-0.0, "-0.0"),
        (1.0, "1.0"),
        (0.1, "0.1"),
        (f64::from(0.1f32), "0.10000000149011612"),
        (0.0001, "0.0001"),
        (0.00001, "1e-05"),
        (1.5e-7, "1.5e-07"),
        (123_456_789_012_345_680.0, "1.2345678901234568e+17"),
        (1e15, "1000000000000000.0"),
        (1e16, "1e+16"),
        (-1e300, "-1e+300"),
        (f64::INFINITY, "inf"),
    ] {
        assert_eq!(float(value), printed);
    }
}

#[test]
fn text_is_in_the_quotes_that_need_fewest_escapes() {
    assert_eq!(string("it's"), "\"it's\"");
    assert_eq!(string("a\"'\n\\"), "'a\"\\'\\n\\\\'");
    assert_eq!(bytes(b"\0\x01a'\xff"), "b\"\\x00\\x01a'\\xff\"");
}

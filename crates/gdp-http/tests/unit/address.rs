//! Addresses of listeners.

use super::*;

#[test]
fn a_port_alone_is_on_loopback() {
    for text in ["9404", ":9404", "localhost:9404", "127.0.0.1:9404"] {
        assert_eq!(parse_address(text).unwrap().to_string(), "127.0.0.1:9404", "{text}");
    }
    assert_eq!(parse_address("[::1]:1").unwrap().to_string(), "[::1]:1");
    assert_eq!(parse_address("0.0.0.0:9404").unwrap().to_string(), "0.0.0.0:9404");
}

#[test]
fn what_is_no_address_is_refused() {
    for text in ["", ":", "70000", "robot7:9404", "127.0.0.1", "::1:x", "\u{1b}[2J"] {
        assert!(parse_address(text).is_err(), "{text:?}");
    }
}

//! Unit tests of `node::error`.

use super::*;
use std::io::{Error, ErrorKind};

#[test]
fn a_robot_that_has_no_network_yet_tries_again() {
    let host = "edge.local".to_owned();
    let unresolved = NodeError::NoAddress { host, source: ErrorKind::NotFound.into() };
    let interface = LinkError::Io { what: "interface r0".into(), source: Error::from_raw_os_error(libc::ENODEV) };
    assert!(unresolved.may_pass());
    assert!(!NodeError::from(interface).may_pass(), "more likely a misspelt name");
}

//! Unit tests of `port::linux::host_id`.

use std::net::UdpSocket;
use std::os::fd::AsFd;

use super::*;

#[test]
fn sockets_of_one_namespace_agree_on_where_they_are() {
    let [a, b] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    assert!(id(a.as_fd()).is_some());
    assert_eq!(id(a.as_fd()), id(b.as_fd()));
}

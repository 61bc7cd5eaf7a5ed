//! Unit tests of `port::addr`.

use super::*;

#[test]
fn addresses_read_as_people_write_them() {
    let mac = [2, 0, 0, 0, 0xab, 1];
    assert_eq!(LinkAddr::Ethernet { ifindex: 3, mac }.to_string(), "eth:3/02:00:00:00:ab:01");
    assert_eq!(LinkAddr::udp("[::ffff:1.2.3.4]:5".parse().unwrap()).to_string(), "udp:1.2.3.4:5");
    assert_eq!(socket_to_mac(&mac_to_socket(mac)), mac);
}

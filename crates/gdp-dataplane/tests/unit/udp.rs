//! Unit tests of `udp`.

use super::*;

#[test]
fn a_socket_takes_datagrams_at_its_own_address_or_at_all_of_its_families() {
    let all = ["127.0.0.1", "192.0.2.1", "192.0.2.2", "2001:db8::1", "fe80::1"];
    let taken = |bound: &str| {
        let address = |ip: &&str| InterfaceAddress { interface: "e0".into(), loopback: false, ip: ip.parse().unwrap() };
        let taken = taken_at(bound.parse().unwrap(), all.iter().map(address).collect());
        assert!(taken.iter().all(|(local, _)| local.port == 31415u16.to_be()));
        taken.into_iter().map(|(_, address)| address.ip.to_string()).collect::<Vec<_>>()
    };
    assert_eq!(taken("192.0.2.2:31415"), ["192.0.2.2"]);
    assert_eq!(taken("[2001:db8::1]:31415"), ["2001:db8::1"]);
    assert_eq!(taken("0.0.0.0:31415"), all[..3]);
    assert_eq!(taken("[::]:31415"), all[..4]);
    assert!(taken("198.51.100.1:31415").is_empty());
    assert!(addresses().unwrap().iter().any(|address| address.loopback), "there is a loopback address");
}

//! Unit tests of `host_pair`.

use super::*;

#[test]
fn ends_are_told_from_other_interfaces_by_their_names() {
    let ends = names(&Name::from_bytes([0x75; 32]).to_string());
    assert_eq!(ends, ["gdp75757575h", "gdp75757575s"]);
    assert!(ends.iter().all(|end| is_end(end)));
    for other in ["gdp0", "gdp75757575", "gdp7575757xh", "gdph", "eth0", "gdp757575755h"] {
        assert!(!is_end(other), "{other}");
    }
}

#[test]
fn an_address_is_found_where_the_name_puts_it() {
    let found = addresses("gdp75757575h", &Name::from_bytes([0x75; 32])).unwrap();
    assert_eq!(found.map(|ip| ip.octets()[..3] == ADDRESSES && ip.octets()[3] % 2 == 0), Some(true));
}

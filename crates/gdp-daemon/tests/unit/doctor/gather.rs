//! Unit tests of `doctor::gather`.

use super::*;

#[test]
fn sockets_are_found_by_port() {
    let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode \
                 ref pointer drops\n \
                 401: 00000000:7AB7 00000000:0000 07 00000000:00000000 00:00000000 00000000 \
                 \x20   0        0 4711 2 0 0\n \
                 402: 0100007F:7AB8 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 4712 2 0 0\n";
    assert_eq!(sockets_at(table, 31415).collect::<Vec<_>>(), ["4711"]);
    assert_eq!(sockets_at("nonsense\n a b:zz", 1).count(), 0);
}

#[test]
fn a_port_that_is_taken_is_found_with_who_has_it() {
    let mine = UdpSocket::bind("127.0.0.1:0").unwrap();
    let found = udp(mine.local_addr().unwrap());
    let PortState::Taken(Some(holder)) = &found.state else { panic!("{found:?}") };
    assert!(holder.ends_with(&format!("(process {})", std::process::id())), "{holder}");
    let address = mine.local_addr().unwrap();
    drop(mine);
    assert!(matches!(udp(address).state, PortState::Free));
    let elsewhere = udp("198.51.100.1:9".parse().unwrap());
    assert!(matches!(elsewhere.state, PortState::Refused(_)), "{elsewhere:?}");
}

//! Unit tests of the bounds on tunnels.

use std::net::Ipv4Addr;

use super::*;

#[test]
fn one_source_leaves_room_for_others() {
    let (mut admission, [one, other]) =
        (Admission::new(MAX_TUNNELS, MAX_TUNNELS_OF_ONE), ["192.0.2.1", "192.0.2.2"].map(address));
    let admitted = (0..MAX_TUNNELS).filter(|_| admission.admit(one)).count();
    assert_eq!(admitted, MAX_TUNNELS_OF_ONE);
    assert!(admission.admit(other));
    admission.release(one);
    assert!(admission.admit(one));
    assert!(!admission.admit(one));
}

#[test]
fn all_tunnels_are_bounded_and_counted_down() {
    let (mut admission, sources) =
        (Admission::new(MAX_TUNNELS, MAX_TUNNELS_OF_ONE), (0..2 * MAX_TUNNELS as u32).map(Ipv4Addr::from_bits));
    let admitted: Vec<_> = sources.map(IpAddr::from).filter(|source| admission.admit(*source)).collect();
    assert_eq!(admitted.len(), MAX_TUNNELS);
    admitted.into_iter().for_each(|source| admission.release(source));
    assert_eq!((admission.total, admission.by_source.len()), (0, 0));
}

#[test]
fn an_ipv6_network_is_one_source() {
    assert_eq!(source_of(address("2001:db8:0:1::7")), source_of(address("2001:db8:0:1:ffff::8")));
    assert_ne!(source_of(address("2001:db8:0:1::7")), source_of(address("2001:db8:0:2::7")));
    assert_eq!(source_of(address("::ffff:192.0.2.1")), address("192.0.2.1"));
}

fn address(text: &str) -> IpAddr {
    text.parse().unwrap()
}

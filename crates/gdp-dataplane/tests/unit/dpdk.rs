//! Unit tests of `dpdk`.

use super::*;

#[test]
fn there_is_room_for_the_packets_of_all_ports() {
    let room = |ports: &[(&str, Option<u16>)]| {
        let port =
            |(device, mtu): &(&str, _)| DpdkPort { interface: "gdp0".into(), device: (*device).into(), mtu: *mtu };
        DpdkConfig { ports: ports.iter().map(port).collect(), ..DpdkConfig::default() }.room()
    };
    assert_eq!(room(&[]), 2048);
    assert_eq!(room(&[("net_null0", None), ("net_af_xdp0,iface=a", None)]), 2048);
    assert_eq!(room(&[("net_null0", Some(2022))]), 2048);
    assert_eq!(room(&[("net_null0", Some(2023))]), 3072);
    assert_eq!(room(&[("net_af_xdp0,iface=a", Some(1800))]), 3072);
    assert_eq!(room(&[("net_af_packet0,iface=a,framesz=8192,blocksz=8192", Some(4000))]), 8192);
    assert_eq!(room(&[("net_null0", None), ("net_null1", Some(9190))]), LARGEST_ROOM);
}

#[test]
fn devices_say_what_they_are() {
    let port = |device: &str| DpdkPort { interface: "gdp0".into(), device: device.into(), mtu: None };
    for (device, pci, carrier) in [
        ("0000:02:00.0", Some("0000:02:00.0"), None),
        ("0000:02:00.1,arg=1", Some("0000:02:00.1,arg=1"), None),
        ("02:00.1", None, None),
        ("net_af_packet0,iface=eth0,qpairs=1", None, Some("eth0")),
        ("net_af_xdp3,iface=a:b.c", None, Some("a:b.c")),
        ("net_null0", None, None),
        ("", None, None),
    ] {
        assert_eq!((port(device).pci(), port(device).carrier()), (pci, carrier), "{device}");
    }
}

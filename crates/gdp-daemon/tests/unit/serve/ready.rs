//! Unit tests of `serve::ready`.

use super::*;

fn plane(interface: &str, kind: &'static str, reason: &str) -> InterfacePlane {
    InterfacePlane { interface: interface.into(), kind, reason: reason.into(), left_alone: kind == "userspace" }
}

fn ready(planes: Vec<InterfacePlane>) -> Ready {
    Ready {
        switch: Name::from_bytes([0x75; 32]),
        rib: true,
        udp: Some(([0, 0, 0, 0], 31415).into()),
        tls: None,
        ethernet: vec![],
        awaited: vec![],
        planes,
        no_xdp: None,
        in_userspace: vec![],
        socket: "/run/gdp/ctl.sock".into(),
        metrics: None,
    }
}

#[test]
fn it_says_what_is_on_what_is_off_and_which_command_changes_that() {
    let may = "with XDP the driver ixgbe may reset the link";
    let all = ["e0", "e1"].map(|name| plane(name, "xdp-native", SUPPORTED));
    let off = ["x0", "x1"].map(|name| plane(name, "userspace", may));
    let line = ready([&off[..], &all[..]].concat()).line("gdp-ctl serve");
    assert_eq!(
        line,
        format!(
            "ready: switch {}; RIB: here; links over UDP: on 0.0.0.0:31415; links on Ethernet: off, no interface is \
             named \
             (`gdp-ctl serve --interface DEV`); XDP: native on e0, e1, off on x0, x1 ({may}; \
             `gdp-ctl serve --interface x0 --interface x1` attaches it); admin socket: /run/gdp/ctl.sock",
            "75".repeat(32)
        )
    );
}

#[test]
fn each_plane_has_its_words() {
    let named =
        Ready { ethernet: vec!["e0".into()], awaited: vec!["e1".into()], udp: None, rib: false, ..ready(vec![]) };
    let line = named.line("serve");
    assert!(line.contains("RIB: elsewhere; links over UDP: off, by `udp: null`;"), "{line}");
    assert!(line.contains("Ethernet: on e0, waiting for e1; XDP: on no interface"), "{line}");
    let line = ready(vec![plane("g0", "dpdk", "device x")]).line("serve");
    assert!(line.contains("DPDK: on g0 (device x);"), "{line}");
    let line = ready(vec![plane("e0", "xdp-generic", "no native XDP: y")]).line("serve");
    assert!(line.contains("XDP: generic on e0 (no native XDP: y);"), "{line}");
    let off = Ready { no_xdp: Some("it is turned off".into()), ..ready(vec![plane("e0", "userspace", "")]) };
    let line = off.line("serve");
    assert!(line.contains("XDP: off, it is turned off; admin") && !line.contains("e0"), "{line}");
}

//! Unit tests of `device`.

use super::*;

#[test]
fn loopback_is_there_and_no_place_for_gdp() {
    let devices = Device::list().unwrap();
    let loopback = devices.iter().find(|device| device.name == "lo").expect("lo");
    assert!(!loopback.ethernet && loopback.program.is_none(), "{loopback:?}");
    assert_eq!(Device::find(loopback.index).unwrap(), *loopback);
    let gone = Device::find(u32::MAX >> 1).unwrap_err();
    assert_eq!(gone.raw_os_error(), Some(libc::ENODEV));
}

#[test]
fn an_answer_that_is_cut_is_refused() {
    let mut answer = vec![0; HEADER];
    answer[2] = libc::ARPHRD_ETHER as u8;
    answer.extend([7, 0, 3, 0, b'e', b'0', 0, 0, 8, 0, 4, 0, 220, 5, 0, 0]);
    let device = parse(&answer).unwrap();
    assert_eq!((device.name.as_str(), device.mtu, device.ethernet, device.up), ("e0", 1500, true, false));
    for length in 0..answer.len() {
        assert_eq!(parse(&answer[..length]), None);
    }
}

#[test]
fn the_way_to_remove_a_program_depends_on_who_holds_it() {
    let program = AttachedProgram {
        interface: "eth0".into(),
        id: 42,
        name: "drop_all".into(),
        mode: Mode::Generic,
        by_link: Some(false),
    };
    assert_eq!(program.to_string(), "program 42 `drop_all`, in generic mode");
    assert_eq!(program.remedy(), "`ip link set dev eth0 xdpgeneric off` removes it");
    assert!(AttachedProgram { by_link: Some(true), ..program.clone() }.remedy().contains("bpftool link detach"));
    assert!(AttachedProgram { by_link: None, ..program.clone() }.remedy().contains("as root"));
    assert!(AttachedProgram { name: "gdp_switch".into(), ..program }.remedy().contains("gdp-ctl xdp detach"));
}

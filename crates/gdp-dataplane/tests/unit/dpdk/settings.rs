//! Unit tests of `dpdk::settings`.

use super::*;

#[test]
fn what_is_kept_is_read_again_and_nonsense_is_not() {
    let changed = ChangedSetting { interface: "eth0".into(), name: "ipv4/rp_filter".into(), before: 2, set: 1 };
    assert_eq!(ChangedSetting::parse(changed.line().trim_end()), Some(changed));
    for line in ["", "eth0 mtu 1500", "eth0 mtu 1500 9000 1", "eth0 mtu x 9000"] {
        assert_eq!(ChangedSetting::parse(line), None, "{line:?}");
    }
    assert!(file("eth0", "ipv4/rp_filter").is_ok());
    assert!(file("..", "ipv4/rp_filter").is_err() && file("eth0", "ipv4/../rp_filter").is_err());
}

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

#[test]
fn settings_of_an_interface_that_is_not_here_stay_in_the_file_until_dpdk_runs() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("settings");
    let line = "nosuch ipv4/rp_filter 2 1\n";
    fs::write(&path, line).unwrap();
    put_back_left(path.clone()).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), line);
    drop(Settings::open(Some(path.clone())));
    assert!(!path.exists());
}

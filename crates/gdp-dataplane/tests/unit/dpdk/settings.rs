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
fn settings_that_cannot_be_restored_stay_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("settings");
    let lines: String = (0..=MAX_LEFT).map(|i| format!("nosuch{i} ipv4/rp_filter 2 1\n")).collect();
    fs::write(&path, &lines).unwrap();
    put_back_left(path.clone()).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), lines);
    drop(Settings::open(Some(path.clone())));
    let left = fs::read_to_string(&path).unwrap();
    assert_eq!(left.lines().count(), MAX_LEFT);
    assert!(lines.ends_with(&left), "the newest stay");
    fs::write(&path, "").unwrap();
    put_back_left(path.clone()).unwrap();
    assert!(!path.exists());
}

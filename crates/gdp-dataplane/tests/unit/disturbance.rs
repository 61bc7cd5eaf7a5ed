//! Unit tests of `disturbance`.

use super::*;

#[test]
fn only_drivers_known_to_disturb_nothing_are_taken_unasked() {
    let (native, none) = (Some(Features(1)), Some(Features(0)));
    for (driver, features, disturbed) in [
        (Some("veth"), native, false),
        (Some("tun"), None, false),
        (Some("ixgbe"), native, true),
        (Some("virtio_net"), None, true),
        (None, native, true),
        // The kernel refuses native XDP and changes nothing.
        (Some("bridge"), none, false),
    ] {
        let reason = disturbs(driver, features);
        assert_eq!(reason.is_some(), disturbed, "{driver:?} {features:?}: {reason:?}");
        assert!(reason.is_none_or(|reason| reason.contains(driver.unwrap_or("without"))));
    }
}

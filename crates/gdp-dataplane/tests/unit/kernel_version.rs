//! Unit tests of `kernel_version`.

use super::KernelVersion;

#[test]
fn releases_are_compared_by_number() {
    assert_eq!(KernelVersion::parse("6.18.44-fc-v657"), KernelVersion(6, 18));
    assert_eq!(KernelVersion::parse("5.15-rc1"), KernelVersion(5, 15));
    assert_eq!(KernelVersion::parse("weird"), KernelVersion(0, 0));
    assert!(KernelVersion(5, 9) < KernelVersion(5, 15));
    assert!(KernelVersion::running() > KernelVersion(0, 0));
}

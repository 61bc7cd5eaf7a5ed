//! Unit tests of `renewal`.

use gdp_core::cert::{AdCert, issue};

use super::*;
use crate::material::tests::Files;

#[test]
fn what_is_told_is_offered_until_it_is_in_force() {
    let files = Files::new();
    let permission =
        |serial| Permission::Publish(issue(&files.owner, &AdCert { serial, ..files.claims() }).unwrap().into());
    let serial = |permission: Option<Permission>| Some(permission?.publish().unwrap().serials().unwrap()[0].1);
    let (tell, newest) = watch::channel(permission(1));
    let mut told = Renewal::Notified(Notified::new(newest));
    assert!(told.changed().is_none());
    tell.send_replace(permission(2));
    for _ in 0..2 {
        assert_eq!(serial(told.changed()), Some(2));
    }
    tell.send_replace(permission(3));
    assert_eq!(serial(told.changed()), Some(3));
    told.taken();
    drop(tell);
    assert!(told.changed().is_none());
}

//! Unit tests of `cert_file`.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use gdp_core::cert::{AdCert, CLOCKS_DIFFER, issue};

use super::*;
use crate::material::Material;
use crate::material::tests::{Files, watcher};
use crate::renewal::Renewal;

#[test]
fn a_certificate_is_read_again_when_it_is_another_and_only_then() {
    let (files, mut file) = opened();
    assert!(file.changed().is_none());
    // As tools do it that replace files.
    write(&files, "new", AdCert { serial: 7, ..files.claims() });
    std::fs::rename(files.path("new"), files.path("t.ad")).unwrap();
    offers(&mut file, 7);
    file.taken();
    assert!(file.changed().is_none());
    std::fs::remove_file(files.path("t.ad")).unwrap();
    assert!(file.changed().is_none());
    std::fs::write(files.path("t.ad"), "half").unwrap();
    assert!(file.changed().is_none());
    write(&files, "t.ad", AdCert { serial: 8, ..files.claims() });
    offers(&mut file, 8);
}

#[test]
fn what_is_not_taken_is_offered_again() {
    let (files, mut file) = opened();
    write(&files, "t.ad", AdCert { serial: 7, ..files.claims() });
    offers(&mut file, 7);
    for _ in 0..3 {
        assert_eq!(serial(file.changed()), Some(7));
        file.refused(&"the RIB is away");
    }
    file.taken();
    assert!(file.changed().is_none());
}

#[test]
fn a_certificate_that_is_not_valid_yet_is_offered_once_it_is() {
    let (files, mut file) = opened();
    let not_before = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs() + CLOCKS_DIFFER + 2;
    write(&files, "t.ad", AdCert { serial: 7, not_before, ..files.claims() });
    assert!(file.changed().is_none());
    offers(&mut file, 7);
}

#[test]
fn what_is_replaced_after_the_start_is_noticed_though_it_was_not_looked_for() {
    let files = Files::new();
    let mut material = Material::load(&files.config(""), &watcher()).unwrap();
    write(&files, "t.ad", AdCert { serial: 7, ..files.claims() });
    let Renewal::File(file) = &mut material.routes[0].1.file else { panic!("it is of a file") };
    offers(file, 7);
}

fn opened() -> (Files, CertFile) {
    let files = Files::new();
    let opened = CertFile::open(&files.path("t.ad"), Side::Out, "/chatter", &files.card, files.entity, &watcher());
    (files, opened.unwrap().0)
}

fn write(files: &Files, name: &str, claims: AdCert) {
    std::fs::write(files.path(name), issue(&files.owner, &claims).unwrap().to_pem()).unwrap();
}

/// Waits until the file is seen to have changed, and holds what may be used.
fn offers(file: &mut CertFile, expected: u64) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while serial(file.changed()) != Some(expected) {
        assert!(Instant::now() < deadline, "not in time");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn serial(permission: Option<Permission>) -> Option<u64> {
    Some(permission?.publish().unwrap().serials().unwrap()[0].1)
}

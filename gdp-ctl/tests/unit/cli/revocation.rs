//! Unit tests of `cli::revocation`.

use serde::{Deserialize, Serialize};

use super::*;

const NOW: u64 = 1_800_000_000;

#[test]
fn what_is_taken_back_stays_so_until_it_has_expired() {
    let first = revoke(None, &[], &[7, 3, 7], None).unwrap();
    assert_eq!((first.number, first.floor, first.revoked.as_slice()), (1, 0, &[3, 7][..]));
    // The ledger states the expiry of 3, but not of 7.
    let entry = |ends| Item { serial: 3, ends };
    for (not_after, left) in [(NOW, vec![3, 5, 7]), (NOW - CLOCKS_DIFFER - 1, vec![5, 7])] {
        assert_eq!(revoke(Some(&first), &[entry(not_after)], &[5], None).unwrap().revoked, left);
    }
}

#[test]
fn all_at_once_needs_no_memory() {
    let known = revoke(None, &[], &[7], None).unwrap();
    for known in [None, Some(&known)] {
        let all = revoke(known, &[], &[5, 200], Some(100)).unwrap();
        assert_eq!((all.number, all.floor, all.revoked.as_slice()), (NOW, 100, &[200][..]));
        let more = revoke(Some(&all), &[], &[150, 99], None).unwrap();
        assert_eq!((more.number, more.floor, more.revoked.as_slice()), (NOW + 1, 100, &[150, 200][..]));
    }
}

#[test]
fn a_list_that_is_full_says_how_to_go_on() {
    let serials: Vec<u64> = (0..=MAX_REVOKED as u64).collect();
    assert!(revoke(None, &[], &serials[1..], None).is_ok());
    assert!(revoke(None, &[], &serials, None).unwrap_err().to_string().contains("--all"));
    let last = Revocation { name: Name::default(), number: u64::MAX, floor: 0, revoked: vec![], signer: None };
    assert!(revoke(Some(&last), &[], &[1], None).is_err());
}

#[test]
fn serials_rise_also_if_the_clock_is_set_back() {
    assert!(next_serial::<Item>(&[], None).unwrap() > 1_700_000_000_000_000_000);
    let later = serial_now() + 300_000_000_000;
    let revocation = |floor, revoked| Revocation { name: Name::default(), number: 1, floor, revoked, signer: None };
    assert_eq!(next_serial::<Item>(&[], Some(&revocation(later, vec![]))).unwrap(), later);
    assert_eq!(next_serial::<Item>(&[], Some(&revocation(0, vec![later]))).unwrap(), later + 1);
    assert_eq!(next_serial(&[Item { serial: later, ends: 0 }], None).unwrap(), later + 1);
}

/// No verifier accepts a serial of the far future, so the next one must not follow it.
#[test]
fn serials_of_the_far_future_are_passed_over_and_revoked_with_all_others() {
    let far = serial_now() + 86_400_000_000_000;
    for far in [far, u64::MAX] {
        let revocation = Revocation { name: Name::default(), number: 1, floor: 0, revoked: vec![far], signer: None };
        let next = next_serial(&[Item { serial: far, ends: NOW }], Some(&revocation)).unwrap();
        assert!(next < far - 1, "{next}");
    }
    let floored = Revocation { name: Name::default(), number: 1, floor: far, revoked: vec![], signer: None };
    let error = next_serial::<Item>(&[], Some(&floored)).unwrap_err().to_string();
    assert!(error.contains("check the clock"), "{error}");

    let issued = [Item { serial: 99, ends: NOW }, Item { serial: 500, ends: NOW }];
    assert_eq!(revoke(None, &issued, &[], Some(100)).unwrap().revoked, [500]);
    assert!(revoke(None, &issued, &[], None).unwrap().revoked.is_empty());
}

#[derive(Serialize, Deserialize)]
struct Item {
    serial: u64,
    ends: u64,
}

impl Entry for Item {
    const SUFFIX: &'static str = ".items";

    fn serial(&self) -> u64 {
        self.serial
    }

    fn ends(&self) -> u64 {
        self.ends
    }
}

fn revoke(
    known: Option<&Revocation>,
    issued: &[Item],
    chosen: &[u64],
    floor: Option<u64>,
) -> anyhow::Result<Revocation> {
    next(Name::default(), known, issued, chosen, floor, NOW)
}

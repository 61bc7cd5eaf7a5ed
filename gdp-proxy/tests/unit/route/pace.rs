//! Unit tests of `route::pace`.

use super::*;

#[test]
fn each_publisher_keeps_the_rate() {
    let mut pace = Pace::new(NonZeroU32::new(10));
    let start = Instant::now();
    let taken = |pace: &mut Pace<u64>, from| {
        let goes = |i: &u64| pace.take(start + Duration::from_millis(i * 100 / 3), Some(from), *i).0.is_some();
        (0..300).filter(goes).count()
    };
    let first = taken(&mut pace, 1);
    assert!((95..=101).contains(&first), "30 Hz for ten seconds: {first}");
    assert_eq!(taken(&mut pace, 2), first, "each for itself");
    assert!(pace.take(start + Duration::from_secs(60), Some(1), 0).0.is_some(), "after a pause at once");
    assert!((0..9).all(|i| Pace::new(None).take(start, None, i) == (Some(i), 0)));
}

#[test]
fn the_last_of_a_burst_goes_when_its_turn_has_come() {
    let (mut pace, start) = (Pace::new(NonZeroU32::new(10)), Instant::now());
    let at = |ms| start + Duration::from_millis(ms);
    assert_eq!(pace.take(at(0), Some(1), 'a'), (Some('a'), 0));
    assert_eq!(pace.next(), None);
    assert_eq!(pace.take(at(10), Some(1), 'b'), (None, 0));
    assert_eq!(pace.take(at(20), Some(1), 'c'), (None, 1));
    assert_eq!(pace.next(), Some(at(150)));
    assert_eq!((pace.overdue(at(149)), pace.overdue(at(150)), pace.overdue(at(150))), (None, Some('c'), None));
    assert_eq!(pace.take(at(200), Some(1), 'd'), (None, 0), "it went just now");
    assert_eq!(pace.take(at(260), Some(1), 'e'), (Some('e'), 1), "it came by itself, and is newer");
    pace.take(at(270), Some(1), 'f');
    assert_eq!((pace.left(1), pace.left(1), pace.next()), (Some('f'), None, None), "nothing comes after it");
}
